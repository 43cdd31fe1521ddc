"""`--path FILE` of other programs: unsound files are refused in one line, USD scenes of others are understood."""

import json

import numpy as np
import pytest

from schemas.errors import BadInput
from stages.artifacts import camera_files, placed_cameras
from stages.artifacts.camera_files import digest_of_cameras, read_cameras
from stages.artifacts.scene import load_scene
from stages.artifacts.world_axes import file_from_scene
from stylerf.geometry.scene_normalization import moved
from tests.stages.importing import imported


@pytest.fixture
def scene(posed, tmp_path):
    """Of four cameras, in a frame that import has turned, moved and scaled."""
    return load_scene(imported(posed, tmp_path / "work", test_every=0))


def refusal(path, scene) -> str:
    with pytest.raises(BadInput) as caught:
        read_cameras(path, scene)
    assert "\n" not in str(caught.value)
    return str(caught.value)


GAUSSIAN = {"position": [0, 0, 0], "rotation": np.eye(3).tolist(), "width": 8, "height": 6, "fx": 9.0, "fy": 9.0}


CLIPS = 'def "x" (clips = { dictionary default = { asset[] assetPaths = [@/etc/other.usda@] } }) '


@pytest.mark.parametrize(
    "change, said",
    [
        ({"position": [0, 0]}, "position"),
        ({"position": [0, 0, float("nan")]}, "found nan"),
        ({"rotation": [[1, 0, 0]] * 3}, "not a rotation"),
        ({"rotation": 3}, "not a 3x3 matrix"),
        ({"fx": -1}, "not positive"),
        ({"width": 10**9}, "has an invalid size"),
        ({"width": 500_000, "height": 2}, "at most 32768 per side"),
    ],
)
def test_unsound_cameras_of_3dgs_are_refused(scene, tmp_path, change, said):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([GAUSSIAN, GAUSSIAN | change]))
    assert said in refusal(path, scene)


@pytest.mark.parametrize(
    "text, said",
    [
        ("1 0 0 0 0 0 0 nan", "expected frame tx"),
        ("1 0 0 0 0 0", "expected frame tx"),
        ("1 0 0 0 0 0 0 180", "expected 0 to 180"),
        ("1 0 0 1e30 0 0 0 40", "exceeds"),
        ("one two", "expected frame tx"),
        ("", "the list of cameras is empty"),
        ("\x00\x01", "expected frame tx"),
        ("# a comment\n\none two", "line 3 is"),
    ],
)
def test_unsound_lines_of_chan_are_refused(scene, tmp_path, text, said):
    path = tmp_path / "x.chan"
    path.write_text(text + "\n")
    assert said in refusal(path, scene)


