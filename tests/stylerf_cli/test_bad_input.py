"""Captures that cannot be used end the import with exit code 3 and one line that names what is wrong; nothing is left
of them in the work folder."""

import json
import math
import os
import pickle
import struct
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.exr import ExrView, write_exr
from schemas.images import write_png
from stylerf_cli.main import main
from tests.stylerf_cli import capture

NAN, INF = math.nan, math.inf
# A warning would be a second line on stderr.
pytestmark = pytest.mark.filterwarnings("error")


def reported(capsys, *arguments, code: int = 3) -> str:
    """The one line on stderr of a command that must end with `code`."""
    assert main([*map(str, arguments), "--quiet"]) == code, capsys.readouterr().err
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and err.startswith("stylerf: error: "), err
    return err


def refused(folder: Path, capsys, *options) -> str:
    """What the import of `folder` is refused with."""
    work = folder.parent / "work"
    line = reported(capsys, "import", folder, work, *options)
    assert [item.name for item in work.glob("scene/*") if item.name != ".main.lock"] == []
    return line


def test_the_capture_itself_is_sound(source, tmp_path):
    """Else the refusals below would prove nothing."""
    capture.write_transforms(source, capture.transforms())
    assert main(["import", str(source), str(tmp_path / "transforms"), "--quiet"]) == 0
    (source / "transforms.json").unlink()
    capture.write_colmap(source)
    assert main(["import", str(source), str(tmp_path / "colmap"), "--quiet"]) == 0
    np.save(source / "poses_bounds.npy", capture.llff())
    assert main(["import", str(source), str(tmp_path / "llff"), "--format", "llff", "--quiet"]) == 0
    scenes = [
        json.loads((tmp_path / kind / "scene/main/scene.json").read_text()) for kind in ("transforms", "colmap", "llff")
    ]
    for scene in scenes:
        assert [round(view["fx"], 6) for view in scene["views"]] == [capture.FOCAL] * 4


def test_a_second_scene_in_a_work_folder_is_refused(posed, tmp_path, capsys):
    def imported(*name: str) -> list:
        return ["import", posed, tmp_path / "work", *name]

    assert main([*map(str, imported("--name", "den")), "--quiet"]) == 0
    assert "already holds scene den" in reported(capsys, *imported(), code=2)
    assert main([*map(str, imported("--name", "den", "--downscale", "2")), "--quiet"]) == 0
    assert [item.name for item in (tmp_path / "work/scene").glob("[!.]*")] == ["den"]


# -- photos ------------------------------------------------------------------------------------------------------------


def test_no_photos(tmp_path, capsys):
    (tmp_path / "source").mkdir()
    assert "contains no photos" in refused(tmp_path / "source", capsys)
    assert "does not exist" in refused(tmp_path / "nowhere", capsys)
    (tmp_path / "source" / "IMG_1.HEIC").write_bytes(b"x")
    line = refused(tmp_path / "source", capsys)
    assert f"convert them to JPEG or PNG, with ImageMagick: mogrify -format jpg {tmp_path}/source/*.HEIC" in line
    (tmp_path / "my film.mp4").write_bytes(b"x")
    assert f"{tmp_path}/my film.mp4 is not a readable video" in refused(tmp_path / "my film.mp4", capsys)


def test_one_photo(source, capsys):
    """Without poses, and with one."""
    for photo in sorted((source / "images").iterdir())[1:]:
        photo.unlink()
    assert "1 of 1 photos can be used; structure from motion needs at least 3" in refused(source, capsys)
    content = capture.transforms()
    capture.write_transforms(source, {**content, "frames": content["frames"][:1]})
    assert "at least 2 are needed" in refused(source, capsys)


def test_photos_of_which_too_few_are_left_to_train_on(posed, capsys):
    """Of two photos the first is kept for tests."""
    assert "leaves no photo to train on" in reported(capsys, "import", posed, posed.parent, "--test-every", "1", code=2)
    content = capture.transforms()
    capture.write_transforms(posed, {**content, "frames": content["frames"][:2]})
    work = posed.parent / "work"
    assert main(["import", str(posed), str(work), "--quiet"]) == 0
    capsys.readouterr()
    line = reported(capsys, "fit", work)
    assert (
        "only 1 of 2 views is for training" in line
        and "--test-every 0" in line
        and not (work / "field" / "fit").exists()
    )


