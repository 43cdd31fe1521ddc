"""Recoloring: the page shows what the command keeps."""

import numpy as np
import pytest

from schemas.errors import ArtifactDamaged, UsageError
from stages import recolor, region_select
from stages.artifacts.edit import Edit, save_edit
from stages.artifacts.field import load_field
from stages.artifacts.region import load_region
from stages.configs.decompose import RecolorConfig
from stages.configs.select import SelectConfig
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.editing.palette_module import PaletteModule
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.rendering.view import render_view
from tests.stages import evaluation_fixture as made
from tests.stages.viewing.command_lines import config_of
from tests.stages.viewing.room import FRONT, PALETTE, SHARES


def test_a_recolored_picture_is_that_of_the_kept_field(desk):
    desk.recolorer.open("palette")
    swatches = desk.recolorer.swatches()
    assert [one.share for one in swatches] == sorted((one.share for one in swatches), reverse=True)
    with pytest.raises(UsageError, match="no palette color was changed"):
        desk.recolorer.command()
    desk.recolorer.change(0, color="#2040f0")
    desk.recolorer.change(1, weight=0.3)
    desk.recolorer.change(2, bias=0.1)
    args, config = config_of(desk.recolorer.command("blue"))
    assert (args.of, args.name, config.method) == ("palette", "blue", "palettenerf")
    assert (config.palette, config.palette_weight, config.palette_bias) == (("0=#2040f0",), ("1=0.3",), ("2=0.1",))
    work = desk.library.work
    inputs = {"scene": work.get("scene", "wall"), "field": work.get("field", "palette")}
    options = RecolorConfig(config.palette, config.palette_weight, config.palette_bias)
    kept, _ = execute(recolor.SPEC, recolor.run, work, "blue", inputs, options, Context(threads=1))
    shown = desk.recolorer.recolored(desk.library.source("palette")).field
    camera = FRONT.camera(1200)
    now, before, stored = (
        render_view(field, camera, threads=1).rgb
        for field in (shown, desk.library.source("palette").field, load_field(kept)[0])
    )
    assert np.abs(now - before).max() > 0.05
    np.testing.assert_array_equal(now, stored)
    desk.recolorer.reset()
    assert desk.recolorer.recolored(desk.library.source("palette")) is not None and not desk.recolorer.changes.config()


def test_a_regions_palette_shows_on_the_region_alone_and_is_kept(desk):
    work = desk.library.work
    scene, field = work.get("scene", "wall"), work.get("field", "plain")
    box = SelectConfig(box=(-1.0, -1.0, 2.0, 0.0, 1.0, 4.0), cells=32)
    inputs = {"scene": scene, "field": field}
    half, _ = execute(region_select.SPEC, region_select.run, work, "half", inputs, box, Context(threads=1))
    space = np.float32([[0, 0, 0], [1, 1, 1]])
    module = PaletteModule.create(np.random.default_rng(0), PALETTE, space)

    def write(folder):
        save_edit(folder, Edit(module, PaletteEdits()), SHARES, {})

    learned = {"recolor": True, "colors": 6, "max_colors": 4}
    made.commit(work, "edit", "half", "edit_learn", {**inputs, "region": half}, write, config=learned)
    assert "edit half" in desk.recolorer.palettes()
    desk.recolorer.open("edit half")
    assert len(desk.recolorer.swatches()) == 4
    desk.recolorer.change(1, color="#ff00ff")
    args, config = config_of(desk.recolorer.command("pink"))
    assert (args.region, args.name, config.recolor, config.colors, config.max_colors) == ("half", "pink", True, 6, 4)
    assert config.palette == ("1=#ff00ff",)
    for wrong in ({"colors": "8"}, {"crop": 1}, {"palette_steps": -5}, {"stroke": [1.0]}, {"offset_weight": 10**400}):
        made.commit(work, "edit", "half", "edit_learn", {**inputs, "region": half}, write, config=learned | wrong)
        with pytest.raises(ArtifactDamaged, match=r"has unknown options: .*; rebuild it"):
            desk.recolorer.command("pink")
    made.commit(work, "edit", "half", "edit_learn", {**inputs, "region": half}, write, config=learned)
    camera, plain = FRONT.camera(1200), desk.library.source("plain").field
    cells = {"half": load_region(half)[0].edit}
    before, now = (
        render_view(field, camera, threads=1, regions=cells)
        for field in (plain, desk.recolorer.recolored(desk.library.source("plain")).field)
    )
    inside = before.masks["half"] / np.maximum(before.alpha, 1e-6)
    moved = np.abs(now.rgb - before.rgb).max(2)
    assert moved[(inside > 0.99) & (before.alpha > 0.9)].min() > 0.005
    np.testing.assert_allclose(moved[inside == 0], 0, atol=1e-6)
