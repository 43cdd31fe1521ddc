"""Poses that do not explain their photos are told: the corner of a room, whose cameras are known exactly, and are then
given wrongly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from schemas.images import to_uint8, write_png
from schemas.scene import Bounds, Scene, View, as_matrix, write_scene
from schemas.store import Artefact, Work
from stages import nerf_fit
from stages.configs.fit import FitConfig
from stages.pose_check import ALIKE, APART, LOST, ViewShift, pose_figures, told
from stages.progress import Context
from stages.runner import execute
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


def swapped(cameras: list[Camera]) -> list[Camera]:
    """Of one photo alone another's pose."""
    return [replace(c, world_from_camera=cameras[3].world_from_camera) if i == 5 else c for i, c in enumerate(cameras)]


def room(work: Work, given) -> Artefact:
    def write(folder) -> None:
        cameras, faces, views = walk(COUNT, width=96, height=72, focal=90.0), textures(0, 0.02), []
        for camera, wrong in zip(cameras, given(cameras)):
            write_png(folder / f"images/{camera.name}.png", to_uint8(photo(camera, faces)))
            views.append(View(camera.name, f"images/{camera.name}.png", "train", **camera_entry(wrong)))
        bounds = Bounds(((-1, -1, -1), (4, 4, 4)), 0.1, 100.0)
        write_scene(folder, Scene(tuple(views), "unbounded", "made up", bounds, "none", as_matrix(np.eye(4))))

    return commit(work, "scene", "main", "pose_import", {}, write)


@pytest.mark.parametrize(("given", "fires"), [(right, ""), (turned, "poses"), (raised, "poses"), (swapped, "pose")])
def test_a_fit_tells_poses_that_do_not_explain_the_photos(tmp_path, given, fires):
    work, said = Work(tmp_path / "work"), Said()
    config = FitConfig(budget="120", capacity="fixed:64x8x8", samples=15000, held_out=0)
    scene = room(work, given)
    made, _ = execute(nerf_fit.SPEC, nerf_fit.run, work, "fit", {"scene": scene}, config, Context(progress=said))
    lines = [line for line in said.lines if line.startswith("poses: ")]
    figures = made.manifest.figures["pose_shift_px"]
    assert len(lines) == bool(fires)
    if fires == "poses":
        assert "the poses do not explain the photos: find new ones with" in lines[0] and figures["median"] > 1
    elif fires:
        assert lines[0].startswith("poses: p05 and its render are ") and figures["worst_view"] == "p05"
    else:
        assert figures["median"] < 0.5
