"""What other tools read of a transforms.json: a test for each row of the table in docs/import.md."""

import json
import math
import re
import unicodedata
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.images import to_uint8, write_png
from stages.artifacts.scene import load_scene
from stages.readers import read_source
from stages.readers.background import Background, evidence_of
from tests.conftest import REPOSITORY
from tests.stages.importing import Said, imported, scene_of
from tests.stylerf_cli import capture
from tests.stylerf_cli.capture import FOCAL, GL_FROM_CV, HEIGHT, WIDTH

ROWS = {}


def row(name: str):
    """A test of the row of that name."""

    def kept(test):
        assert name not in ROWS
        ROWS[name] = test
        return test

    return kept


def reported_rows() -> list[str]:
    """The names in the table."""
    page = (REPOSITORY / "docs" / "import.md").read_text()
    return re.findall(r"^\| `([a-z0-9-]+)` \|", page.partition("## transforms.json")[2].partition("\n## ")[0], re.M)


@pytest.mark.parametrize("name", reported_rows())
def test_row(name, source, tmp_path):
    ROWS[name](source, tmp_path)


def test_the_table_has_a_row_for_each_test():
    assert sorted(reported_rows()) == sorted(ROWS)


def listed(**changes) -> dict:
    """The content of a sound list; a value of ... takes a key out."""
    return {key: value for key, value in (capture.transforms() | changes).items() if value is not ...}


def on_frames(content: dict, *changes: dict) -> dict:
    """The same with changes to its first frames; one alone is of all frames."""
    changes = changes * 4 if len(changes) == 1 else changes
    for frame, change in zip(content["frames"], changes, strict=False):
        frame |= change
    return content


def read(source: Path, content: object = None, name: str = "transforms.json", **options):
    """What the reader makes of it."""
    if content is not None:
        text = content if isinstance(content, str) else json.dumps(content)
        (source / name).write_bytes(text.encode("utf-8", "surrogatepass"))
    return read_source(source, "transforms", **options)


def refusal(source: Path, content: object, **options) -> str:
    """The one line with which it is refused."""
    with pytest.raises(BadInput) as fault:
        read(source, content, **options)
    assert "\n" not in str(fault.value)
    return str(fault.value)


def lens(source: Path, work: Path, content: dict, **options) -> np.ndarray:
    """[4, 4] of fx, fy, cx, cy of each view of the imported scene."""
    capture.write_transforms(source, content)
    views = scene_of(imported(source, work, **options)).views
    return np.array([[view.fx, view.fy, view.cx, view.cy] for view in views])


def poses(scene) -> np.ndarray:
    return np.array([one.world_from_camera for one in scene.cameras])


TRUE_POSES = np.array([one.world_from_camera for one in capture.cameras()])
NAMES = [f"images/p{index:02d}.png" for index in range(4)]


# -- the file ----------------------------------------------------------------------------------------------------------


@row("json-comments")
def _(source, tmp_path):
    text = json.dumps(listed(license='http://a.b/*c*/ " // d')).replace('"frames"', '// one\n/* "two" */ "frames"')
    assert [one.source for one in read(source, text).cameras] == NAMES


@row("json-mark")
def _(source, tmp_path):
    assert len(read(source, "\ufeff" + json.dumps(listed())).cameras) == 4


@row("json-broken")
def _(source, tmp_path):
    text = json.dumps(listed())
    for broken in (text[:-1] + ",}", "# made by hand\n" + text, text[:200], text + "/*", '{"a": "' + "/*" * 9):
        if broken.endswith("}/*"):
            assert len(read(source, broken).cameras) == 4  # a comment that does not end is one
        else:
            assert "transforms.json is not valid JSON" in refusal(source, broken)
    for hostile in ('{"' + '\\"' * 400_000 + "\\", "/*" * 400_000, '"' * 400_001):  # minutes, were the time quadratic
        assert "not valid JSON" in refusal(source, hostile)


@row("json-nan")
def _(source, tmp_path):
    assert "cx is nan" in refusal(source, listed(cx=math.nan))
    assert "fl_y is inf" in refusal(source, listed(fl_y=math.inf))
    assert "frame 2: transform_matrix contains NaN" in refusal(
        source, on_frames(listed(), {}, {}, {"transform_matrix": np.full((4, 4), np.nan).tolist()})
    )


