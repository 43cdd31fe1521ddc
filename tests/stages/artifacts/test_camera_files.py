"""`--path FILE`: cameras of a transforms.json and of nerfstudio's camera_path.json come to where the scene has them."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import BadInput
from stages.artifacts.camera_files import digest_of_cameras, read_cameras
from stages.artifacts.scene import SceneData, load_scene
from tests.stages.importing import imported
from tests.stylerf_cli import capture

GL_FROM_CV = capture.GL_FROM_CV
UNMOVED = np.eye(4)


@pytest.fixture
def scene(posed, tmp_path) -> SceneData:
    """Of four cameras, in a frame that import has turned, moved and scaled."""
    scene = load_scene(imported(posed, tmp_path / "work", test_every=0))
    assert abs(np.cbrt(np.linalg.det(np.array(scene.scene.scene_from_source)[:3, :3])) - 1) > 0.1
    return scene


def written(folder: Path, content: object, name: str = "camera_path.json") -> Path:
    (folder / name).write_text(json.dumps(content))
    return folder / name


def path_of_nerfstudio(frame: np.ndarray = UNMOVED, nested: bool = False, **changes) -> dict:
    """The capture's cameras as nerfstudio's viewer exports them, in a frame [4, 4] that it has of the source."""
    scale = np.cbrt(np.linalg.det(frame[:3, :3]))
    entries = []
    for camera in capture.cameras():
        pose = frame @ camera.world_from_camera
        pose[:3, :3] /= scale
        values = (pose @ GL_FROM_CV).tolist() if nested else (pose @ GL_FROM_CV).ravel().tolist()
        fov = math.degrees(2 * math.atan(capture.HEIGHT / 2 / capture.FOCAL))
        entries.append({"camera_to_world": values, "fov": fov, "aspect": capture.WIDTH / capture.HEIGHT})
    size = {"render_width": capture.WIDTH, "render_height": capture.HEIGHT}
    return {"camera_type": "perspective", **size, "fps": 24, "seconds": 4, "camera_path": entries} | changes


def same(cameras, scene: SceneData) -> None:
    assert [one.name for one in cameras] == ["0000", "0001", "0002", "0003"]
    for found, known in zip(cameras, scene.cameras, strict=True):
        np.testing.assert_allclose(found.world_from_camera, known.world_from_camera, atol=1e-9)
        lens = [(one.width, one.height, one.fx, one.fy, one.cx, one.cy) for one in (found, known)]
        np.testing.assert_allclose(*lens, atol=1e-9)


def test_a_transforms_json_is_in_the_frame_of_the_source(scene, posed, tmp_path):
    """Photos need not be there."""
    content = capture.transforms()
    for frame in content["frames"]:
        frame["file_path"] = "nowhere/" + frame["file_path"]
    found = read_cameras(written(tmp_path, content, "another.json"), scene)
    same(found.cameras, scene)
    assert found.remarks == ()


def test_a_transforms_json_may_tell_an_angle_and_no_size(scene, tmp_path):
    content = {"camera_angle_x": 2 * math.atan(24 / 45), "frames": capture.transforms()["frames"]}
    same(read_cameras(written(tmp_path, content), scene).cameras, scene)


def test_a_lens_distortion_is_left_out_and_said(scene, tmp_path):
    found = read_cameras(written(tmp_path, capture.transforms() | {"k1": 0.1}), scene)
    same(found.cameras, scene)
    assert found.remarks == ("the lens distortion of 4 cameras in camera_path.json is ignored",)


@pytest.mark.parametrize("nested", [True, False])
def test_a_camera_path_alone_is_taken_to_be_in_the_frame_of_the_source(scene, tmp_path, nested):
    found = read_cameras(written(tmp_path, path_of_nerfstudio(nested=nested)), scene)
    same(found.cameras, scene)
    assert "frame of the scene's source" in found.remarks[0]


def test_the_frame_of_nerfstudio_is_undone_where_its_file_lies_beside(scene, tmp_path):
    """dataparser_transforms.json: x' = scale * transform x."""
    turn = capture.cameras()[1].world_from_camera
    path = written(tmp_path, path_of_nerfstudio(np.diag([0.3, 0.3, 0.3, 1]) @ turn))
    alone = digest_of_cameras(path)
    written(tmp_path, {"transform": turn[:3].tolist(), "scale": 0.3}, "dataparser_transforms.json")
    found = read_cameras(path, scene)
    same(found.cameras, scene)
    assert found.remarks == () and digest_of_cameras(path) != alone


def entry(**changes) -> dict:
    content = path_of_nerfstudio()
    content["camera_path"][1] |= changes
    return content


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (path_of_nerfstudio(camera_type="fisheye"), "its camera_type is fisheye, expected perspective"),
        (path_of_nerfstudio(render_width=0), "has an invalid size of 0x36"),
        (path_of_nerfstudio(render_width=1e6 - 1), "camera 0 has 999999x36 pixels; at most"),
        (path_of_nerfstudio(camera_path=[]), "the list of cameras is empty"),
        (path_of_nerfstudio(camera_path=4), "camera_path is not a list"),
        (path_of_nerfstudio(camera_path=[4]), "camera 0 is 4, expected an object"),
        ({"keyframes": [], "fps": 24}, "is an object of fps, keyframes; expected a list of cameras"),
        (entry(fov=0), "camera 1: fov is 0 degrees"),
        (entry(fov=None), "camera 1: fov: found None, expected a number"),
        (entry(camera_to_world=[1.0] * 15), "camera 1: camera_to_world is"),
        (entry(camera_to_world=[math.nan] * 16), "camera 1: camera_to_world: found nan"),
        (entry(camera_to_world=[2.0] * 16), "camera 1: the upper left 3x3 of its pose is not a rotation"),
        (entry(camera_to_world=[10**400] * 16), "camera 1: camera_to_world: found 1000"),
        ({"frames": [{"file_path": "x"}]}, "frame 0"),
        ({"frames": 7}, "has no `frames` list"),
        (7, "is 7; expected a list of cameras"),
    ],
)
def test_files_that_are_no_paths(scene, tmp_path, content, words):
    with pytest.raises(BadInput) as reported:
        read_cameras(written(tmp_path, content), scene)
    assert (
        words in str(reported.value) and str(reported.value).startswith("--path ") and "\n" not in str(reported.value)
    )


@pytest.mark.parametrize("content", [{}, {"transform": [[1, 0, 0, 0]] * 3, "scale": 1}, {"transform": 3, "scale": 1}])
def test_a_frame_of_nerfstudio_that_is_none(scene, tmp_path, content):
    path = written(tmp_path, path_of_nerfstudio())
    written(tmp_path, content, "dataparser_transforms.json")
    with pytest.raises(BadInput, match=r"dataparser_transforms\.json"):
        read_cameras(path, scene)
