"""Splats of a solid ball: where they are, what they look like from held-out views, and what is refused."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.errors import BadInput, OutOfResources
from schemas.work_folder import Artifact, WorkFolder
from stages.artifacts.field import save_field
from stages.configs.export import ExportConfig
from stages.exporting import libraries, splats
from stylerf.geometry.space_warp import SpaceWarp
from tests.stages.evaluation_fixture import commit
from tests.stages.exporting.fixture import exported
from tests.stages.stress_fixture import make_capture
from tests.stylerf.surfaces.fields import ball, solid

CENTER = np.array([0.1, -0.2, 0.3])
SMALL = {"kind": "splats", "splats": 1500, "budget": "160", "units": "scene"}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> dict[str, Artifact]:
    """A ball of radius 0.5 about CENTER, seen from a dome of cameras."""
    work = WorkFolder(tmp_path_factory.mktemp("export") / "work")
    scene = make_capture(work)
    field = solid(lambda points: ball(points - CENTER), SpaceWarp.box([-1, -1, -1], [1, 1, 1]))
    made = commit(work, "field", "fit", "nerf_fit", {"scene": scene}, lambda at: save_field(at, field, "white"))
    return {"scene": scene, "field": made}


@pytest.fixture(scope="module")
def made(inputs, tmp_path_factory):
    return exported(tmp_path_factory.mktemp("made"), inputs, formats="ply,glb", **SMALL)


def centers_of(path) -> np.ndarray:
    header, body = path.read_bytes().split(b"end_header\n")
    properties = header.count(b"property float")
    return np.frombuffer(body, "<f4").reshape(-1, properties)[:, :3]


def test_splats_are_placed_on_the_ball(inputs, tmp_path):
    made = exported(tmp_path, inputs, formats="ply", **SMALL | {"budget": "1"})
    centers = centers_of(made.path / "splats.ply")
    assert 300 < len(centers) == made.manifest.figures["splats"] <= 1500
    distances = np.linalg.norm(centers - CENTER, axis=1)
    assert np.percentile(np.abs(distances - 0.5), 95) < 0.1


def test_splats_look_like_the_field_from_held_out_views(made):
    figures = made.manifest.figures
    assert figures["psnr_to_field"] > 35 and figures["steps"] == 160 and figures["held_out_views"] >= 1
    assert {"psnr_to_photos", "field_psnr_to_photos"} <= set(figures)


@pytest.mark.parametrize("stage", ["stylize", "recolor", "finetune"])
def test_splats_of_an_edited_field_are_not_compared_with_the_photos(inputs, tmp_path, stage):
    work, scene = WorkFolder(tmp_path / "work"), inputs["scene"]
    field = solid(lambda points: ball(points - CENTER), SpaceWarp.box([-1, -1, -1], [1, 1, 1]))
    edited = commit(work, "field", "edited", stage, {"scene": scene}, lambda at: save_field(at, field, "white"))
    figures = exported(tmp_path / "out", {"scene": scene, "field": edited}, **SMALL | {"budget": "1"}).manifest.figures
    assert "psnr_to_field" in figures and "psnr_to_photos" not in figures


def test_steps_repeat_to_the_bit(made, inputs, tmp_path):
    again = exported(tmp_path, inputs, formats="ply,glb", **SMALL)
    for name in ("splats.ply", "splats.glb"):
        assert (again.path / name).read_bytes() == (made.path / name).read_bytes()


def test_a_usd_file_of_splats_has_a_ply_beside_it(inputs, tmp_path):
    volumes = pytest.importorskip("pxr.UsdVol")
    if not hasattr(volumes, "ParticleField3DGaussianSplat"):
        pytest.skip("the installed OpenUSD has no prim for splats")
    made = exported(tmp_path, inputs, formats="usda", **SMALL | {"budget": "1"})
    assert made.manifest.figures["files"] == ["splats.usda", "splats.ply"]
    stage = pytest.importorskip("pxr.Usd").Stage.Open(str(made.path / "splats.usda"))
    positions = volumes.ParticleField3DGaussianSplat.Get(stage, "/shot/splats").GetPositionsAttr().Get()
    assert len(positions) == len(centers_of(made.path / "splats.ply"))


def test_an_openusd_without_splats_is_refused_before_anything_is_computed(monkeypatch):
    monkeypatch.delattr(pytest.importorskip("pxr.UsdVol"), "ParticleField3DGaussianSplat", raising=False)
    job = SimpleNamespace(config=ExportConfig(kind="splats", formats="ply,usdc"))
    with pytest.raises(OutOfResources, match=r"need OpenUSD 26\.03 or later"):
        splats.write(job)


def test_a_field_that_shows_nothing_is_refused(inputs, tmp_path):
    work = WorkFolder(tmp_path / "work")
    empty = solid(lambda points: ball(points - 9.0), SpaceWarp.box([-1, -1, -1], [1, 1, 1]))
    scene = inputs["scene"]
    field = commit(work, "field", "fit", "nerf_fit", {"scene": scene}, lambda at: save_field(at, empty, "white"))
    with pytest.raises(BadInput, match="shows nothing"):
        exported(tmp_path / "out", {"scene": scene, "field": field}, formats="ply", **SMALL)


@pytest.mark.parametrize("idle", [{"splats": 5000}, {"budget": "10s"}])
def test_options_of_splats_are_refused_for_meshes(idle):
    with pytest.raises(ValueError, match="has no effect"):
        ExportConfig(kind="mesh", **idle)
    assert replace(ExportConfig(kind="splats"), **idle).chosen == ("ply",)


@pytest.mark.parametrize("wrong", [{"splats": 99}, {"budget": "soon"}, {"formats": "obj"}])
def test_impossible_splats_are_refused(wrong):
    with pytest.raises(ValueError):
        ExportConfig(kind="splats", **wrong)


def test_missing_libraries_are_named(monkeypatch):
    monkeypatch.setitem(libraries.PACKAGES, "no_such_library", "gsply")
    monkeypatch.setitem(libraries.OF_FORMATS, "spz", "no_such_library")
    with pytest.raises(OutOfResources, match="gsply"):
        libraries.check_formats("splats", ("spz",))
    monkeypatch.setattr(libraries.sys, "version_info", (3, 14))
    with pytest.raises(OutOfResources, match=r"no wheel for Python 3\.14, so choose another format"):
        libraries.needed("no_such_library", "--format spz")


def test_splats_as_glb_need_no_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygltflib", None)
    libraries.check_formats("splats", ("glb", "ply"))
    with pytest.raises(OutOfResources, match="--format glb needs pygltflib"):
        libraries.check_formats("mesh", ("glb",))
