"""What earlier versions wrote still loads, with the digest that it had: the stored samples are never made again."""

from pathlib import Path

import numpy as np
import pytest

from schemas.exr import FAR_Z, read_exr
from schemas.migrations import CURRENT, renamed_in_3
from schemas.scene import Lens, LensDistortion, read_scene
from schemas.tensors import load_tensors
from schemas.work_folder import Artifact, WorkFolder
from stages.artifacts.edit import load_edit, palette_entries
from stages.artifacts.field import load_field
from stages.artifacts.region import load_region
from stages.artifacts.scene import load_scene
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.region_color import RegionColor

SAMPLES = Path(__file__).parent / "samples"
DIGESTS = {
    "scene-1": "9cce98417dcd0678f7f0547f7274c07fdfc8d0fffccb253f0a7a15fd9fa6c29d",
    "field-1": "5e51e6a83b67724a05bdd6b2579c9e319f98e51c51232d92ec5f8f05db04a9c5",
    "frames-1": "dc0f4bf202f188cb4f695a25937d93671c839dd029d3d2cc57855b6e991b6469",
    "region-1": "99617d3ed443f95e3467c6061ff191f9a9719591cfedc8a110d4f44525553473",
    "edit-dataset-1": "c6bc05efb54d9559fe913ac0ac276658a9b94ea9fc9c267f6c7e28372427c98e",
    "edit-1": "caf07e7ce3077b932faf55a872dc5f39e7e6b228add34541550e96f2da5b5631",
    "report-1": "e2950e6098d9b0f0108cfc6472e39d81391c380519196296b3383dacb6d22c7c",
    "scene-2": "d513108cc1a26d2a12fd913a387afc7b9463a23711f5e0122a70ab55d9b9ecf2",
    "field-2": "d8b4bd71de1acf133a83463579f65542a256e04db2fb0ff9c5e848c931389b54",
    "frames-2": "77bb14702f2c5d46387d81f6a8ea07003ed07d0358638aeccb027070b9f9a58c",
    "region-2": "92cf05d02cef730f241fa1917a5a16ea9a57e6fa54a2b6c22cc6d953b54b5609",
    "edit-dataset-2": "6bd34c90db625305ef56b5954427db14e8788f7c0cf0032b6f74f1dfddee7743",
    "edit-2": "624e8ef096c68767ef392ef73d29359a41ed4470ac538d5b28cccbaf65cdf64b",
    "report-2": "08f66b12e1b62cebbb05f36dd1cfbae4141e244b24950d6424883c1f0d55dfc7",
    "scene-3": "6fabe2805a559d23f0153e8593acecd7d749878254ced58cabf9eacbe136eaaa",
    "field-3": "de31f0b8b00df927c044f22b553ba3d27802894eb9105c3acb6c0ce4c366d5fb",
    "frames-3": "443dbfc6c8cdcf20143745d83a42439be779963c9613826bc8d890543764b7ce",
    "region-3": "d3140f339b8321cfc1b990dcceb36a7c3c52145aa4bf9b22dcafc68a3efdc67d",
    "edit-dataset-3": "21b0cbf92a99cabc2f992374a796908c837a6f13ba37cddc1a0d947f1a703cc3",
    "edit-3": "345382e39995c10d7491cc6adb13875aeb2f0756d8dc0c7c65f0ddca90dde9cb",
    "report-3": "14e840cd56aab38c6fe562497254cc9b7396bc403277066e8cdb2dd554f59095",
    "scene-4": "d93f86ac9b4414d293aec1b00194069f32d042e81be0f7d01a6387a7b90eb33f",
    "export-1": "333e3f171b726144356a68c1b5fdb6d2acc92399ec627f715a3c7f886d1b6c58",
}
THREADS = {1: None, 2: 2, 3: 2, 4: 2}  # by schema: what the manifest records of them


def test_every_schema_of_every_kind_has_a_sample():
    wanted = {f"{kind}-{schema}" for kind, newest in CURRENT.items() for schema in range(1, newest + 1)}
    assert {folder.name for folder in SAMPLES.iterdir()} == wanted == set(DIGESTS)


@pytest.mark.parametrize("name", DIGESTS)
def test_a_sample_loads_verifies_and_keeps_its_digest(name):
    sample = Artifact(SAMPLES / name)
    sample.verify()
    assert sample.digest == DIGESTS[name]
    assert sample.manifest.kind == name.rpartition("-")[0]
    assert sample.manifest.schema == CURRENT[sample.kind]
    first = 3 if sample.kind == "export" else 1  # schema by which other kinds had changed when this one came
    assert sample.manifest.threads == THREADS[max(first, int(name.rpartition("-")[2]))]
    assert (sample.manifest.seconds, sample.manifest.versions["stylerf"]) == (1.25, "0.1.0")


def test_inputs_of_the_samples_are_the_samples():
    for name in DIGESTS:
        for ref in Artifact(SAMPLES / name).manifest.inputs:
            assert ref.digest == DIGESTS[f"{ref.kind}-{name.rpartition('-')[2]}"]


def test_the_scene_sample_reads_as_a_scene():
    scene = read_scene(SAMPLES / "scene-4")
    assert scene.layout == "object" and scene.skipped[0].reason == "cut short" and scene.sfm == {"registered": 1}
    distortion = LensDistortion("brown", (0.01, -0.002), (5e-4, -3e-4))
    assert scene.views[0].lens == Lens(8, 6, 10.5, 10.5, 4, 3.25, distortion)
    assert read_scene(SAMPLES / "scene-3").views[0].lens is None
    data = load_scene(Artifact(SAMPLES / "scene-4"))
    assert data.images(0).shape == (3, 4, 4) and len(data.points.xyz) == 2
    np.testing.assert_array_equal(np.unique(data.truth_depth(0)), np.float32([2, FAR_Z]))


def test_the_exr_and_tensor_samples_read():
    view = read_exr(SAMPLES / "frames-3" / "exr" / "000.exr")
    assert view.attributes == {"field": "toy"} and view.masks["head"].sum() == 2 and view.intrinsics == (5, 5, 2, 1.5)
    tensors, metadata = load_tensors(SAMPLES / "field-3" / "field.safetensors")
    assert tensors["density"].sum() == 8 and metadata == {"kind": "vm"}


def test_names_of_views_are_not_renamed_with_the_keys_of_schema_2():
    stops = {"centre_01": 0.3, "hull": -0.3, "colour": 1, "color": 2}
    content = {"figures": {"exposure_stops": stops, "pose_shift_px": {"views": stops}, "colour": 1}}
    expected = {"exposure_stops": stops, "pose_shift_px": {"views": stops}, "color": 1}
    assert renamed_in_3(content) == {"metrics": expected}


def test_files_of_schema_2_read_under_their_new_names():
    work = WorkFolder(Path(__file__).parent / "written_by_2")
    for name, color in (("palette", PaletteColor), ("patch", RegionColor)):
        field, background = load_field(work.get("field", name))
        assert isinstance(field.color, color) and background == "white"
    edit = work.get("edit", "part")
    assert load_edit(edit).changes.colors[0] == pytest.approx((0.1, 0.2, 0.3))
    assert [color["learned"] for color in palette_entries(edit)] == ["#63c8e6", "#fce960", "#e5a636"]
    assert load_region(work.get("region", "part"))[0].edit.sum() == 27
