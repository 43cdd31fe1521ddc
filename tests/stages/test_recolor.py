"""A palette field as stages write, change and evaluate it; its options."""

import json

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.work_folder import WorkFolder
from stages import edit_palette, recolor
from stages.artifacts.edit import Edit, save_edit, save_palette
from stages.artifacts.field import load_field, save_field
from stages.artifacts.provenance import palette_behind
from stages.configs.decompose import DecomposeConfig, PaletteFieldConfig, RecolorConfig
from stages.configs.edit import PaletteConfig
from stages.decompose import settings_of, weights_of
from stages.evaluation.local_edit import palette_facts, palette_rows
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.editing.palette_module import PaletteModule
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.geometry.space_warp import SpaceWarp
from tests.stages import evaluation_fixture as made
from tests.stylerf.small import field_of, vm_color

PALETTE = np.float32([[0.8, 0.1, 0.1], [0.1, 0.6, 0.2], [0.1, 0.2, 0.8], [0.9, 0.8, 0.3]])
SHARES = [0.1, 0.4, 0.2, 0.3]
FIGURES = {"sparsity": 0.4, "palette_variation": 0.01}


@pytest.fixture
def work(tmp_path):
    """A scene, a fitted stand-in, and a decomposed fog around the ball's place whose shares are not in order."""
    work = WorkFolder(tmp_path / "work")
    scene = made.make_scene(work, [0.0, 0.3], depth=False)
    fit = made.make_field(work, "fit", "nerf_fit", {"scene": scene})
    color = PaletteColor.create(np.random.default_rng(0), PALETTE, 8, 40, 512, base=3)
    field = field_of(SpaceWarp.box([-1, -1, 2], [1, 1, 4]), 3, color)
    field.density.values[-1] = 3.0

    def write(folder):
        save_field(folder, field, "none")
        save_palette(folder, color.palette, color.palette, SHARES, FIGURES)

    made.commit(
        work, "field", "palette", "decompose", {"scene": scene, "field": fit}, write, figures=FIGURES | {"psnr": 30}
    )
    plain = field_of(field.space, 3, vm_color(1))
    inputs = {"scene": scene}
    made.commit(work, "field", "plain", "nerf_fit", inputs, lambda folder: save_field(folder, plain, "none"))
    return work


def recolored(work: WorkFolder, of: str = "palette", name: str = "new", **options):
    inputs = {"scene": work.get("scene", "wall"), "field": work.get("field", of)}
    return execute(recolor.SPEC, recolor.run, work, name, inputs, RecolorConfig(**options), Context())[0]


def test_colors_are_counted_by_their_shares_and_numbers_stay(work):
    found = recolored(work, palette=("0=#ff00ff", "3=#00ffff"))
    before, after = (load_field(work.get("field", name))[0] for name in ("palette", "new"))
    assert np.array_equal(before.color.values, after.color.values)
    assert np.array_equal(before.density.values, after.density.values)
    expected = PALETTE.copy()
    expected[1], expected[0] = [1, 0, 1], [0, 1, 1]  # the largest share is the second column, the least the first
    np.testing.assert_allclose(after.color.present_palette, expected, atol=1e-6)
    entries = json.loads(found.file("palette.json").read_text())
    assert [one["now"] for one in entries["colors"]][::3] == ["#ff00ff", "#00ffff"]
    assert entries["colors"][0]["learned"] == "#1a9933" and entries["sparsity"] == FIGURES["sparsity"]
    assert found.manifest.figures["sparsity"] == 0.4 and (found.path / "palette.png").is_file()


def test_figures_of_weights_do_not_outlive_them(work):
    """Sparsity and TV are of the weights as learned: gone with a bias or a scale, kept with a color; by either way."""
    changed = recolored(work, palette_bias=("0=0.2",), name="biased")
    again = recolored(work, palette=("0=#ff00ff",), name="again", of="biased")
    for one in (changed, again):
        reported = json.loads(one.file("palette.json").read_text())
        assert not {*FIGURES} & {*one.manifest.figures, *reported}
        assert palette_rows(one, True) == [{"name": one.name}]
    box = np.float32([[0, 0, 0], [1, 1, 1]])
    module = PaletteModule.create(np.random.default_rng(0), PALETTE, box)

    def write(folder):
        save_edit(folder, Edit(module, PaletteEdits()), SHARES, FIGURES)

    learned = made.commit(work, "edit", "learned", "edit_learn", {}, write, figures=FIGURES)
    kept = []
    for name, options in {"scaled": {"palette_weight": ("1=2",)}, "red": {"palette": ("1=#ff0000",)}}.items():
        config = PaletteConfig(**options)
        found, _ = execute(edit_palette.SPEC, edit_palette.run, work, name, {"edit": learned}, config, Context())
        kept.append({key: found.manifest.figures.get(key) for key in FIGURES})
    assert kept == [dict.fromkeys(FIGURES), FIGURES]