@row("json-deep")
def _(source, tmp_path):
    assert "nested too deeply" in refusal(source, '{"frames": ' + "[" * 100_000)


@row("files-train-test")
def _(source, tmp_path):
    for name, frames in (("train", slice(1, 4)), ("test", slice(1))):
        content = {"camera_angle_x": 0.98, "frames": listed()["frames"][frames]}
        read(source, content, f"transforms_{name}.json")
    assert [(one.source, one.split) for one in read(source).cameras] == [
        *((name, "train") for name in NAMES[1:]),
        (NAMES[0], "test"),
    ]


@row("files-train-val")
def _(source, tmp_path):
    read(source, listed(frames=listed()["frames"][1:]), "transforms_train.json")
    found = read(source, listed(frames=listed()["frames"][:1]), "transforms_val.json")
    assert [one.split for one in found.cameras] == ["train"] * 3 + ["test"] and not found.remarks


@row("files-others")
def _(source, tmp_path):
    for name in ("transforms_train", "transforms_test", "transforms_val", "transforms"):
        found = read(source, listed(frames=listed()["frames"][:2]), f"{name}.json")
    assert found.remarks == (
        "ignored in favor of transforms_test.json and transforms_train.json: transforms.json, transforms_val.json; to "
        "use one, give its path instead of the folder",
    )
    assert len(read(source / "transforms.json").cameras) == 2


@row("files-several")
def _(source, tmp_path):
    for name in "ba":
        found = read(source, listed(frames=listed()["frames"][: 2 + (name == "b")]), f"transforms_{name}.json")
    assert len(found.cameras) == 2 and "ignored in favor of transforms_a.json: transforms_b.json" in found.remarks[0]


@row("files-colmap")
def _(source, tmp_path):
    capture.write_colmap(source)
    capture.write_transforms(source, listed())
    said = Said()
    imported(source, tmp_path / "work", said)
    assert "found transforms.json of instant-ngp (also found: colmap; --format picks another)" in said.lines


# -- frames that count -------------------------------------------------------------------------------------------------


@row("splits-by-name")
def _(source, tmp_path):
    lists = {"train_filenames": ["./images/p00.png", "images\\p01.png"], "val_filenames": ["images//p02.png"],
             "test_filenames": [NAMES[3]]}  # fmt: skip
    found = read(source, listed(**lists))
    assert [one.split for one in found.cameras] == ["train", "train", "test", "test"]
    assert not found.remarks and not found.skipped


@row("splits-outside")
def _(source, tmp_path):
    lists = {"train_filenames": NAMES[:2], "test_filenames": NAMES[3:]}
    capture.write_transforms(source, listed(**lists))
    scene = scene_of(imported(source, tmp_path / "work"))
    assert [(view.source, view.split) for view in scene.views] == [
        (NAMES[0], "train"), (NAMES[1], "train"), (NAMES[3], "test"),
    ]  # fmt: skip
    assert [(one.source, one.reason) for one in scene.skipped] == [(NAMES[2], "in no split list")]
    assert read(source).remarks == ("1 frames left out: in no split list",)
    line = refusal(source, listed(train_filenames=["images/p09.png"]))
    assert "lists no frames to import; 4 frames left out: in no split list" in line


@row("splits-lost")
def _(source, tmp_path):
    found = read(source, listed(train_filenames=[*NAMES, "images/p09.png"]))
    assert any("train_filenames names 1 photo (images/p09.png) without a frame" in it for it in found.remarks)
    assert "expected a list of photos" in refusal(source, listed(train_filenames=NAMES[0]))


@row("splits-both")
def _(source, tmp_path):
    found = read(source, listed(train_filenames=NAMES, val_filenames=NAMES[:1]))
    assert [one.split for one in found.cameras] == ["train"] * 4
    remark = "1 photo (images/p00.png) in both train and test lists: used for training only"
    assert any(remark in line for line in found.remarks)


@row("splits-tests-alone")
def _(source, tmp_path):
    found = read(source, listed(test_filenames=NAMES[:1]))
    assert [one.split for one in found.cameras] == ["test", "train", "train", "train"]
    assert "has no train_filenames: training on all frames except the test frames" in found.remarks[0]


