"""EXR views, read back by OpenImageIO: names, types, values, and a camera whose depth lands on known geometry."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from schemas.errors import BadInput, OutOfResources
from schemas.exr import FAR_Z, ExrView, read_depth, read_exr, world_to_camera, world_to_ndc, write_exr
from schemas.safe_reading import set_allowance
from tests.conftest import REPOSITORY
from tests.schemas import unusual_exr

WIDTH, HEIGHT = 40, 30
INTRINSICS = (55.0, 60.0, 18.5, 16.25)


def looking_from(center, towards) -> np.ndarray:
    """Pose with OpenCV axes of a camera at `center` that looks at `towards`, world up +z."""
    forward = np.subtract(towards, center) / np.linalg.norm(np.subtract(towards, center))
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = center
    return pose


POSE = looking_from([2.0, -3.0, 1.5], [0.2, 0.1, 0.0])


def sphere_view(radius=0.8) -> ExrView:
    """A sphere of that radius about the origin, hit analytically; x + y + z is its color."""
    fx, fy, cx, cy = INTRINSICS
    alpha, z, distance = np.zeros((3, HEIGHT, WIDTH))
    rgb = np.zeros((HEIGHT, WIDTH, 3))
    for row in range(HEIGHT):
        for column in range(WIDTH):
            local = np.array([(column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy, 1.0])
            direction = POSE[:3, :3] @ local / np.linalg.norm(local)
            half_b = direction @ POSE[:3, 3]
            root = half_b**2 - POSE[:3, 3] @ POSE[:3, 3] + radius**2
            if root > 0:
                t = -half_b - np.sqrt(root)
                alpha[row, column], distance[row, column] = 1, t
                z[row, column] = t / np.linalg.norm(local)
                rgb[row, column] = 0.5 + 0.5 * (POSE[:3, 3] + t * direction)
    return ExrView(
        rgb, alpha, z, distance, POSE, INTRINSICS, 0.5, 20.0, {"head": alpha * 0.25}, {"field": "fox", "digest": "ab12"}
    )


@pytest.fixture(scope="module")
def view() -> ExrView:
    return sphere_view()


@pytest.fixture
def stored(tmp_path, view):
    write_exr(tmp_path / "v.exr", view)
    source = oiio.ImageInput.open(str(tmp_path / "v.exr"))
    spec = source.spec()
    planes = source.read_image(oiio.FLOAT)
    assert planes is not None and not source.geterror()
    return spec, {name: planes[..., index] for index, name in enumerate(spec.channelnames)}


def test_channels_and_types_as_compositors_expect(stored):
    spec, _ = stored
    types = dict(zip(spec.channelnames, (str(kind) for kind in spec.channelformats)))
    half = dict.fromkeys(["R", "G", "B", "A", "mask.head"], "half")
    assert types == half | {"Z": "float", "rayDistance.Z": "float"}
    assert spec.getattribute("compression") == "zip"
    assert spec.getattribute("oiio:subimages") == 1
    assert spec.getattribute("PixelAspectRatio") == pytest.approx(60 / 55)
    np.testing.assert_allclose(spec.getattribute("chromaticities")[:2], [0.64, 0.33], atol=1e-6)
    assert spec.getattribute("stylerf:field") == "fox" and spec.getattribute("stylerf:digest") == "ab12"
    assert (spec.getattribute("stylerf:near"), spec.getattribute("stylerf:far")) == ("0.5", "20.0")


def test_values(stored, view):
    _, planes = stored
    hit = view.alpha > 0
    assert 200 < hit.sum() < hit.size - 200
    for index, name in enumerate("RGB"):
        np.testing.assert_array_equal(planes[name], view.rgb[..., index].astype(np.float16))
    np.testing.assert_array_equal(planes["A"], view.alpha)
    np.testing.assert_array_equal(planes["mask.head"], 0.25 * view.alpha)
    np.testing.assert_array_equal(planes["Z"][hit], view.z[hit].astype(np.float32))
    np.testing.assert_array_equal(planes["rayDistance.Z"][hit], view.ray_distance[hit].astype(np.float32))
    assert (planes["Z"][~hit] == np.float32(FAR_Z)).all() and (planes["rayDistance.Z"][~hit] == np.float32(FAR_Z)).all()


def test_depth_unprojected_with_the_written_matrices_lies_on_the_sphere(stored, view):
    spec, planes = stored
    # Imath's row vectors: p_ndc = p_world * worldToNDC, p_camera = p_world * worldToCamera.
    to_camera = np.array(spec.getattribute("worldToCamera")).reshape(4, 4)
    to_ndc = np.array(spec.getattribute("worldToNDC")).reshape(4, 4)
    rows, columns = np.nonzero(view.alpha > 0)
    depth = planes["Z"][rows, columns].astype(np.float64)
    width, height = spec.width, spec.height
    # Camera-space x and y from (u, v) and Z alone, through the camera-from-NDC part of the two matrices.
    camera_to_ndc = np.linalg.inv(to_camera) @ to_ndc
    u, v = (columns + 0.5) / width, (rows + 0.5) / height
    x = (u * depth - depth * camera_to_ndc[2, 0]) / camera_to_ndc[0, 0]
    y = (v * depth - depth * camera_to_ndc[2, 1]) / camera_to_ndc[1, 1]
    world = np.stack([x, y, depth, np.ones_like(x)], axis=-1) @ np.linalg.inv(to_camera)
    np.testing.assert_allclose(np.linalg.norm(world[:, :3], axis=1), 0.8, atol=3e-6)
    # And the color that each point was painted by its position.
    painted = np.stack([planes[name][rows, columns] for name in "RGB"], axis=-1)
    np.testing.assert_allclose(painted, 0.5 + 0.5 * world[:, :3], atol=1e-3)
    # rayDistance is the distance from the camera, whose center maps to the origin.
    np.testing.assert_allclose(
        planes["rayDistance.Z"][rows, columns], np.linalg.norm(np.stack([x, y, depth], -1), axis=1), rtol=1e-5
    )


def test_matrices_follow_the_standard_s_axes():
    center, right, down, forward = POSE[:3, 3], POSE[:3, 0], POSE[:3, 1], POSE[:3, 2]
    to_camera = world_to_camera(POSE)

    def camera(point):
        return (np.append(point, 1.0) @ to_camera)[:3]

    np.testing.assert_allclose(camera(center), 0, atol=1e-12)
    np.testing.assert_allclose(camera(center + 2 * forward), [0, 0, 2], atol=1e-12)  # ahead is positive z
    np.testing.assert_allclose(camera(center + right), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(camera(center - down), [0, 1, 0], atol=1e-12)  # up is positive y
    assert np.linalg.det(to_camera) == pytest.approx(-1)  # left-handed

    fx, fy, cx, cy = INTRINSICS
    to_ndc = world_to_ndc(POSE, INTRINSICS, (WIDTH, HEIGHT), 0.5, 20.0)
    for (column, row), ndc in {(0, 0): (0, 0), (WIDTH, HEIGHT): (1, 1), (WIDTH, 0): (1, 0)}.items():
        for depth, stored_depth in ((0.5, 0), (20, 1)):
            local = np.array([(column - cx) / fx, (row - cy) / fy, 1]) * depth
            result = np.append(POSE[:3, :3] @ local + center, 1) @ to_ndc
            np.testing.assert_allclose(result[:3] / result[3], [*ndc, stored_depth], atol=1e-12)


def test_screen_window_is_the_plane_at_distance_one(stored):
    spec, _ = stored
    fx, fy, cx, cy = INTRINSICS
    center, width = spec.getattribute("screenWindowCenter"), spec.getattribute("screenWindowWidth")
    assert (-cx / fx, (WIDTH - cx) / fx) == pytest.approx((center[0] - width / 2, center[0] + width / 2))
    height = width * HEIGHT / WIDTH / spec.getattribute("PixelAspectRatio")
    assert (cy / fy, (cy - HEIGHT) / fy) == pytest.approx((center[1] + height / 2, center[1] - height / 2))


def test_reading_back_is_exact(tmp_path, view):
    write_exr(tmp_path / "v.exr", view)
    again = read_exr(tmp_path / "v.exr")
    np.testing.assert_array_equal(again.world_from_camera, view.world_from_camera)
    assert (again.intrinsics, again.near, again.far) == (view.intrinsics, 0.5, 20.0)
    assert again.attributes == view.attributes
    np.testing.assert_array_equal(again.masks["head"], 0.25 * view.alpha)
    np.testing.assert_array_equal(again.z, np.where(view.alpha > 0, view.z, FAR_Z).astype(np.float32))
    np.testing.assert_array_equal(read_depth(tmp_path / "v.exr"), again.z)
    write_exr(tmp_path / "w.exr", again)
    assert (tmp_path / "w.exr").read_bytes() == (tmp_path / "v.exr").read_bytes()


def test_strided_arrays_are_written_right(tmp_path, view):
    strided = dataclasses.replace(
        view,
        alpha=np.asfortranarray(view.alpha),
        z=np.repeat(view.z, 2, axis=1)[:, ::2],
        rgb=np.moveaxis(np.ascontiguousarray(np.moveaxis(view.rgb, 2, 0)), 0, 2),
    )
    write_exr(tmp_path / "a.exr", view)
    write_exr(tmp_path / "b.exr", strided)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_alpha_that_half_rounds_to_nothing_is_far(tmp_path, view):
    faint = np.full_like(view.alpha, 1e-9)
    write_exr(tmp_path / "v.exr", dataclasses.replace(view, alpha=faint, z=np.ones_like(faint)))
    again = read_exr(tmp_path / "v.exr")
    assert (again.alpha == 0).all() and (again.z == np.float32(FAR_Z)).all()


def test_nan_other_sizes_and_bad_planes_are_refused(tmp_path, view):
    bad = [{"z": np.full_like(view.z, np.nan)}, {"alpha": view.alpha[1:]}, {"near": 0.0}, {"far": np.inf}]
    bad += [{"world_from_camera": POSE[:3]}, {"masks": {"a": view.alpha[:, 1:]}}]
    for change in bad:
        with pytest.raises(ValueError):
            write_exr(tmp_path / "v.exr", dataclasses.replace(view, **change))
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("keep", [0.0, 0.05, 0.3, 0.6, 0.95])
def test_truncated_files_are_refused(tmp_path, view, keep):
    path = tmp_path / "v.exr"
    write_exr(path, view)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(BadInput, match=r"v\.exr") as caught:
        read_exr(path)
    assert "\n" not in str(caught.value)


def test_a_channel_whose_name_is_no_text_is_refused(tmp_path, view):
    path = tmp_path / "v.exr"
    write_exr(path, view)
    path.write_bytes(path.read_bytes().replace(b"Z\0", b"\xff\0", 1))
    with pytest.raises(BadInput, match=r"v\.exr"):
        read_exr(path)


def test_flipped_bytes_are_refused_or_harmless(tmp_path, view):
    path = tmp_path / "v.exr"
    noisy = np.random.default_rng(0).random(view.rgb.shape)
    write_exr(path, dataclasses.replace(view, rgb=noisy, alpha=np.ones_like(view.alpha)))
    data, rng, silent = path.read_bytes(), np.random.default_rng(1), 0
    start = len(data) // 3  # behind the header
    for _ in range(60):
        damaged = bytearray(data)
        damaged[rng.integers(start, len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            again = read_exr(path)
        except BadInput:
            continue
        silent += not np.array_equal(again.rgb, noisy.astype(np.float16).astype(np.float32))
    assert silent == 0


def test_another_program_s_exr_is_refused_in_words(tmp_path):
    spec = oiio.ImageSpec(4, 3, 3, oiio.HALF)
    target = oiio.ImageOutput.create(str(tmp_path / "x.exr"))
    target.open(str(tmp_path / "x.exr"), spec)
    target.write_image(np.zeros((3, 4, 3), np.float16))
    target.close()
    with pytest.raises(BadInput, match="lacks channels A, Z"):
        read_exr(tmp_path / "x.exr")
    with pytest.raises(BadInput, match="lacks channels Z"):
        read_depth(tmp_path / "x.exr")
    with pytest.raises(BadInput, match="no such"):
        read_exr(tmp_path / "absent.exr")


def test_a_file_of_several_parts_is_refused(tmp_path, view):
    planes = {name: np.ones((3, 4), np.float32) for name in ("R", "G", "B", "A", "Z", "rayDistance.Z")}
    parts = [OpenEXR.Part({"name": name}, dict(planes)) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(tmp_path / "v.exr"))
    for read in (read_exr, read_depth):
        with pytest.raises(BadInput, match="2 readable parts, expected 1"):
            read(tmp_path / "v.exr")


def test_the_library_s_warnings_do_not_reach_the_terminal(tmp_path, view):
    write_exr(tmp_path / "v.exr", view)
    (tmp_path / "v.exr").write_bytes((tmp_path / "v.exr").read_bytes()[:-500])
    code = (
        "import sys\nfrom schemas.errors import BadInput\nfrom schemas.exr import read_exr\n"
        "try: read_exr(sys.argv[1])\nexcept BadInput: print('refused')"
    )
    command = [sys.executable, "-c", code, tmp_path / "v.exr"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert (done.stdout, done.stderr) == ("refused\n", "")


def test_a_full_disk_is_reported(tmp_path, view, monkeypatch):
    def fail(*_):
        raise RuntimeError("Failed to write pixel data")

    monkeypatch.setattr("OpenEXR.File.write", fail)
    refused = "schemas.exr.refusal_of_disk"
    monkeypatch.setattr(refused, lambda path, size: OutOfResources(f"no space for {size}"))
    with pytest.raises(OutOfResources, match="no space for"):
        write_exr(tmp_path / "v.exr", view)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (unusual_exr.deep, "deep"),
        (unusual_exr.parts, "part"),
        (unusual_exr.mip_levels, "mip levels"),
        (unusual_exr.cropped, "display window"),
        (unusual_exr.halved_color, "subsampled"),
        (unusual_exr.huge_windows, "30000x30000"),
    ],
)
def test_what_is_no_flat_picture_is_refused_by_its_header(tmp_path, make, word):
    set_allowance(None)
    make(tmp_path / "a.exr")
    with pytest.raises((BadInput, OutOfResources), match=word):
        read_depth(tmp_path / "a.exr")
    with pytest.raises((BadInput, OutOfResources), match=r"a\.exr"):
        read_exr(tmp_path / "a.exr")


def test_a_camera_that_is_no_text_is_refused(tmp_path, view):
    write_exr(tmp_path / "a.exr", view)
    source = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    channels = {name: np.ascontiguousarray(channel.pixels) for name, channel in source.channels().items()}
    header = {**source.header(), "stylerf:intrinsics": 3.0}
    for key in ("channels", "dataWindow", "displayWindow"):
        header.pop(key, None)
    OpenEXR.File(header, channels).write(str(tmp_path / "b.exr"))
    with pytest.raises(BadInput, match="camera attributes"):
        read_exr(tmp_path / "b.exr")