def test_black_photos(posed, capsys):
    write_png(posed / "images" / "p02.png", np.full((36, 48, 3), 2, np.uint8))
    line = refused(posed, capsys)
    assert "p02.png is black; remove it" in line
    (posed / "transforms.json").unlink()
    for photo in (posed / "images").iterdir():
        write_png(photo, np.zeros((36, 48, 3), np.uint8))
    assert "0 of 4 photos can be used (p00.png: it is black)" in refused(posed, capsys)


@pytest.mark.parametrize("suffix", ["jpg", "png", "exr"])
@pytest.mark.parametrize("keep", [0.1, 0.6, 0.95])
def test_truncated_photos(posed, capsys, suffix, keep):
    (posed / "images" / "p01.png").unlink()
    whole = posed / "images" / f"p01.{suffix}"
    random = np.random.default_rng(0)
    pixels = random.integers(0, 256, (36, 48, 3)).astype(np.uint8)
    image = oiio.ImageBuf(pixels)
    assert image.write(str(whole), "half" if suffix == "exr" else "uint8")
    content = capture.transforms()
    content["frames"][1]["file_path"] = f"images/p01.{suffix}"
    capture.write_transforms(posed, content)
    assert main(["import", str(posed), str(posed.parent / "sound"), "--quiet"]) == 0
    capsys.readouterr()
    data = whole.read_bytes()
    whole.write_bytes(data[: int(keep * len(data))])
    line = refused(posed, capsys)
    assert f"p01.{suffix}" in line and "replace or remove it" in line
    assert line.count(str(whole)) == 1 and "(it)" not in line


def test_truncated_truth_and_masks(posed, capsys):
    """Pictures beside the photos are read as strictly."""
    write_png(posed / "masks" / "p03.png", np.full((36, 48), 255, np.uint8))
    mask = posed / "masks" / "p03.png"
    mask.write_bytes(mask.read_bytes()[:60])
    assert "masks/p03.png" in refused(posed, capsys)
    write_png(mask, np.full((18, 30), 255, np.uint8))
    assert "p03.png is 30x18, but its photo is 48x36" in refused(posed, capsys)
    mask.unlink()
    flat = np.ones((36, 48), np.float32)
    view = ExrView(np.ones((36, 48, 3), np.float32), flat, flat, flat, np.eye(4), (45, 45, 24, 18), 0.1, 9.0)
    write_exr(posed / "truth" / "depth_p00.exr", view)
    depth = posed / "truth" / "depth_p00.exr"
    depth.write_bytes(depth.read_bytes()[:-300])
    assert "depth_p00.exr" in refused(posed, capsys)


def test_a_photo_whose_name_is_not_utf_8(source, capsys):
    """Alone and among poses."""
    os.rename(source / "images" / "p01.png", os.fsencode(source / "images") + b"/p\xff.png")
    assert "images/p\\xff.png: its name is not UTF-8; rename it" in refused(source, capsys)
    np.save(source / "poses_bounds.npy", capture.llff())
    assert "images/p\\xff.png: its name is not UTF-8; rename it" in refused(source, capsys)


def test_missing_photos_are_named_and_too_many_missing_refused(posed, tmp_path, capsys):
    (posed / "images" / "p01.png").unlink()
    assert main(["import", str(posed), str(tmp_path / "three")]) == 0
    out, err = capsys.readouterr()
    assert "1 of 4 listed photos have no image file: images/p01.png" in err
    assert "skipped     1 (no such image file): images/p01.png" in out
    for name in ("p02", "p03"):
        (posed / "images" / f"{name}.png").unlink()
    line = refused(posed, capsys)
    assert "1 of 4 listed photos found" in line and "images/p01.png" in line and "--images" in line


def test_a_photo_of_another_size_than_its_camera(posed, capsys):
    write_png(posed / "images" / "p02.png", np.full((40, 48, 3), 99, np.uint8))
    line = refused(posed, capsys)
    assert "images/p02.png: the photo is 48x40, but its camera expects 48x36" in line


def test_names_that_lead_out_of_the_folder_stay_inside_the_artifacts(source, tmp_path):
    """Nothing is read from outside either: photos are found by the end of their paths, and named by where they lie."""
    capture.write_colmap(source)
    listed = source / "sparse" / "0" / "images.txt"
    listed.write_text(listed.read_text().replace(" p0", " ../../source/images/p0"))
    assert main(["import", str(source), str(tmp_path / "work"), "--quiet"]) == 0
    scene = json.loads((tmp_path / "work/scene/main/scene.json").read_text())
    assert [view["name"] for view in scene["views"]] == [f"p0{number}" for number in range(4)]