@row("n-frames")
def _(source, tmp_path):
    content = listed(n_frames=2)
    content["frames"].reverse()
    found = read(source, content)
    assert [one.source for one in found.cameras] == [NAMES[1], NAMES[0]]
    assert found.skipped == ((NAMES[3], "beyond n_frames of the list"), (NAMES[2], "beyond n_frames of the list"))
    assert len(read(source, listed(n_frames=9)).cameras) == 4


# -- paths of photos ---------------------------------------------------------------------------------------------------


def with_paths(*paths: str) -> dict:
    return on_frames(listed(), *({"file_path": path} for path in paths))


@row("path-forms")
def _(source, tmp_path):
    (source / "images" / "p03.png").rename(source / "images" / "a photo.png")
    found = read(source, with_paths("./images/p00.png", "images\\p01.png", "images//p02.png", "images/a photo.png"))
    assert all(one.image for one in found.cameras)
    assert [one.name for one in found.cameras] == ["p00", "p01", "p02", "a photo"]


@row("path-suffix")
def _(source, tmp_path):
    (source / "images" / "p01.png").rename(source / "images" / "p01.PNG")
    found = read(source, with_paths("images/p00", "images/p01.png", "images/p02.PNG"))
    assert [one.image.name for one in found.cameras] == ["p00.png", "p01.PNG", "p02.png", "p03.png"]


@row("path-absolute")
def _(source, tmp_path):
    here = str(source / "images" / "p00.png")
    found = read(source, with_paths(here, "/home/me/room/images/p01.png", "C:\\room\\images\\p02.png"))
    assert [one.image and one.image.name for one in found.cameras] == ["p00.png", "p01.png", "p02.png", "p03.png"]
    assert found.remarks == ("transforms.json: looking for its photos next to it by the ends of their paths",)
    assert read(source, with_paths("elsewhere/images/p00.png")).cameras[0].image is None  # no end of a relative path


@row("path-outside")
def _(source, tmp_path):
    for name in ("p01", "p02"):
        (source / "images" / f"{name}.png").rename(tmp_path / f"{name}.png")
    found = read(source, with_paths("images/p00.png", "../p01.png", str(tmp_path / "p02.png")))
    assert all(one.image for one in found.cameras)
    assert found.remarks == tuple(
        f"transforms.json: using pictures outside its folder: {path}" for path in ("../p01.png", tmp_path / "p02.png")
    )
    scene = scene_of(imported(source, tmp_path / "work"))
    assert not any(".." in view.name or view.name.startswith("/") for view in scene.views)


@row("path-nonsense")
def _(source, tmp_path):
    for path in ("", ".", "../", "a" * 5000, "a/" * 2000, "p\ud800.png", "p\n00.png", "\0", 3, None, ["a"]):
        line = refusal(source, with_paths("images/p00.png", path))
        assert "frame 1: file_path is" in line and len(line) < 300 and line.isprintable()


@row("path-unicode")
def _(source, tmp_path):
    for form, other in (("NFC", "NFD"), ("NFD", "NFC")):
        folder = source / form / unicodedata.normalize(form, "fotografía")
        folder.mkdir(parents=True)
        (source / "images" / "p00.png").rename(folder / unicodedata.normalize(form, "ä.png"))
        path = unicodedata.normalize(other, f"{form}/fotografía/ä.png")
        found = read(source, with_paths(path) | {"train_filenames": [unicodedata.normalize(form, path)]})
        assert found.cameras[0].image and found.cameras[0].split == "train"
        capture.write_images(source)


@row("path-double")
def _(source, tmp_path):
    capture.write_transforms(source, with_paths(NAMES[0], "./images/p00.png", NAMES[2], NAMES[3]))
    scene = scene_of(imported(source, tmp_path / "work"))
    assert len(scene.views) == 3
    assert [(one.source, one.reason) for one in scene.skipped] == [("./images/p00.png", "listed twice")]