def test_more_cameras_than_an_hour_of_film_are_refused(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(placed_cameras, "MOST_CAMERAS", 3)
    path = tmp_path / "x.chan"
    path.write_text("1 0 0 0 0 0 0 40\n" * 4)
    assert "lists 4 cameras; at most 3" in refusal(path, scene)


def test_a_chan_without_a_field_of_view_has_the_scenes_lens(scene, tmp_path):
    path = tmp_path / "x.chan"
    path.write_text("1 0 0 0 0 0 0\n2 1 0 0 0 90 0\n")
    one, two = read_cameras(path, scene).cameras
    assert one.fy == pytest.approx(scene.cameras[0].fy)
    to_file = file_from_scene(scene, "source", "y")
    # In the file: first along -z, then, turned by 90 degrees about y, along -x.
    np.testing.assert_allclose(moved(one.world_from_camera, to_file)[:3, 2], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(moved(two.world_from_camera, to_file)[:3, 2], [-1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(moved(two.world_from_camera, to_file)[:3, 3], [1, 0, 0], atol=1e-9)


def test_a_folder_without_a_model_and_a_damaged_model_are_refused(scene, tmp_path):
    (tmp_path / "empty").mkdir()
    assert "without a COLMAP model" in refusal(tmp_path / "empty", scene)
    (tmp_path / "empty/cameras.bin").write_bytes(b"\xff" * 40)
    (tmp_path / "empty/images.bin").write_bytes(b"\xff" * 40)
    assert "is damaged" in refusal(tmp_path / "empty", scene)


def test_the_digest_of_a_model_follows_its_files(tmp_path):
    (tmp_path / "cameras.txt").write_text("a")
    (tmp_path / "images.txt").write_text("b")
    before = digest_of_cameras(tmp_path)
    (tmp_path / "images.txt").write_text("c")
    assert digest_of_cameras(tmp_path) != before


USD = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "{up}"
    startTimeCode = 1
    endTimeCode = {end}
)
def Xform "rig"
{{
    double3 xformOp:translate.timeSamples = {{ 1: (0, 0, 0), 3: (2, 0, 0) }}
    double3 xformOp:scale = (3, 3, 3)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    def Camera "cam"
    {{
        float focalLength = {focal}
        float horizontalAperture = 36
        float verticalAperture = 24
        double3 xformOp:translate = (1, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    {more}
}}
"""


SETTINGS = """def RenderSettings "r" {{
        {}
        rel camera = </rig/cam>
    }}"""


def usd(folder, up="Y", end="3", focal="36", more="", text=USD):
    path = folder / "shot.usda"
    path.write_text(text.format(up=up, end=end, focal=focal, more=more))
    return path


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_a_camera_on_a_moving_scaled_rig_is_followed(scene, tmp_path, up):
    found = read_cameras(usd(tmp_path, up), scene)
    to_file = file_from_scene(scene, "source", up.lower())
    placed = [moved(one.world_from_camera, to_file) for one in found.cameras]
    np.testing.assert_allclose([pose[:3, 3] for pose in placed], [[3, 0, 0], [4, 0, 0], [5, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(placed[1][:3, :3], np.diag([1, -1, -1]), atol=1e-6)
    one, like = found.cameras[0], scene.cameras[0]
    # 36 units of focal length for 36 of aperture: as many pixels of focal length as of width.
    assert (one.width, one.fx, one.height) == (like.width, like.width, round(like.width * 24 / 36))
    assert "units of 0.01 m" in found.remarks[0]


@pytest.mark.parametrize(
    "change, said",
    [
        ({"text": "#usda 1.0\n"}, "has 0 cameras"),
        ({"text": "no usd"}, "USD file"),
        ({"end": "1e9"}, "at most 100,000"),
        ({"end": "-5"}, "not a valid range of frames"),
        ({"focal": "0"}, "not positive"),
        ({"focal": "nan"}, "not positive"),
        ({"more": 'def Camera "other" {{}}'.replace("{{}}", "{\n}")}, "has 2 cameras"),
        ({"more": 'def "x" (references = @/etc/passwd@</a>)\n{\n}'}, "refers to other files"),
        ({"more": 'def "x" (payload = @other.usda@)\n{\n}'}, "refers to other files"),
        ({"more": f"{CLIPS}{{\n}}"}, "values from other files (clips of /rig/x)"),
        (
            {"more": f'def "y" (variantSets = "v") {{\nvariantSet "v" = {{\n"a" {{\n{CLIPS}{{\n}}\n}}\n}}\n}}'},
            "clips of /rig/y",
        ),
        ({"end": "1e9"}, "shot.usda lists"),
        ({"up": "X"}, "has X as its up axis, expected Y or Z"),
        ({"text": '#usda 1.0\ndef Camera "c"\n{{\nfloat focalLength = None\n}}'}, "0: focalLength is None, expected"),
        ({"text": USD.replace("float focalLength = {focal}", 'string focalLength = "abc"')}, "focalLength is abc"),
        ({"more": SETTINGS.format("int resolution = 5")}, "resolution is 5, expected two numbers"),
        ({"more": SETTINGS.format("int2 resolution = None")}, "resolution is None, expected two numbers"),
        ({"more": SETTINGS.format('string pixelAspectRatio = "q"')}, "pixelAspectRatio is q, expected a number"),
        ({"text": "#usda 1.0\ndef def"}, "parse error"),
    ],
)
def test_unsound_usd_files_are_refused(scene, tmp_path, change, said):
    assert said in refusal(usd(tmp_path, **change), scene)


def test_a_usd_file_of_random_bytes_is_refused(scene, tmp_path):
    path = tmp_path / "x.usdc"
    path.write_bytes(b"PXR-USDC" + np.random.default_rng(0).bytes(400))
    assert "USD file" in refusal(path, scene)


def test_a_usd_file_that_is_too_large_is_refused(scene, tmp_path, monkeypatch):
    from stages.artifacts import usd_cameras

    monkeypatch.setattr(usd_cameras, "MOST_BYTES", 100)
    assert "at most" in refusal(usd(tmp_path), scene)
    assert camera_files.SUFFIXES == (".usd", ".usda", ".usdc")
