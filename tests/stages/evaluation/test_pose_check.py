"""Poses that do not explain their photos are reported: the corner of a room, whose cameras are known exactly, and are
then given wrongly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from schemas.images import to_uint8, write_png
from schemas.scene import Bounds, Scene, View, as_matrix, write_scene
from schemas.work_folder import Artifact, WorkFolder
from stages import nerf_fit
from stages.configs.fit import FitConfig
from stages.evaluation.pose_check import ViewShift, pose_metrics, pose_warning
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.geometry.cameras import Camera
from tests.stages.evaluation_fixture import camera_entry, commit
from tests.stages.importing import Said
from tests.stages.photo_room import photo, textures, walk

COUNT = 14


def right(cameras: list[Camera]) -> list[Camera]:
    return cameras


def turned(cameras: list[Camera]) -> list[Camera]:
    """Each about an axis of its own by 2 degrees."""
    axes = np.random.default_rng(1).normal(size=(len(cameras), 3))
    axes *= np.radians(2) / np.linalg.norm(axes, axis=1, keepdims=True)
    poses = [camera.world_from_camera.copy() for camera in cameras]
    for pose, axis in zip(poses, axes):
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(axis).as_matrix()
    return [replace(camera, world_from_camera=pose) for camera, pose in zip(cameras, poses)]


def raised(cameras: list[Camera]) -> list[Camera]:
    """Every other one higher by 6 % of its distance: a second floor."""
    higher = np.eye(4)
    higher[2, 3] = 0.2
    return [replace(c, world_from_camera=higher @ c.world_from_camera) if i % 2 else c for i, c in enumerate(cameras)]


def reversed_one(cameras: list[Camera]) -> list[Camera]:
    """One of them on its head."""
    roll = np.diag([-1.0, -1, 1, 1])
    return [replace(c, world_from_camera=c.world_from_camera @ roll) if i == 5 else c for i, c in enumerate(cameras)]


def room(work: WorkFolder, given) -> Artifact:
    def write(folder) -> None:
        cameras, faces, views = walk(COUNT, width=96, height=72, focal=90.0), textures(0, 0.02), []
        for camera, wrong in zip(cameras, given(cameras)):
            write_png(folder / f"images/{camera.name}.png", to_uint8(photo(camera, faces)))
            views.append(View(camera.name, f"images/{camera.name}.png", "train", **camera_entry(wrong)))
        bounds = Bounds(((-1, -1, -1), (4, 4, 4)), 0.1, 100.0)
        write_scene(folder, Scene(tuple(views), "unbounded", "made up", bounds, "none", as_matrix(np.eye(4))))

    return commit(work, "scene", "main", "pose_import", {}, write)


def fitted(tmp_path, given) -> tuple[dict, list[str]]:
    """pose_shift_px of a short fit, and its warnings about poses."""
    work, said = WorkFolder(tmp_path / "work"), Said()
    config = FitConfig(budget="80", capacity="fixed:64x8x8", samples=10000, held_out=0)
    inputs = {"scene": room(work, given)}
    made, _ = execute(nerf_fit.SPEC, nerf_fit.run, work, "fit", inputs, config, Context(progress=said))
    return made.manifest.figures["pose_shift_px"], [line for line in said.lines if line.startswith("poses: ")]


def test_correct_poses_give_no_warning(tmp_path):
    figures, lines = fitted(tmp_path, right)
    assert figures["median"] < 0.5 and figures["correlation"] > 0.9 and not lines
    assert figures["views"][figures["worst_view"]][0] == figures["worst"] >= figures["median"]


@pytest.mark.parametrize("given", [turned, pytest.param(raised, marks=pytest.mark.slow)])
def test_wrong_poses_give_a_warning(tmp_path, given):
    figures, (line,) = fitted(tmp_path, given)
    assert figures["median"] > 1.2
    assert f"is {figures['median']:.1f} px" in line
    assert figures["worst_view"] in line and "find new poses with" in line


@pytest.mark.slow
def test_one_wrong_pose_gives_a_warning(tmp_path):
    figures, (line,) = fitted(tmp_path, reversed_one)
    assert line.startswith("poses: p05 differs from its render") and figures["median"] < 0.5


def shifts(pixels: float, correlation: float = 0.95, side: int = 1000) -> list[ViewShift]:
    return [ViewShift(f"v{i}", pixels, pixels / side, correlation, True) for i in range(8)]


@pytest.mark.parametrize(
    ("found", "median"),
    [
        (shifts(1.4), None),
        (shifts(4.0), "4.0 px"),
        (shifts(0.9, side=100), None),  # within a pixel
        ([*shifts(1.4), ViewShift("odd", 20.0, 0.02, 0.95, False)], None),  # a single view that matches its render
        (shifts(4.0, correlation=0.8), None),  # an unfinished field is less precise
        (shifts(8.0, correlation=0.8), "8.0 px"),
        (shifts(40.0, correlation=0.4), None),  # too poor to decide
    ],
)
def test_large_shifts_warn_unless_the_field_is_poor(found, median):
    line = pose_warning(found)
    assert line is None if median is None else median in line


def test_an_outlier_warns_if_the_other_views_match():
    odd = ViewShift("odd", 3.0, 0.003, 0.4, False)
    assert pose_warning([*shifts(1.0), odd]).startswith("poses: odd differs from its render (correlation 0.40")
    assert pose_warning([*shifts(1.0, correlation=0.8), odd]) is None
    assert pose_metrics([*shifts(1.0), odd])["worst_view"] == "odd"