@row("path-shared")
def _(source, tmp_path):
    for place, prefix, images in (("small", "", "small"), ("", "/data/", "")):
        for number in range(2):
            write_png(source / place / f"p0{number}.png", np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
        content = with_paths(*(f"{prefix}{name}.png" for name in ("a/p00", "a/p01", "b/p00", "b/p01")))
        line = refusal(source, content, images=images)
        assert f"{prefix}a/p00 and {prefix}b/p00 would both be the photo" in line


@row("path-missing")
def _(source, tmp_path):
    (source / "images" / "p01.png").unlink()
    said = Said()
    capture.write_transforms(source, listed())
    scene = scene_of(imported(source, tmp_path / "work", said))
    assert [one.reason for one in scene.skipped] == ["no such image file"] and len(scene.views) == 3
    assert "1 of 4 listed photos have no image file: images/p01.png" in said.lines


def halved(source: Path, folder: str = "images_2", suffix: str = ".png") -> None:
    for number in range(4):
        write_png(source / folder / f"p{number:02d}{suffix}", np.full((HEIGHT // 2, WIDTH // 2, 3), 90, np.uint8))


@row("images-smaller")
def _(source, tmp_path):
    halved(source)
    found = lens(source, tmp_path / "a", listed(cx=20.0), images="images_2")
    np.testing.assert_allclose(found, [[FOCAL / 2, FOCAL / 2, 10, 9]] * 4)
    bare = listed(w=..., h=..., cx=20.0)  # their size is that of the photos that are listed
    np.testing.assert_allclose(lens(source, tmp_path / "b", bare, images="images_2"), found)
    for photo in (source / "images").iterdir():
        photo.unlink()
    assert "has no w and h: assuming that its lens is that of the photos in --images" in " ".join(
        read(source, images="images_2").remarks
    )
    assert "--images images_4: folder not found" in refusal(source, listed(), images="images_4")


# -- lenses ------------------------------------------------------------------------------------------------------------

ANGLE_X, ANGLE_Y = 2 * math.atan(WIDTH / 2 / 45), 2 * math.atan(HEIGHT / 2 / 60)
NO_LENS = dict.fromkeys(("fl_x", "fl_y", "cx", "cy"), ...)
CENTER = [WIDTH / 2, HEIGHT / 2]


@row("lens-angle")
def _(source, tmp_path):
    content = {"camera_angle_x": ANGLE_X, "frames": listed()["frames"]}
    np.testing.assert_allclose(lens(source, tmp_path / "a", content), [[45, 45, *CENTER]] * 4)
    content = listed(**NO_LENS, camera_angle_x=ANGLE_X, camera_angle_y=ANGLE_Y)
    np.testing.assert_allclose(lens(source, tmp_path / "b", content), [[45, 60, *CENTER]] * 4)


@row("lens-fov")
def _(source, tmp_path):
    content = listed(**NO_LENS, x_fov=math.degrees(ANGLE_X), y_fov=math.degrees(ANGLE_Y))
    np.testing.assert_allclose(lens(source, tmp_path / "a", content), [[45, 60, *CENTER]] * 4)


@row("lens-one-axis")
def _(source, tmp_path):
    for name, (change, focals) in enumerate(
        [({"fl_x": 50}, (50, 50)), ({"fl_y": 50}, (50, 50)), ({"camera_angle_y": ANGLE_Y}, (60, 60)),
         ({"y_fov": math.degrees(ANGLE_Y)}, (60, 60)), ({"fl_x": 50, "camera_angle_y": ANGLE_Y}, (50, 60))]
    ):  # fmt: skip
        found = lens(source, tmp_path / str(name), listed(**(NO_LENS | change)))
        np.testing.assert_allclose(found, [[*focals, *CENTER]] * 4)
    assert "has no focal length" in refusal(source, listed(**NO_LENS))


@row("lens-of-frames")
def _(source, tmp_path):
    changes = {"fl_x": 50.0, "cx": 23.0}, {}, {"camera_angle_x": ANGLE_X}, {"fl_y": 70}
    found = lens(source, tmp_path / "a", on_frames(listed(fl_x=40, fl_y=55), *changes))
    np.testing.assert_allclose(found, [[50, 50, 23, 18], [40, 55, 24, 18], [45, 45, 24, 18], [70, 70, 24, 18]])
    write_png(source / "images" / "p01.png", np.full((40, 50, 3), 90, np.uint8))
    found = lens(source, tmp_path / "b", on_frames(listed(**(NO_LENS | {"fl_x": 40})), {}, {"w": 50, "h": 40}))
    np.testing.assert_allclose(found[:2], [[40, 40, 24, 18], [40, 40, 25, 20]])


@row("lens-disagrees")
def _(source, tmp_path):
    found = read(source, listed(x_fov=90))
    assert found.cameras[0].intrinsics[0] == FOCAL
    assert "frame 0: fl_x gives 45.0 px, which is used, but x_fov gives 24.0 px" in " ".join(found.remarks)
    assert not read(source, listed(camera_angle_x=ANGLE_X, camera_angle_y=2 * math.atan(18 / 45))).remarks


@row("lens-center")
def _(source, tmp_path):
    content = listed(**NO_LENS, camera_angle_x=ANGLE_X) | {"cx": 20.5}
    np.testing.assert_allclose(lens(source, tmp_path / "a", content), [[45, 45, 20.5, HEIGHT / 2]] * 4)


@row("lens-text")
def _(source, tmp_path):
    content = listed(fl_x="45.0", fl_y="60", w="48", h="36")
    np.testing.assert_allclose(lens(source, tmp_path / "a", content), [[45, 60, *CENTER]] * 4)
    assert "fl_x is 'wide', expected a number" in refusal(source, listed(fl_x="wide"))
    assert "w is None, expected a number" in refusal(source, listed(w=None))


@row("lens-size")
def _(source, tmp_path):
    for number, change in enumerate(({"w": ...}, {"h": ...}, {"w": ..., "h": ...})):
        found = lens(source, tmp_path / str(number), listed(**change, cx=20.0))
        np.testing.assert_allclose(found, [[45, 45, 20, 18]] * 4)
    capture.write_transforms(source, listed(w=96, h=72))
    with pytest.raises(BadInput, match="the photo is 48x36, but its camera expects 96x72"):
        imported(source, tmp_path / "other")
    capture.write_transforms(source, listed(w=47, h=...))
    with pytest.raises(BadInput, match="the photo is 48x36, but its camera expects 47x36"):
        imported(source, tmp_path / "one side")


@row("lens-distortion")
def _(source, tmp_path):
    """Against the formula of OpenCV's documentation, at one point."""
    numbers = {"k1": 0.05, "k2": -0.02, "k3": 0.003, "k4": 0.001, "p1": 0.002, "p2": -0.003}
    for change in (numbers, {"distortion_params": list(numbers.values()), "k1": 9}):
        found = read(source, listed(**change)).cameras[0].distortion
        x, y = 0.3, -0.2
        r2, (k1, k2, k3, k4, p1, p2) = x * x + y * y, numbers.values()
        scale = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
        wanted = [
            x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
        np.testing.assert_allclose(found.distort(np.array([x, y])), wanted, rtol=1e-12)
    assert "distortion_params must list k1, k2" in refusal(source, listed(distortion_params=[0.1]))


@row("lens-models")
def _(source, tmp_path):
    for model in ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE"):
        found = read(source, listed(camera_model=model, k1=0.1)).cameras[0].distortion
        assert (found.kind, found.radial[0]) == ("brown", 0.1)


@row("lens-fisheye")
def _(source, tmp_path):
    """Kannala and Brandt: a ray 0.5 rad off the axis falls at theta (1 + k1 theta^2)."""
    for change in ({"camera_model": "OPENCV_FISHEYE"}, {"camera_model": "FISHEYE"}, {"is_fisheye": True}):
        found = read(source, listed(**change, k1=0.1)).cameras[0].distortion
        at = found.distort(np.array([math.tan(0.5), 0.0]))
        np.testing.assert_allclose(at, [0.5 * (1 + 0.1 * 0.25), 0], atol=1e-12)
    assert read(source, listed(is_fisheye=False, k1=0.1)).cameras[0].distortion.kind == "brown"
    assert "is_fisheye is 'false', expected true or false" in refusal(source, listed(is_fisheye="false"))


@row("lens-others")
def _(source, tmp_path):
    for model in ("EQUIRECTANGULAR", "FISHEYE624", "ORTHOPHOTO", "VR180_L", "OMNIDIRECTIONALSTEREO_R", "FULL_OPENCV"):
        assert f"camera model {model} is not supported; undistort" in refusal(source, listed(camera_model=model))
    for key in ("ftheta_p0", "latlong", "equirectangular", "orthographic"):
        assert f"camera model {key} is not supported" in refusal(source, listed(**{key: True}))
    assert "k5 is not supported" in refusal(source, listed(k5=0.1)) and read(source, listed(k5=0)).cameras


# -- poses -------------------------------------------------------------------------------------------------------------


def with_poses(change) -> dict:
    """The list with all matrices changed."""
    content = listed()
    for frame, pose in zip(content["frames"], TRUE_POSES @ GL_FROM_CV, strict=True):
        frame["transform_matrix"] = change(pose.copy()).tolist()
    return content


@row("pose")
def _(source, tmp_path):
    np.testing.assert_allclose(poses(read(source, listed())), TRUE_POSES, atol=1e-12)


@row("pose-3x4")
def _(source, tmp_path):
    np.testing.assert_allclose(poses(read(source, with_poses(lambda pose: pose[:3]))), TRUE_POSES, atol=1e-12)


@row("pose-last-row")
def _(source, tmp_path):
    assert "as its last row, expected 0 0 0 1; is it transposed?" in refusal(source, with_poses(np.transpose))


@row("pose-scaled")
def _(source, tmp_path):
    found = read(source, with_poses(lambda pose: pose * [2.5, 2.5, 2.5, 1]))
    np.testing.assert_allclose(poses(found), TRUE_POSES, atol=1e-12)
    assert "the matrices of 4 frames are scaled, by 2.5 to 2.5: only their rotations are used" in found.remarks[0]


@row("pose-no-rotation")
def _(source, tmp_path):
    for factors, words in (
        ((2, 1, 1, 1), "is not a rotation"),
        ((-1, 1, 1, 1), "mirrored"),
        ((0, 0, 0, 1), "rotation"),
    ):
        capture.write_transforms(source, with_poses(lambda pose, factors=factors: pose * factors))
        with pytest.raises(BadInput, match=words):
            imported(source, tmp_path / "work")


@row("pose-applied")
def _(source, tmp_path):
    """nerfstudio turns COLMAP's world, (x, y, z) -> (y, x, -z), and may scale it."""
    turn = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    for scale, reported in ((1.0, {}), (0.25, {"applied_scale": 0.25})):
        moved = np.array([[1, 1, 1, scale]] * 3 + [[1] * 4])
        content = with_poses(lambda pose, moved=moved: turn @ pose * moved)
        found = read(source, content | reported | {"applied_transform": turn[:3].tolist()})
        np.testing.assert_allclose(poses(found), TRUE_POSES, atol=1e-12)
        assert found.kind == "transforms.json of nerfstudio" and not found.remarks
    assert "applied_transform is not a rotation" in refusal(source, listed(applied_transform=(3 * turn).tolist()[:3]))
    assert "applied_scale is 0" in refusal(source, listed(applied_scale=0))


@row("pose-mitsuba")
def _(source, tmp_path):
    """Mitsuba's cameras look along +z with x to the left: half a turn about the y axis of Blender's."""
    content = with_poses(lambda pose: pose @ np.diag([-1.0, 1, -1, 1]))
    np.testing.assert_allclose(poses(read(source, content | {"from_mitsuba": True})), TRUE_POSES, atol=1e-12)
    np.testing.assert_allclose(poses(read(source, content | {"normal_mts_args": []})), TRUE_POSES, atol=1e-12)


@row("pose-moving")
def _(source, tmp_path):
    content = listed()
    for frame in content["frames"]:
        frame["transform_matrix_start"] = frame.pop("transform_matrix")
    assert "frame 0 has a rolling-shutter pose" in refusal(source, content)


@row("pose-one-point")
def _(source, tmp_path):
    rounding = np.random.default_rng(0).uniform(-1, 1, (4, 3)) * 6e-8
    for center in (np.zeros(3), np.array([0.1, 0.2, 0.3]), np.array([5e5, 4e6, 100])):
        content, noise = listed(), iter(rounding * np.abs(center).max())
        for frame in content["frames"]:
            for axis, value in enumerate(center + next(noise)):
                frame["transform_matrix"][axis][3] = float(value)
        capture.write_transforms(source, content)
        with pytest.raises(BadInput, match="all cameras are at one point"):
            imported(source, tmp_path / "work")
    moved = listed()
    for frame in moved["frames"]:  # meters of a map, far from its origin
        for axis, value in enumerate((5e5, 4e6, 100)):
            frame["transform_matrix"][axis][3] += value
    capture.write_transforms(source, moved)
    scene_of(imported(source, tmp_path / "map"))


# -- masks and transparency --------------------------------------------------------------------------------------------

LEFT = np.where(np.arange(WIDTH) < WIDTH // 2, np.full((HEIGHT, WIDTH), 255), 0).astype(np.uint8)


def alphas(scene) -> list[np.ndarray | None]:
    """Of each view of an imported scene, None where it is opaque."""
    data = load_scene(scene)
    return [
        to_uint8(data.images(index))[..., 3] if data.channels(index) == 4 else None for index in range(len(data.views))
    ]


@row("mask-path")
def _(source, tmp_path):
    write_png(source / "mask.png", LEFT)
    capture.write_transforms(source, on_frames(listed(), {"mask_path": "mask.png"}))
    for alpha in alphas(imported(source, tmp_path / "all")):
        np.testing.assert_array_equal(alpha, LEFT)
    capture.write_transforms(source, on_frames(listed(), {}, {"mask_path": ".\\mask.PNG"}))
    assert [alpha is not None for alpha in alphas(imported(source, tmp_path / "one"))] == [False, True, False, False]
    assert "its mask " in refusal(source, on_frames(listed(), {"mask_path": "gone.png"}))
    assert "mask_path is 7, expected" in refusal(source, on_frames(listed(), {"mask_path": 7}))


@row("mask-path-smaller")
def _(source, tmp_path):
    """masks_2 beside images_2, else the mask of the full size: the two differ, so that the choice is seen."""
    halved(source)
    write_png(source / "masks" / "m.png", 255 - LEFT)
    content = on_frames(listed(), {"mask_path": "masks/m.png"})
    capture.write_transforms(source, content)
    for alpha in alphas(imported(source, tmp_path / "shrunk", images="images_2")):
        np.testing.assert_array_equal(alpha, 255 - LEFT[::2, ::2])
    write_png(source / "masks_2" / "m.png", LEFT[::2, ::2])
    for alpha in alphas(imported(source, tmp_path / "own", images="images_2")):
        np.testing.assert_array_equal(alpha, LEFT[::2, ::2])


@row("mask-size")
def _(source, tmp_path):
    write_png(source / "masks" / "p00.png", LEFT[:, :40])
    capture.write_transforms(source, listed())
    with pytest.raises(BadInput, match=r"p00\.png is 40x36, but its photo is 48x36; make them the same size"):
        imported(source, tmp_path / "work")


@row("mask-dynamic")
def _(source, tmp_path):
    """Hides what is not black, however dark; together with a mask that keeps what is white."""
    write_png(source / "images" / "dynamic_mask_p01.png", LEFT // 255)
    write_png(source / "images" / "dynamic_mask_p02.png", LEFT)
    top = np.where(np.arange(HEIGHT)[:, None] < 10, np.full((HEIGHT, WIDTH), 255), 0).astype(np.uint8)
    write_png(source / "masks" / "p02.png", top)
    capture.write_transforms(source, listed())
    found = alphas(imported(source, tmp_path / "work"))
    assert found[0] is None and found[3] is None
    np.testing.assert_array_equal(found[1], 255 - LEFT)
    np.testing.assert_array_equal(found[2], np.minimum(255 - LEFT, top))


@row("mask-names")
def _(source, tmp_path):
    for name in ("p00.png", "p01.png.png", "p02_mask.png", "../images/p03_mask.png"):
        write_png(source / "masks" / name, LEFT)
    capture.write_transforms(source, listed())
    said = Said()
    assert all(alpha is not None for alpha in alphas(imported(source, tmp_path / "work", said)))
    assert not any("masks not used" in line for line in said.lines)


@row("mask-unused")
def _(source, tmp_path):
    for name in ("p00.png", "mask.png", "deep/p01_seg.png"):
        write_png(source / "masks" / name, LEFT)
    halved(source, "masks_2")  # smaller copies of those for photos of images_2, which are not asked for
    capture.write_transforms(source, listed())
    said = Said()
    imported(source, tmp_path / "work", said)
    assert [line for line in said.lines if "masks not used" in line] == [
        "masks not used: 2 (1 of 4 photos have one): masks/deep/p01_seg.png, masks/mask.png; name a mask after its "
        "photo, 001.png for 001.jpg, or give its mask_path"
    ]


def disc(row: float, column: float, radius: float) -> np.ndarray:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    return np.where((rows - row) ** 2 + (columns - column) ** 2 < radius**2, 255, 0).astype(np.uint8)


def layout_with(source: Path, work: Path, *masks: np.ndarray) -> tuple[str, list[str]]:
    """The layout of the four photos with these masks (None: none), and what was said."""
    for index, mask in enumerate(masks):
        (source / "masks" / f"p{index:02d}.png").unlink(missing_ok=True)
        if mask is not None:
            write_png(source / "masks" / f"p{index:02d}.png", mask)
    capture.write_transforms(source, listed())
    said = Said()
    return scene_of(imported(source, work, said)).layout, said.lines


@row("mask-of-a-room")
def _(source, tmp_path):
    """A tripod, corners, a blank rim, the sky, passers-by in every photo, a lens hood: no objects."""
    whole = np.full((HEIGHT, WIDTH), 255, np.uint8)
    tripod, corner, rim, sky = whole.copy(), whole.copy(), np.zeros_like(whole), whole.copy()
    tripod[-5:, 18:30], corner[:3, :3], rim[1:-1, 1:-1], sky[:20] = 0, 0, 255, 0
    passers = [whole - disc(18, column, 9) for column in (8, 18, 28, 38)]
    hood = disc(HEIGHT / 2, WIDTH / 2, 20)
    cases = [[tripod] * 4, [corner] * 4, [rim] * 4, [sky, sky, whole, sky], passers, [hood] * 4]
    for number, masks in enumerate(cases):
        layout, said = layout_with(source, tmp_path / str(number), *masks)
        assert layout != "object" and any("not to cut out an object" in line for line in said), number


@row("mask-of-an-object")
def _(source, tmp_path):
    """Clear of the border, or cut by one side of it; in most photos."""
    moving = [disc(18, column, 9) for column in (20, 22, 24, 26)]
    bust = [disc(HEIGHT, column, 14) for column in (20, 22, 24, 26)]
    still = [disc(18, 24, 9)] * 4  # a ball looks the same from everywhere
    whole = np.full((HEIGHT, WIDTH), 255, np.uint8)
    for masks, cut in ((moving, True), (bust, True), (still, True), ([*moving[:3], whole], True),
                       ([*moving[:2], whole, whole], False)):  # fmt: skip
        background = Background("auto")
        for mask in masks:
            colors = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
            background.seen(evidence_of(np.dstack([colors, mask / 255]) if mask.min() < 255 else colors))
        background.decide()
        assert (background.kind, background.cuts_out) == ("alpha", "transparency" if cut else "")
        assert bool(background.remark) != cut
    assert layout_with(source, tmp_path / "two", *moving[:2], None, None)[0] != "object"


@row("alpha-file")
def _(source, tmp_path):
    write_png(source / "images" / "p01.alpha.png", LEFT)
    assert "not used: separate alpha files next to photos, such as p01.alpha.png" in " ".join(
        read(source, listed()).remarks
    )


# -- what is not used --------------------------------------------------------------------------------------------------


@row("unused-keys")
def _(source, tmp_path):
    keys = ("ply_file_path", "rolling_shutter", "white_transparent", "envmap", "camera_angel_x", "fisheye_crop_radius")
    content = on_frames(listed(**dict.fromkeys(keys, 1)), {"depth_file_path": "depth/0.png", "time": 0.5})
    assert read(source, content).remarks == (
        "transforms.json: not used: camera_angel_x, depth_file_path, envmap, fisheye_crop_radius, ply_file_path, "
        "rolling_shutter, time, white_transparent",
    )
    assert r"not used: a\x1b[2J" in read(source, listed(**{"a\x1b[2J": 1})).remarks[0]


@row("placing-keys")
def _(source, tmp_path):
    keys = {"aabb_scale": 16, "scale": 0.5, "offset": [1, 2, 3], "up": [0, 0, 1], "orientation_override": "none"}
    found = read(source, on_frames(listed(**keys), {"sharpness": 30.5, "colmap_im_id": 3}))
    assert not found.remarks
    np.testing.assert_allclose(poses(found), TRUE_POSES, atol=1e-12)
