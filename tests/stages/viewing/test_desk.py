"""The desk: what clicks select, what palettes become, and that each command does what the page showed."""

import shlex
import time
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.errors import BadInput, UsageError
from stages import recolor, region_select
from stages.artifacts.edit import Edit, save_edit
from stages.artifacts.field import load_field
from stages.artifacts.region import load_region
from stages.configs.decompose import RecolorConfig
from stages.configs.select import SelectConfig
from stages.run.progress import Context
from stages.run.runner import execute
from stages.run.training_loop import save_checkpoint
from stages.viewing.cameras import Pose
from stages.viewing.commands import as_text, command, script_of
from stages.viewing.desk import Desk
from stages.viewing.library import Library
from stages.viewing.painter import Painter
from stages.viewing.selection import Selection
from stages.viewing.styles import METHODS, Wish
from stylerf.editing.palette_module import PaletteModule
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.rendering.view import render_view
from stylerf_cli.main import HELP_ALL, parser_of
from stylerf_cli.session import Options
from stylerf_cli.verbs import VERBS
from tests.stages import evaluation_fixture as made
from tests.stages.viewing.room import PALETTE, SHARES, furnished

FRONT = Pose((1.0, 0.0, 0.0, 0.0), (0.05, 0.0, 0.0), 0.76, 4 / 3)


def config_of(arguments: list[str]):
    """The options that the command line makes of a command, by its own parser."""
    import importlib

    verb, *rest = arguments
    module = importlib.import_module(VERBS[verb][0])
    config = module.options_for(rest) if hasattr(module, "options_for") else module.CONFIG
    args = parser_of(verb, module, config, HELP_ALL in rest).parse_args(rest)
    return args, Options(verb, args, list(VERBS), getattr(module, "CONFIGS", ())).config(config)


@pytest.fixture
def desk(tmp_path):
    library = Library(furnished(tmp_path / "work").root)
    opened = Desk(library, Painter(1, 2700.0, 12.0), 1)
    opened.look(field="plain")
    yield opened
    opened.close()
    opened.painter.stop()


def test_a_click_selects_and_its_command_makes_the_same_region(desk):
    seed = desk.click(FRONT, 0.5, 0.5)
    desk.reselect(tolerance=40.0, steps=2, iterations=500)
    assert desk.selected_cells > 0
    args, config = config_of(desk.select_command("thing"))
    assert (args.of, args.name, config.at, config.tolerance) == ("plain", "thing", (seed,), 40.0)
    work = desk.library.work
    inputs = {"scene": work.get("scene", "wall"), "field": work.get("field", "plain")}
    kept, _ = execute(region_select.SPEC, region_select.run, work, "thing", inputs, config, Context(threads=1))
    np.testing.assert_array_equal(load_region(kept)[0].edit, desk._selected)
    desk.look(overlay="thing")
    assert desk.library.regions("plain") == ["thing"]


def test_growing_goes_in_steps_and_back(desk):
    desk.click(FRONT, 0.5, 0.5)
    sizes = []
    for steps in (0, 1, 2):
        desk.reselect(tolerance=0.0, steps=steps, iterations=40)
        sizes.append(desk.selected_cells)
    assert sizes[0] < sizes[1] < sizes[2]
    desk.undo()
    assert desk.selected_cells == sizes[1]
    desk.clear_selection()
    assert desk.selected_cells == 0
    with pytest.raises(UsageError, match="nothing is selected"):
        desk.select_command()
    desk.undo()
    assert desk.selected_cells == sizes[1]


def test_a_box_holds_what_the_rectangle_shows(desk):
    low_x, low_y, low_z, high_x, high_y, high_z = desk.box(FRONT, (0.45, 0.45), (0.55, 0.55))
    # The front of the fog, at z = 2, seen from x = 0.05 with a tangent of 0.4 (0.53 across) to the picture's rim.
    assert low_x < 0.0 and high_x > 0.1 and low_y < -0.05 and high_y > 0.05 and low_z < 2.05 < high_z
    assert -0.2 < low_x and high_x < 0.3 and 1.9 < low_z and high_z < 2.2
    assert desk.selected_cells > 0
    assert config_of(desk.select_command())[1].box == (low_x, low_y, low_z, high_x, high_y, high_z)


def test_what_meets_nothing_selects_nothing(desk):
    away = Pose((0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0), 0.76, 4 / 3)
    for action in (
        lambda: desk.click(away, 0.5, 0.5),
        lambda: desk.scribble(away, [(0.4, 0.4), (0.6, 0.6)]),
        lambda: desk.box(away, (0.4, 0.4), (0.6, 0.6)),
    ):
        with pytest.raises(BadInput, match="nothing of the field"):
            action()
    assert not desk.history.now and len(desk.history.states) == 1