@pytest.mark.parametrize("kind", ["transforms", "colmap", "llff"])
def test_photos_of_one_stem_are_views_of_two_names(source, tmp_path, kind):
    (source / "images" / "p01.png").unlink()
    random = np.random.default_rng(0)
    assert oiio.ImageBuf(random.integers(0, 256, (36, 48, 3)).astype(np.uint8)).write(
        str(source / "images" / "p00.jpg")
    )
    if kind == "transforms":
        content = capture.transforms()
        content["frames"][1]["file_path"] = "images/p00.jpg"
        capture.write_transforms(source, content)
    elif kind == "colmap":
        capture.write_colmap(source)
        listed = source / "sparse" / "0" / "images.txt"
        listed.write_text(listed.read_text().replace("p01.png", "p00.jpg"))
    else:
        np.save(source / "poses_bounds.npy", capture.llff())
    assert main(["import", str(source), str(tmp_path / "work"), "--quiet"]) == 0
    scene = json.loads((tmp_path / "work/scene/main/scene.json").read_text())
    names = sorted(view["name"].removeprefix("images/") for view in scene["views"])
    assert names == ["p00.jpg", "p00.png", "p02", "p03"]


# -- poses and lenses --------------------------------------------------------------------------------------------------


def damaged_pose(change) -> dict:
    content = capture.transforms()
    pose = np.array(content["frames"][2]["transform_matrix"])
    content["frames"][2]["transform_matrix"] = change(pose)
    return content


def put(pose: np.ndarray, row: int, column: int, value: float) -> list:
    pose[row, column] = value
    return pose.tolist()


POSES = {
    "NaN": (lambda pose: put(pose, 0, 0, NAN), "NaN or infinity"),
    "infinite center": (lambda pose: put(pose, 1, 3, INF), "NaN or infinity"),
    "stretched": (lambda pose: (pose * [[2, 2, 1, 1]]).tolist(), "is not a rotation"),
    "transposed": (lambda pose: pose.T.tolist(), "as its last row, expected 0 0 0 1; is it transposed?"),
    "mirrored": (lambda pose: (pose * [[-1, 1, 1, 1]]).tolist(), "mirrored"),
    "zero": (lambda pose: np.diag([0.0, 0, 0, 1]).tolist(), "is not a rotation"),
    "3x3": (lambda pose: pose[:3, :3].tolist(), "not a 4x4 matrix"),
    "ragged": (lambda pose: [[1, 2], [3]], "not a 4x4 matrix"),
    "text": (lambda pose: "identity", "not a 4x4 matrix"),
}


@pytest.mark.parametrize("name", POSES)
def test_poses_that_are_none(source, capsys, name):
    change, words = POSES[name]
    capture.write_transforms(source, damaged_pose(change))
    line = refused(source, capsys)
    assert words in line and ("p02" in line or "frame 2" in line)


LENSES = {
    "zero focal": ({"fl_x": 0.0}, "focal length 0"),
    "negative focal": ({"fl_y": -3.0}, "must be positive"),
    "NaN focal": ({"fl_x": NAN}, "must be positive"),
    "focal in words": ({"fl_x": "long"}, "fl_x is 'long', expected a number"),
    "no lens": ({"fl_x": ..., "fl_y": ...}, "has no focal length: neither fl_x nor camera_angle_x"),
    "zero angle": ({"fl_x": ..., "camera_angle_x": 0.0}, "its horizontal field of view, 0, is not between 0 and pi"),
    "unknown model": ({"camera_model": "EQUIRECTANGULAR"}, "camera model EQUIRECTANGULAR"),
    "NaN distortion": ({"k1": NAN}, "not finite"),
    "NaN tangential distortion": ({"p1": NAN}, "not finite"),
    "folded distortion": ({"k1": -9.0}, "p00"),
}


@pytest.mark.parametrize("name", LENSES)
def test_lenses_that_are_none(source, capsys, name):
    changes, words = LENSES[name]
    content = {key: value for key, value in (capture.transforms() | changes).items() if value is not ...}
    capture.write_transforms(source, content)
    assert words in refused(source, capsys)


