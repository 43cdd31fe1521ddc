"""scene.json reads back as written, and every unusable camera or bound is refused in words."""

import dataclasses
import json

import numpy as np
import pytest

from schemas.errors import ArtifactDamaged, BadInput
from schemas.scene import (
    Bounds,
    Lens,
    LensDistortion,
    Scene,
    Skipped,
    Truth,
    View,
    as_matrix,
    read_scene,
    validate_scene,
    write_scene,
)

EYE = as_matrix(np.eye(4))


def scene(**changes) -> Scene:
    views = tuple(
        View(
            f"v{i}", f"images/{i:03d}.png", "test" if i % 8 == 0 else "train", 8, 6, 9.5, 9.25, 4, 3, EYE, f"p/{i}.jpg"
        )
        for i in range(10)
    )
    values = {
        "views": views,
        "layout": "object",
        "layout_reason": "cameras look inward",
        "bounds": Bounds(((-1.5, -1.5, -1.5), (1.5, 1.5, 1.5)), 0.1, 6.0),
        "background": "alpha",
        "scene_from_source": as_matrix(np.diag([2.0, 2, 2, 1])),
        "skipped": (Skipped("p/bad.jpg", "cut short"),),
        "truth": Truth("truth/depth_000.exr"),
        "sfm": {"registered": 10},
    }
    return Scene(**values | changes)


def test_round_trip(tmp_path):
    write_scene(tmp_path, scene())
    assert read_scene(tmp_path) == scene()
    assert scene().split("test") == [0, 8] and len(scene().split("train")) == 8
    stored = json.loads((tmp_path / "scene.json").read_text())
    assert stored["views"][1]["world_from_camera"][3] == [0.0, 0.0, 0.0, 1.0]
    assert stored["truth"] == {"depth": "truth/depth_000.exr"}


def test_poses_keep_every_bit(tmp_path):
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    pose[:3, 0] *= np.sign(np.linalg.det(pose[:3, :3]))
    pose[:3, 3] = [1 / 3, np.pi, -1e-9]
    view = dataclasses.replace(scene().views[0], world_from_camera=as_matrix(pose))
    write_scene(tmp_path, scene(views=(view,)))
    np.testing.assert_array_equal(np.array(read_scene(tmp_path).views[0].world_from_camera), pose)


def test_lenses_are_checked_before_they_are_written(tmp_path):
    telephoto = Lens(60, 40, 1200.0, 1200.0, 30.0, 20.0, LensDistortion(radial=(0.0, 0.0, 2e6)))
    views = (dataclasses.replace(scene().views[0], lens=telephoto),)
    write_scene(tmp_path, scene(views=views))
    assert read_scene(tmp_path).views == views
    beyond = dataclasses.replace(telephoto, distortion=LensDistortion(radial=(1e13,)))
    with pytest.raises(BadInput, match="view v0: lens: radial is"):
        write_scene(tmp_path, scene(views=(dataclasses.replace(views[0], lens=beyond),)))


def test_depth_pattern_counts_in_its_own_width():
    assert Truth("truth/depth_000.exr").depth_file(7) == "truth/depth_007.exr"
    assert Truth("t00/0000.exr").depth_file(1234) == "t00/1234.exr"
    assert Truth().depth_file(3) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fx": 0.0}, "focal"),
        ({"fy": float("nan")}, "focal"),
        ({"width": 0}, "empty"),
        ({"width": 10**9}, "at most 32768"),
        ({"width": 30_000, "height": 30_000}, "at most 32768"),
        ({"fx": 1e-300}, "focal"),
        ({"cx": 1e300}, "principal point"),
        ({"world_from_camera": as_matrix(np.eye(4) + 1e12 * np.eye(4, k=3))}, "units away"),
        ({"split": "val"}, "split"),
        ({"image": "../x.png"}, "inside its folder"),
        ({"image": "/etc/x.png"}, "inside its folder"),
        ({"world_from_camera": as_matrix(np.full((4, 4), np.nan))}, "NaN"),
        ({"world_from_camera": as_matrix(np.diag([1, 1, -1, 1.0]))}, "not a rotation"),
        ({"world_from_camera": as_matrix(np.diag([1, 1.1, 1, 1.0]))}, "not a rotation"),
        ({"world_from_camera": as_matrix(np.diag([1, 1, 1, 2.0]))}, "last row"),
    ],
)
def test_unusable_views_are_refused_by_name(change, words):
    views = (*scene().views[:3], dataclasses.replace(scene().views[3], **change))
    with pytest.raises(BadInput, match=f"view v3.*{words}"):
        validate_scene(scene(views=views))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"views": ()}, "at least one"),
        ({"views": scene().views[:1] * 2}, "2 times"),
        ({"layout": "sideways"}, "layout"),
        ({"background": "pink"}, "background"),
        ({"bounds": Bounds(((0, 0, 0), (1, 0, 1)), 1, 2)}, "empty"),
        ({"bounds": Bounds(((0, 0, 0), (1, float("inf"), 1)), 1, 2)}, "finite"),
        ({"bounds": Bounds(((0, 0, 0), (1, 1, 1)), 2, 1)}, "near"),
        ({"bounds": Bounds(((0, 0, 0), (1, 1, 1)), 1, 1e30)}, "near"),
        ({"bounds": Bounds(((0, 0, 0), (1, 1, 1e300)), 1, 2)}, "beyond"),
        ({"scene_from_source": as_matrix(np.zeros((4, 4)))}, "invertible"),
    ],
)
def test_unusable_scenes_are_refused(change, words):
    with pytest.raises(BadInput, match=words):
        validate_scene(scene(**change))


def test_damaged_scene_files_are_reported(tmp_path):
    with pytest.raises(ArtifactDamaged, match="missing"):
        read_scene(tmp_path)
    write_scene(tmp_path, scene())
    whole = json.loads((tmp_path / "scene.json").read_text())
    for damage in (
        {**whole, "views": [{**whole["views"][0], "zoom": 2}]},
        {**whole, "bounds": {"aabb": [[0, 0], [1, 1]], "near": 1, "far": 2}},
        {**whole, "views": [{**whole["views"][0], "world_from_camera": [[1]]}]},
        {**whole, "surprise": 1},
        {key: value for key, value in whole.items() if key != "layout"},
        [],
    ):
        (tmp_path / "scene.json").write_text(json.dumps(damage))
        with pytest.raises(ArtifactDamaged, match=r"scene\.json is damaged"):
            read_scene(tmp_path)
    (tmp_path / "scene.json").write_text("{")
    with pytest.raises(ArtifactDamaged, match="not valid JSON"):
        read_scene(tmp_path)
