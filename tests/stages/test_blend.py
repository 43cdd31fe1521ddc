"""The blend stage on small fields; how its options are read."""

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.work_folder import WorkFolder
from stages import blend
from stages.artifacts.field import load_field, save_field
from stages.artifacts.provenance import palette_behind, shows_its_pictures
from stages.artifacts.region import save_region
from stages.configs.blend import BlendConfig, part_of, text_of
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.editing.edit_grid import Region
from stylerf.fields.region_color import RegionColor
from tests.stages import evaluation_fixture as made
from tests.stylerf.blends import corner, fields, picture
from tests.stylerf.small import SPACES, density, hash_color


@pytest.fixture
def work(tmp_path):
    """A source, its stylizations, one of another density, a region of their space and one of another."""
    work = WorkFolder(tmp_path / "work")
    scene = made.make_scene(work, [0.0], depth=False)
    several = fields()
    several["denser"] = fields()["plain"]
    several["denser"].density = density(9)
    inputs = {"scene": scene}
    for name, field in several.items():
        stage = "nerf_fit" if name == "source" else "stylize"
        made.commit(work, "field", name, stage, inputs, lambda folder, field=field: save_field(folder, field, "white"))
        inputs = {"scene": scene, "field": work.get("field", "source")}
    region = Region(corner(), np.zeros_like(corner()))
    for name, space in (("corner", "box"), ("elsewhere", "frustum")):
        made.commit(
            work, "region", name, "region_select", {"field": work.get("field", "source")},
            lambda folder, space=space: save_region(folder, region, SPACES[space], {}),
        )  # fmt: skip
    return work


def run(work: WorkFolder, *of: str, name: str = "new"):
    config = BlendConfig(of)
    inputs = {"field": work.get("field", "source")}
    for number, part in enumerate(config.parts):
        inputs[f"style.{number}"] = work.get("field", part.field)
        if part.region:
            inputs[f"region.{number}"] = work.get("region", part.region)
    return execute(blend.SPEC, blend.run, work, name, inputs, config, Context())


def test_a_blend_mixes_pictures_by_weight_and_region(work):
    several, marked = fields(), corner()
    mixed, _ = load_field(run(work, "mapped=0.5", "plain=0.2")[0])
    expected = 0.3 * picture(several["source"]) + 0.5 * picture(several["mapped"]) + 0.2 * picture(several["plain"])
    np.testing.assert_allclose(picture(mixed), expected, atol=1e-6)
    artifact, _ = run(work, "mapped", "plain:corner", name="regional")
    below, above = load_field(artifact)[0].color.layers
    assert (below.weight, below.within, above.weight) == (1, None, 1)
    np.testing.assert_array_equal(above.within, marked)


def test_a_blend_is_the_same_bytes_and_reused(work):
    first, reused = run(work, "mapped=0.5", "bent=0.25")
    second, again = run(work, "mapped=0.5", "bent=0.25", name="second")
    assert not reused and not again and first.digest == second.digest
    assert run(work, "mapped=0.5", "bent=0.25")[1]
    figures = first.manifest.figures
    assert (figures["source"], figures["source_weight"], figures["layers"]) == ("source", 0.25, 3)
    assert figures["displaced"] and load_field(first)[1] == "white"
    assert not shows_its_pictures(first) and palette_behind(first) is None


def test_what_cannot_be_blended_leaves_nothing_behind(work):
    with pytest.raises(BadInput, match="field denser cannot be blended: its density was trained further"):
        run(work, "denser=0.5")
    with pytest.raises(BadInput, match="region elsewhere was selected on a different field than plain"):
        run(work, "plain:elsewhere")
    assert sorted(one.name for one in (work.root / "field").iterdir() if one.is_dir()) == sorted([*fields(), "denser"])


@pytest.mark.parametrize(
    ("of", "weights"),
    [
        (("a=0.4", "b=0.6"), [0.4, 0.6]),
        (("a", "b", "c"), [1 / 3] * 3),
        (("a=0.5", "b", "c"), [0.5, 0.25, 0.25]),
        (("a", "b:shovel", "c:wheel=0.3"), [1, 1, 0.3]),
        (("a=0.2", "b:shovel"), [0.2, 1]),
        (("a=0",), [0]),
        (tuple(f"{name}=0.1" for name in "abcdefghij"), [0.1] * 10),
    ],
)
def test_fields_without_a_weight_share_what_is_left(of, weights):
    assert [part.weight for part in BlendConfig(of).parts] == pytest.approx(weights)


def test_parts_are_written_as_they_are_read():
    for text in ("a", "a=0.25", "a.b+c-d:shovel", "a:shovel=1e-05"):
        assert text_of(part_of(text)) == text


@pytest.mark.parametrize(
    ("of", "why"),
    [
        (("a=0.7", "b=0.4"), "add up to 1.1"),
        (("a=1", "b"), "the other weights add up to 1"),
        (("a",), "alone is not a blend"),
        (("a", "a=0.2"), "names a 2 times"),
        (("a:x", "a:x"), "names a:x 2 times"),
        (("a=-0.1",), "a number of 0 to 1"),
        (("a=nan",), "a number of 0 to 1"),
        (("a=half",), "a number of 0 to 1"),
        (("a:",), "is not written FIELD"),
        (("=0.5",), "is not written FIELD"),
        (("a:x:y",), "is not written FIELD"),
    ],
)
def test_weights_that_cannot_be_are_refused(of, why):
    with pytest.raises(ValueError, match=why):
        BlendConfig(of)


def test_a_regions_own_colors_are_blended_too(work):
    several = fields()
    source, patched = several["source"], several["plain"]
    patched.color = RegionColor(source.color, hash_color(9), corner())
    inputs = {"field": work.get("field", "source")}
    made.commit(work, "field", "edited", "finetune", inputs, lambda folder: save_field(folder, patched, "white"))
    found, _ = load_field(run(work, "edited=0.5")[0])
    np.testing.assert_allclose(picture(found), 0.5 * (picture(source) + picture(patched)), atol=1e-6)