def test_a_change_around_a_pixel_is_placed_on_the_visible_surface(work):
    """The middle pixel of the first view looks down z from the origin; the fog begins at z = 2."""
    recolored(work, palette=("1=#ffffff",), at=("photo_00:48,36",))
    (edit,) = load_field(work.get("field", "new"))[0].color.edits
    (center,) = edit.within.centers
    assert np.abs(center[:2]).max() < 0.05 and 2 < center[2] < 4
    assert edit.within.reach == pytest.approx(0.1 * np.linalg.norm(center), rel=1e-6)
    recolored(work, palette=("1=#ffffff",), at=("#0:48,36",), reach=0.5, name="second", of="new")
    edits = load_field(work.get("field", "second"))[0].color.edits
    assert len(edits) == 2 and edits[1].within.reach == 0.5 and edits[1].within.centers == edits[0].within.centers
    recolored(work, palette=("1=#ffffff",), at=("#0:48,36",), filter="none", name="third")
    assert load_field(work.get("field", "third"))[0].color.edits[0].within is None


@pytest.mark.parametrize(
    ("options", "of", "words"),
    [
        ({"palette": ("4=#ffffff",)}, "palette", "there are 0 to 3"),
        ({"palette": ("0=#ffffff",)}, "plain", "has no palette"),
        ({"palette": ("0=#ffffff",), "at": ("nobody:1,1",)}, "palette", "view 'nobody' not found"),
        ({"palette": ("0=#ffffff",), "at": ("#0:96,1",)}, "palette", "has 96x72 pixels"),
        ({"palette": ("0=#ffffff",), "at": ("#0:0,0",)}, "palette", "hits nothing in the field"),
        ({"palette": ("0=#ffffff",), "at": ("#0:48,36",) * 257}, "palette", "around 257 points; at most 256"),
    ],
)
def test_changes_that_cannot_be_made_are_reported(work, options, of, words):
    with pytest.raises(BadInput, match=words):
        recolored(work, of, **options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bases": 3}, "bases must be 4 to 16"),
        ({"smooth_weight": -1.0}, "smooth_weight must be at least 0"),
        ({"palette": ("0=red",)}, "written I=#rrggbb"),
        ({"palette": ("0=#ffffff",), "filter": "space"}, "needs a point"),
        ({"palette": ("0=#ffffff",), "reach": 1.0}, "needs --at VIEW:X,Y"),
        ({"at": ("a:1,1",)}, "say how with --palette"),
        ({"at": ("a",), "palette": ("0=#ffffff",)}, "VIEW:X,Y"),
        ({"view_scale": -1.0}, "view_scale must be at least 0"),
    ],
)
def test_options_that_mean_nothing(options, words):
    with pytest.raises(ValueError, match=words):
        PaletteFieldConfig(**options)


def test_options_of_both_stages_are_reported_apart():
    config = PaletteFieldConfig(bases=5, budget="40", palette=("0=#ffffff",), view_scale=0.0, guide_weight=0.5)
    assert config.learning == DecomposeConfig(bases=5, budget="40", guide_weight=0.5)
    assert config.changes == RecolorConfig(palette=("0=#ffffff",), view_scale=0.0) and config.changes
    assert not PaletteFieldConfig().changes and PaletteFieldConfig(offset_scale=0.5).changes
    settings, weights = settings_of(config.learning), weights_of(config.learning)
    assert (settings.steps, settings.match, weights.guide, weights.sparsity) == (40, "none", 0.5, 2e-3)


def test_the_palette_of_a_whole_field_is_reported_by_what_learned_it(work):
    new = recolored(work, palette=("0=#ff00ff",))
    assert palette_behind(new).name == "new" and palette_behind(work.get("field", "plain")) is None
    (row,) = palette_rows(new, False)
    assert row == {"name": "new", **FIGURES}
    assert palette_rows(work.get("field", "plain"), True) == [] and palette_rows(None, False) == []
    assert palette_facts(new)["palette_pixels"] == "the opaque pixels"
    assert palette_facts(work.get("field", "plain"))["palette_pixels"] == "the region's pixels"