def test_a_recolored_picture_is_that_of_the_kept_field(desk):
    swatches = desk.open_palette("palette")
    assert [one.share for one in swatches] == sorted((one.share for one in swatches), reverse=True)
    with pytest.raises(UsageError, match="no palette color was changed"):
        desk.recolor_command()
    desk.recolor(0, color="#2040f0")
    desk.recolor(1, weight=0.3)
    desk.recolor(2, bias=0.1)
    args, config = config_of(desk.recolor_command("blue"))
    assert (args.of, args.name, config.method) == ("palette", "blue", "palettenerf")
    assert (config.palette, config.palette_weight, config.palette_bias) == (("0=#2040f0",), ("1=0.3",), ("2=0.1",))
    work = desk.library.work
    inputs = {"scene": work.get("scene", "wall"), "field": work.get("field", "palette")}
    options = RecolorConfig(config.palette, config.palette_weight, config.palette_bias)
    kept, _ = execute(recolor.SPEC, recolor.run, work, "blue", inputs, options, Context(threads=1))
    shown = desk._recolored(desk.library.source("palette")).field
    camera = FRONT.camera(1200)
    now, before, stored = (
        render_view(field, camera, threads=1).rgb
        for field in (shown, desk.library.source("palette").field, load_field(kept)[0])
    )
    assert np.abs(now - before).max() > 0.05
    np.testing.assert_array_equal(now, stored)
    desk.reset_palette()
    assert desk._recolored(desk.library.source("palette")) is not None and not desk.changes.config()