def test_cameras_of_colmap_that_are_none(source, capsys):
    for camera, words in (
        ("1 HOLOGRAM 48 36 45 45 24 18", "unknown model HOLOGRAM"),
        ("1 PINHOLE 48 36 0 0 24 18", "focal length 0"),
        ("1 PINHOLE 48 36 nan 45 24 18", "cameras.txt is damaged"),
        ("1 PINHOLE 48 36 45", "has 1 parameters, but PINHOLE has 4"),
        ("1 PINHOLE 50 36 45 45 24 18", "the photo is 48x36, but its camera expects 50x36"),
        ("2 PINHOLE 48 36 45 45 24 18", "has camera 1, which is missing"),
    ):
        capture.write_colmap(source, camera)
        assert words in refused(source, capsys)
        for item in (source / "sparse" / "0").iterdir():
            item.unlink()
        (source / "sparse" / "0").rmdir()
    model = source / "sparse" / "0"
    model.mkdir()
    (model / "cameras.bin").write_bytes(struct.pack("<QIiQQ4d", 1, 1, 77, 48, 36, 45, 45, 24, 18))
    (model / "images.bin").write_bytes(struct.pack("<Q", 0))
    assert "number 77" in refused(source, capsys)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda rows: rows[:3], "has 3 poses but"),
        (lambda rows: rows[:, :16], "expected n x 17"),
        (lambda rows: np.where(np.arange(17) == 16, 0.5, rows), "depth bounds"),
        (lambda rows: np.where(np.arange(17) == 14, 0.0, rows), "focal length 0"),
        (lambda rows: np.where(np.arange(17) == 0, NAN, rows), "NaN or infinity"),
        (lambda rows: np.where(np.arange(17) == 9, NAN, rows), "has an invalid size"),
        (lambda rows: rows.astype(object), "cannot be read"),
    ],
)
def test_poses_of_llff_that_are_none(source, capsys, spoil, words):
    np.save(source / "poses_bounds.npy", spoil(capture.llff()), allow_pickle=True)
    assert words in refused(source, capsys)


def npy(header: str, data: bytes = b"") -> bytes:
    """A .npy file of version 1 with this header, whatever it says."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header.encode() + b"\n" + data


NO_POSES = {
    "npz": (None, "a zip archive like .npz"),
    "pickle": (pickle.dumps([1, 2]), "not a .npy file"),
    "huge": (
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (9000000000, 17)}"),
        "truncated: its header declares",
    ),
    "deep": (npy("{'descr': " + "[" * 5000 + "}"), "cannot be read"),
    "long": (npy("{" + " " * 50000 + "}"), "cannot be read"),
    "objects": (npy("{'descr': '|O', 'fortran_order': False, 'shape': (0, 17)}"), "cannot be read"),
    "named columns": (npy("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (0, 17)}"), "expected n x 17"),
    "negative": (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 17)}", b"0" * 136), "cannot be read"),
    "text": (b"1 2 3\n", "not a .npy file"),
}


@pytest.mark.parametrize("name", NO_POSES)
def test_files_named_as_poses_of_llff(source, capsys, name):
    data, words = NO_POSES[name]
    if data is None:
        np.savez(source / "poses.npz", capture.llff())
        (source / "poses.npz").rename(source / "poses_bounds.npy")
    else:
        (source / "poses_bounds.npy").write_bytes(data)
    assert words in refused(source, capsys)


def test_cameras_of_llff_at_one_point(source, capsys):
    rows = capture.llff()
    rows[:, [3, 8, 13]] = 0.1, 0.2, 0.3
    np.save(source / "poses_bounds.npy", rows)
    assert "all cameras are at one point" in refused(source, capsys)


@pytest.mark.parametrize("name", ["transforms.json", "transforms_a.json"])
def test_a_list_that_is_a_pipe(source, capsys, name):
    os.mkfifo(source / name)
    assert f"{name} is a named pipe, not a file" in refused(source, capsys)


@pytest.mark.parametrize("keep", [0, 20, 200])
def test_truncated_lists_of_poses(source, capsys, keep):
    capture.write_transforms(source, capture.transforms())
    whole = source / "transforms.json"
    whole.write_bytes(whole.read_bytes()[:keep])
    assert "transforms.json is not valid JSON" in refused(source, capsys)
    whole.unlink()
    np.save(source / "poses_bounds.npy", capture.llff())
    (source / "poses_bounds.npy").write_bytes((source / "poses_bounds.npy").read_bytes()[:keep])
    assert "poses_bounds.npy cannot be read" in refused(source, capsys)
