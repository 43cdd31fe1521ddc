"""Splats as a source: rendered where their cameras see them, from every list of cameras that is known."""

import json
import shutil

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.images import read_image
from stages.readers import found_in
from stages.readers.splats import _listed, files_of, rendered, splats_in
from stages.run.progress import Context
from tests.stages.importing import Said, imported, scene_of
from tests.stages.splat_scene import around, ball, entry, write_output, write_ply


@pytest.fixture
def output(tmp_path):
    return write_output(tmp_path / "output")


def test_the_last_iteration_and_its_cameras_are_found(output):
    assert splats_in(output).parent.name == "iteration_30000"
    assert found_in(output).kind == "splats" and found_in(splats_in(output)).kind == "splats"
    assert files_of(splats_in(output), "").cameras == output / "cameras.json"


def test_pictures_show_the_colors_where_the_cameras_see_them(output, tmp_path):
    """The ball's color at a pixel is known: of where its ray meets the unit sphere."""
    scene = rendered(files_of(output, ""), tmp_path / "r", Context())
    assert [one.source for one in scene.cameras] == [camera.name for camera in around()]
    for one, camera in zip(scene.cameras, around(), strict=True):
        pixels = read_image(one.image).pixels.reshape(-1, 4)
        origins, ways = (np.asarray(values, float) for values in camera.rays())
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        half = (origins * ways).sum(1)
        root = half**2 - (origins**2).sum(1) + 1
        inside, outside = root > 0.15, root < -0.6
        hit = origins + (-half - np.sqrt(np.maximum(root, 0)))[:, None] * ways
        error = np.abs(pixels[inside, :3] - (0.5 + 0.4 * np.sin(4 * hit[inside])))
        # Splats of 0.06 blur the pattern; seen from any other camera it is off by 0.3.
        assert error.mean() < 0.08 and pixels[inside, 3].mean() > 0.97
        assert pixels[outside, 3].max() == 0


def test_a_splat_folder_becomes_an_object(output, tmp_path):
    said = Said()
    scene = scene_of(imported(output, tmp_path / "w", said))
    assert scene.layout == "object" and scene.background == "alpha" and len(scene.views) == 8
    assert "1500 splats seen by 8 cameras (cameras.json of 3DGS)" in said.lines
    assert scene_of(imported(output, tmp_path / "w2")) == scene


def test_other_cameras_without_photos_do(output, tmp_path):
    """A transforms.json, OpenGL axes, whose photos are nowhere."""
    flip = np.diag([1.0, -1, -1, 1])
    frames = [
        {"file_path": f"{camera.name}.png", "transform_matrix": (camera.world_from_camera @ flip).tolist()}
        for camera in around(6)
    ]
    listed = {"w": 64, "h": 48, "fl_x": 55.0, "fl_y": 55.0, "frames": frames}
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / "transforms.json").write_text(json.dumps(listed))
    alone = shutil.copy(splats_in(output), tmp_path / "alone.ply")
    scene = rendered(files_of(alone, str(tmp_path / "t" / "transforms.json")), tmp_path / "r", Context())
    (tmp_path / "cameras.json").write_text(json.dumps([entry(camera) for camera in around(6)]))
    same = rendered(files_of(alone, ""), tmp_path / "s", Context())
    for one, other in zip(scene.cameras, same.cameras, strict=True):
        assert np.abs(read_image(one.image).pixels - read_image(other.image).pixels).max() < 0.02


def test_interrupted_rendering_goes_on(output, tmp_path):
    files = files_of(output, "")
    first = rendered(files, tmp_path / "r", Context())
    stored = [one.image.read_bytes() for one in first.cameras]
    first.cameras[3].image.write_bytes(b"cut")
    again = rendered(files, tmp_path / "r", Context())
    assert [one.image.read_bytes() for one in again.cameras] == stored


def changed(key, value):
    def change(listed):
        listed[2][key] = value
        return listed

    return change


FAULTS = {
    "no list entry": (lambda listed: [3], "camera 0 is 3, expected an object"),
    "empty": (lambda listed: [], "lists 0 cameras"),
    "nan": (changed("fx", float("nan")), "camera 2: fx: found nan"),
    "negative": (changed("fx", -3.0), "focal length -3"),
    "no rotation": (changed("rotation", [[1, 0, 0]] * 3), "im_02: "),
    "two rows": (changed("rotation", [[1, 0, 0]] * 2), "camera 2: its rotation is not a list of 3 rows"),
    "huge": (changed("width", 10**9), "has an invalid size of 1e"),
    "elsewhere": (
        lambda listed: [one | {"position": [1e5, 0, 0], "rotation": np.eye(3).tolist()} for one in listed],
        "no camera sees any splat",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_cameras_are_refused_in_one_line(output, tmp_path, fault):
    change, why = FAULTS[fault]
    (output / "cameras.json").write_text(json.dumps(change([entry(camera) for camera in around()])))
    with pytest.raises(BadInput, match=why) as refused:
        imported(output, tmp_path / "w")
    assert "\n" not in str(refused.value)


def test_every_camera_keeps_a_name_of_its_own(tmp_path):
    listed = [entry(camera) | {"img_name": name} for camera, name in zip(around(), ("a-00002", "a", "a"), strict=False)]
    (tmp_path / "cameras.json").write_text(json.dumps(listed))
    assert [one.name for one in _listed(tmp_path / "cameras.json")] == ["a-00002", "a", "a-00002-00002"]


def test_what_splats_need_and_what_others_do_not_take(output, tmp_path):
    alone = write_ply(tmp_path / "a" / "b" / "c" / "alone.ply", ball(10))
    with pytest.raises(BadInput, match="comes without cameras; give them with --cameras"):
        imported(alone, tmp_path / "w")
    with pytest.raises(BadInput, match=r"--cameras nowhere\.json: no such file"):
        files_of(alone, "nowhere.json")
    with pytest.raises(BadInput, match="--frames is for video"):
        imported(output, tmp_path / "w", frames=20)
    with pytest.raises(BadInput, match=r"--images .*leave it out"):
        imported(output, tmp_path / "w", images="x")