def test_a_regions_palette_is_shown_on_the_region_alone_and_kept_with_its_options(desk):
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
    assert "edit half" in desk.palettes()
    assert len(desk.open_palette("edit half")) == 4
    desk.recolor(1, color="#ff00ff")
    args, config = config_of(desk.recolor_command("pink"))
    assert (args.region, args.name, config.recolor, config.colors, config.max_colors) == ("half", "pink", True, 6, 4)
    assert config.palette == ("1=#ff00ff",)
    camera, plain = FRONT.camera(1200), desk.library.source("plain").field
    cells = {"half": load_region(half)[0].edit}
    before, now = (
        render_view(field, camera, threads=1, regions=cells)
        for field in (plain, desk._recolored(desk.library.source("plain")).field)
    )
    inside = before.masks["half"] / np.maximum(before.alpha, 1e-6)
    moved = np.abs(now.rgb - before.rgb).max(2)
    assert moved[(inside > 0.99) & (before.alpha > 0.9)].min() > 0.005
    np.testing.assert_allclose(moved[inside == 0], 0, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_stylization_is_one_that_the_command_line_takes(desk, method):
    args, config = config_of(desk.stylize_command(Wish("a b.png", method, "", 2.0, 1.0, "30s", "x")))
    assert (args.of, args.name, config.method, config.style) == ("plain", "x", method, "a b.png")
    assert (config.style_weight, config.budget) == (2.0, "30s")
    args, config = config_of(desk.stylize_command(Wish("a b.png", method, "thing", 2.0, 0.5, "30s", "x")))
    assert (args.region, config.style, config.stroke, config.style_weight) == ("thing", "a b.png", 0.5, 6.0)


def ended(arguments: list[str], code: int) -> SimpleNamespace:
    return SimpleNamespace(arguments=arguments, code=code)


def test_a_stopped_stylization_is_kept_by_the_same_command_until_its_steps(desk):
    arguments = desk.stylize_command(Wish("a.png", name="half"))
    for run in (None, ended(arguments, 0), ended(["render", "x"], 130), ended([*arguments, "--region", "a"], 130)):
        desk.run = run
        with pytest.raises(UsageError, match="nothing to keep"):
            desk.keep_command()
    desk.run = ended(arguments, 130)
    with pytest.raises(UsageError, match="resume it"):
        desk.keep_command()
    folder = desk.library.work.root / "field" / ".half.partial" / "checkpoint"
    folder.mkdir(parents=True)
    save_checkpoint(folder, {"state": {"phase": "refit", "step": 200}}, {})
    with pytest.raises(UsageError, match="resume it"):
        desk.keep_command()
    save_checkpoint(folder, {"state": {"phase": "style", "step": 17}}, {})
    assert config_of(desk.keep_command())[1].until == 17
    assert desk.keep_command() == [*arguments, "--until", "17"]
    desk.run = ended([*arguments, "--until", "30"], 130)
    assert desk.keep_command() == [*arguments, "--until", "17"]


def test_the_stages_of_an_edit_are_commands_that_the_command_line_takes(desk):
    args, _ = config_of(desk.extract_command("thing"))
    assert args.region == "thing"
    args, _ = config_of(desk.distill_command("red"))
    assert args.edit == "red"
    args, config = config_of(desk.finetune_command("red", 45))
    assert (args.edit, config.budget) == ("red", "45s")
    args, _ = config_of(desk.deform_command())
    assert args.of == "plain"
    with pytest.raises(UsageError, match="no region yet"):
        desk.extract_command("")
    with pytest.raises(UsageError, match="no edit yet"):
        desk.distill_command("")


def test_a_stylization_needs_a_painting_and_a_name(desk):
    with pytest.raises(UsageError, match="choose one first"):
        desk.stylize_command(Wish(""))
    with pytest.raises(UsageError, match="valid name"):
        desk.stylize_command(Wish("a.png", name="../x"))


def test_a_saved_path_is_one_that_render_takes(desk):
    from stages.artifacts.camera_files import read_cameras

    for x in (0.0, 0.2, 0.3):
        desk.add_keyframe(Pose((1.0, 0.0, 0.0, 0.0), (x, 0.0, 0.0), 0.8, 1.5))
    desk.set_keyframes(between=4)
    path = desk.save_path("walk")
    assert path.is_relative_to(desk.library.work.root)
    cameras = read_cameras(path, desk.library.scene).cameras
    assert len(cameras) == 9
    np.testing.assert_allclose([cameras[i].center[0] for i in (0, 4, 8)], [0.0, 0.2, 0.3], atol=1e-9)
    like = desk.library.scene.cameras[0]
    assert {(one.width, one.height) for one in cameras} == {(like.width, like.height)}
    assert 2 * np.arctan(cameras[3].height / 2 / cameras[3].fy) == pytest.approx(0.8)
    args, config = config_of(desk.path_command(path))
    assert (args.of, config.path) == ("plain", str(path))
    with pytest.raises(UsageError, match="valid name"):
        desk.save_path("../../x")


def test_commands_are_quoted_for_a_shell():
    arguments = command("select", "my work", None, of="a b", name="")
    assert as_text(arguments) == "stylerf select 'my work' --of 'a b'"
    script = script_of([arguments])
    assert script.startswith("#!/bin/sh\nset -e\n")
    assert shlex.split(script.splitlines()[2]) == ["stylerf", *arguments]


def test_nothing_else_can_be_looked_at(desk):
    for bad in ({"lock": 1}, {"plane": "secret"}):
        with pytest.raises(UsageError):
            desk.look(**bad)


def opened_page(desk):
    """Make the desk's painter rest, as with a page that shows an exact picture."""
    desk.painter.open(0, lambda picture, exact, stride: None)
    desk.painter.move(0, FRONT)
    desk.refresh()
    desk.painter.start()


def waited_for(found, seconds: float = 60.0) -> bool:
    end = time.monotonic() + seconds
    while not found() and time.monotonic() < end:
        time.sleep(0.02)
    return bool(found())


def test_what_a_first_selection_needs_is_computed_once_while_the_page_rests(desk, monkeypatch):
    from stages.viewing.growing import Grower

    steps, plain = [], region_select.Sight.look
    monkeypatch.setattr(region_select.Sight, "look", lambda sight, view: (steps.append(view), plain(sight, view))[1])
    desk.prepare()
    time.sleep(0.5)
    assert steps == [], "no page is open"
    opened_page(desk)
    assert waited_for(lambda: desk._growers and next(iter(desk._growers.values()))._solid)
    seed = desk.click(FRONT, 0.5, 0.5)
    assert steps == desk.grower()._first.looking_views
    alone = Grower(desk.library, "plain", 1, print)
    np.testing.assert_array_equal(alone.cells(Selection(at=(seed,))), desk._selected)


def test_preparing_is_given_up_for_another_field_and_by_closing(desk, monkeypatch):
    looked, plain = [], region_select.Sight.look

    def slow(sight, view):
        looked.append(sight.field)
        desk.look(field="palette")
        return plain(sight, view)

    monkeypatch.setattr(region_select.Sight, "look", slow)
    opened_page(desk)
    desk.prepare()
    palette = desk.library.source("palette").field
    assert waited_for(lambda: len(looked) == 3), "one look in the first field, two in the other"
    assert [one is palette for one in looked] == [False, True, True]
    desk.close()
    assert not desk._preparing.is_alive()
