"""Images are read whole, upright and unconverted, or refused with the file and a reason."""

import os
import subprocess
import sys

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas import images, safe_reading
from schemas.color_spaces import COLOR_SPACES, REC709, matrix_between
from schemas.errors import BadInput, OutOfResources
from schemas.images import (
    image_channels,
    image_size,
    linear_from_srgb,
    read_image,
    read_srgb,
    srgb_from_linear,
    to_uint8,
    write_png,
)
from tests.conftest import REPOSITORY
from tests.schemas import unusual_exr


def store(path, array, **attributes):
    types = {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float16": oiio.HALF, "float32": oiio.FLOAT}
    spec = oiio.ImageSpec(array.shape[1], array.shape[0], array.shape[2], types[str(array.dtype)])
    for name, value in attributes.items():
        spec.attribute(name, value)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(array) and target.close()
    return path


def noise(*shape, dtype=np.uint8):
    return np.random.default_rng(3).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_png_round_trip_is_exact(tmp_path, dtype, channels):
    array = noise(5, 7, channels, dtype=dtype)
    write_png(tmp_path / "a.png", array)
    image = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(image.pixels, array.astype(np.float32) / np.float32(np.iinfo(dtype).max))
    assert (image.bits, image.channels, image.size) == (8 * array.itemsize, channels, (7, 5))
    assert image_size(tmp_path / "a.png") == (7, 5)


def test_equal_pixels_give_equal_bytes_and_replace_as_one_step(tmp_path):
    write_png(tmp_path / "a.png", noise(9, 9, 3))
    write_png(tmp_path / "b.png", noise(9, 9))
    write_png(tmp_path / "b.png", noise(9, 9, 3))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["a.png", "b.png"]


def test_transparent_colors_survive(tmp_path):
    array = np.zeros((2, 2, 4), np.uint8)
    array[..., 0] = 201  # color under alpha 0 is lost by readers that premultiply
    write_png(tmp_path / "a.png", array)
    np.testing.assert_array_equal(to_uint8(read_image(tmp_path / "a.png").pixels), array)


# How a stored image must be turned for viewing, from the EXIF standard's table (row 0 is at, column 0 is at).
UPRIGHT = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.transpose(1, 0, 2),
    6: lambda a: a.transpose(1, 0, 2)[:, ::-1],
    7: lambda a: a.transpose(1, 0, 2)[::-1, ::-1],
    8: lambda a: a.transpose(1, 0, 2)[::-1],
}


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_exif_orientation_is_applied(tmp_path, orientation):
    array = noise(4, 6, 3)
    path = store(tmp_path / "a.tif", array, Orientation=orientation)
    expected = UPRIGHT[orientation](array)
    np.testing.assert_array_equal(to_uint8(read_image(path).pixels), expected)
    assert image_size(path) == (expected.shape[1], expected.shape[0])
    np.testing.assert_array_equal(to_uint8(read_image(path, upright=False).pixels), array)
    assert image_size(path, upright=False) == (6, 4)


def test_exif_orientation_of_a_jpeg(tmp_path):
    array = np.zeros((32, 64, 3), np.uint8)
    array[:16, :32] = 255  # upper left; orientation 6 brings it to the upper right
    image = read_image(store(tmp_path / "a.jpg", array, Orientation=6))
    assert image.size == (32, 64)
    assert image.pixels[8, 24].min() > 0.9 and image.pixels[8, 8].max() < 0.1


def test_gray_with_alpha_and_named_channels(tmp_path):
    array = noise(3, 4, 2)
    image = read_image(store(tmp_path / "a.tif", array))
    np.testing.assert_array_equal(to_uint8(image.pixels), array[..., [0, 0, 0, 1]])
    five = noise(3, 4, 5).astype(np.float32)
    named = store_named(tmp_path / "a.exr", five, ("Z", "B", "G", "R", "A"))
    np.testing.assert_array_equal(read_image(named).pixels, five[..., [3, 2, 1, 4]])
    with pytest.raises(BadInput, match="channels"):
        read_image(store_named(tmp_path / "a.exr", five, ("a", "b", "c", "d", "e")))


def test_a_tiff_of_premultiplied_colors_reads_like_one_of_straight_colors(tmp_path):
    straight = np.float32([[[0.8, 0.6, 0.1, alpha] for alpha in (0.5, 0.25, 1, 0)]])
    stored = straight * np.concatenate([straight[..., [3, 3, 3]], np.ones((1, 4, 1), np.float32)], axis=2)
    read = read_image(store(tmp_path / "a.tif", np.round(65535 * stored).astype(np.uint16))).pixels
    np.testing.assert_allclose(read[0, :3], straight[0, :3], atol=4 / 65535)  # rounded before the division
    np.testing.assert_array_equal(read[0, 3], 0)
    unassociated = store(tmp_path / "b.tif", straight, **{"oiio:UnassociatedAlpha": 1})
    np.testing.assert_array_equal(read_image(unassociated).pixels, straight)


def test_colors_of_formats_without_premultiplied_alpha_stay(tmp_path):
    array = noise(64, 64, 4)
    for suffix in ("png", "tga", "bmp", "jp2"):
        path = store(tmp_path / f"a.{suffix}", array, **{"oiio:UnassociatedAlpha": 1})
        np.testing.assert_allclose(to_uint8(read_image(path).pixels), array, atol=1 if suffix == "jp2" else 0)


def test_light_becomes_code_values_without_alpha_in_them(tmp_path):
    # IEC 61966-2-1: code 0.5 is 0.2140 light. Half of it covers the second pixel, nothing the third.
    light = np.float32([[[0.21404114] * 3 + [1], [0.10702057] * 3 + [0.5], [0, 0, 0, 0], [9, 9, 9, 1]]])
    path = store(tmp_path / "a.exr", light)
    expected = np.float32([[[0.5] * 3 + [1], [0.5] * 3 + [0.5], [0, 0, 0, 0], [1, 1, 1, 1]]])
    np.testing.assert_allclose(read_srgb(path).pixels, expected, atol=1e-6)
    np.testing.assert_array_equal(read_image(path).pixels, light)
    np.testing.assert_allclose(read_srgb(store(tmp_path / "gray.exr", light[..., :1])).pixels[0, 0], 0.5, atol=1e-6)
    colored = store(tmp_path / "a.hdr", np.full((4, 9, 3), 0.21404114, np.float32))
    np.testing.assert_allclose(read_srgb(colored).pixels, 0.5, atol=4e-3)  # eight bits a channel
    write_png(tmp_path / "a.png", noise(3, 4, 4))
    np.testing.assert_array_equal(read_srgb(tmp_path / "a.png").pixels, read_image(tmp_path / "a.png").pixels)


def test_light_of_other_primaries_becomes_the_same_colors(tmp_path):
    light = np.float32([[[0.5, 0.25, 0.1], [0.2, 0.2, 0.2]]])
    plain = read_srgb(store(tmp_path / "plain.exr", light)).pixels
    for space in COLOR_SPACES.values():
        there = (light @ matrix_between(REC709, space).T).astype(np.float32)
        path = tmp_path / f"{space.interop_id}.exr"
        spec = oiio.ImageSpec(2, 1, 3, oiio.FLOAT)
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), space.chromaticities)
        target = oiio.ImageOutput.create(str(path))
        assert target.open(str(path), spec) and target.write_image(there) and target.close()
        np.testing.assert_allclose(read_srgb(path).pixels, plain, atol=1e-5)


@pytest.mark.parametrize(
    "chromaticities", [(0.3, 0.3) * 4, (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3, 0.0), (np.nan,) * 8]
)
def test_chromaticities_that_are_no_colors_are_refused(tmp_path, chromaticities):
    spec = oiio.ImageSpec(2, 1, 3, oiio.FLOAT)
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), chromaticities)
    target = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert target.open(str(tmp_path / "a.exr"), spec)
    assert target.write_image(np.ones((1, 2, 3), np.float32)) and target.close()
    with pytest.raises(BadInput, match="invalid chromaticities"):
        read_srgb(tmp_path / "a.exr")


@pytest.mark.parametrize(("left", "top"), [(2, 1), (-1, -2), (5, 3), (-9, 0)])
def test_an_exr_is_what_its_display_window_shows(tmp_path, left, top):
    data = noise(4, 6, 4).astype(np.float32)
    path = store_named(tmp_path / "a.exr", data, ("R", "G", "B", "A"), at=(left, top), display=(8, 5))
    expected = np.zeros((30, 40, 4), np.float32)
    expected[10 + top : 14 + top, 10 + left : 16 + left] = data
    np.testing.assert_array_equal(read_image(path).pixels, expected[10:15, 10:18])
    assert image_size(path) == (8, 5)


def test_a_display_window_beyond_the_limit_is_refused(tmp_path):
    data = np.ones((2, 2, 3), np.float32)
    path = store_named(tmp_path / "a.exr", data, ("R", "G", "B"), display=(100_000, 100_000))
    with pytest.raises(BadInput, match="display window of 100000x100000"):
        read_image(path)


def store_named(path, array, names, at=(0, 0), display=None):
    spec = oiio.ImageSpec(array.shape[1], array.shape[0], array.shape[2], oiio.FLOAT)
    spec.channelnames = names
    spec.x, spec.y = at
    spec.full_width, spec.full_height = display or (spec.width, spec.height)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(array) and target.close()
    return path


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp", "exr"])
@pytest.mark.parametrize("keep", [0.02, 0.3, 0.9])
def test_truncated_files_are_refused(tmp_path, suffix, keep):
    array = noise(64, 64, 3)
    path = store(tmp_path / f"a.{suffix}", array.astype(np.float16) if suffix == "exr" else array)
    read_image(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * keep)])
    with pytest.raises(BadInput, match=rf"a\.{suffix}") as caught:
        read_image(path)
    assert "\n" not in str(caught.value)


def test_flipped_bits_of_a_png_are_refused(tmp_path):
    path = tmp_path / "a.png"
    write_png(path, noise(32, 32, 3))
    data, rng = path.read_bytes(), np.random.default_rng(1)
    start = data.index(b"IDAT") + 4
    for _ in range(60):
        damaged = bytearray(data)
        damaged[rng.integers(start, len(data) - 16)] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        with pytest.raises(BadInput):
            read_image(path)


def test_what_is_no_image_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("not a picture")
    (tmp_path / "empty.jpg").write_bytes(b"")
    for name in ("text.png", "empty.jpg", "absent.png", "."):
        for read in (read_image, image_size):
            with pytest.raises(BadInput):
                read(tmp_path / name)


def test_nan_pixels_are_refused(tmp_path):
    array = np.ones((4, 4, 3), np.float32)
    array[2, 1, 0] = np.nan
    with pytest.raises(BadInput, match="NaN"):
        read_image(store(tmp_path / "a.tif", array))


def test_claimed_sizes_beyond_the_limit_are_refused(tmp_path, monkeypatch):
    path = store(tmp_path / "a.png", np.zeros((800, 800, 3), np.uint8))
    monkeypatch.setattr(images, "LARGEST_IMAGE_MB", 1)
    with pytest.raises(BadInput, match="limit"):
        read_image(path)
    monkeypatch.undo()
    read_image(path)


@pytest.mark.parametrize(
    "make", [unusual_exr.deep, unusual_exr.parts, unusual_exr.mip_levels, unusual_exr.halved_color]
)
def test_an_exr_that_is_no_flat_picture_is_refused(tmp_path, make):
    make(tmp_path / "a.exr")
    for read in (read_image, image_size, image_channels):
        with pytest.raises(BadInput, match=r"a\.exr"):
            read(tmp_path / "a.exr")


@pytest.mark.parametrize("names", [("X", "Y", "Z"), ("Y", "RY", "BY"), ("Z",), ("layer.R", "layer.G", "layer.B")])
def test_channels_of_an_exr_that_are_no_colors_are_refused(tmp_path, names):
    path = store_named(tmp_path / "a.exr", np.ones((4, 4, len(names)), np.float32), names)
    with pytest.raises(BadInput, match="channels"):
        read_image(path)


def test_numbers_of_other_kinds_are_refused(tmp_path):
    spec = oiio.ImageSpec(4, 4, 3, oiio.UINT)
    target = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    assert target.open(str(tmp_path / "a.tif"), spec) and target.write_image(np.ones((4, 4, 3), np.uint32))
    target.close()
    with pytest.raises(BadInput, match="uint"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("layout", ["rows", "strips", "tiles", "planes"])
def test_bands_join_without_a_seam(tmp_path, monkeypatch, layout):
    array = noise(150, 70, 3)
    spec = oiio.ImageSpec(70, 150, 3, oiio.UINT8)
    if layout == "tiles":
        spec.tile_width, spec.tile_height = 32, 16
    spec.attribute("tiff:RowsPerStrip", 7 if layout == "strips" else 64)
    spec.attribute("planarconfig", "separate" if layout == "planes" else "contig")
    path = tmp_path / ("a.png" if layout == "rows" else "a.tif")
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(array) and target.close()
    monkeypatch.setattr(images, "BAND_BYTES", 5000)
    np.testing.assert_array_equal(to_uint8(read_image(path).pixels), array)


def test_an_image_over_the_memory_limit_is_refused_before_decoding(tmp_path, monkeypatch):
    paths = [store(tmp_path / f"a.{suffix}", np.zeros((900, 1000, 3), np.uint8)) for suffix in ("png", "jp2", "webp")]
    for path in paths:
        assert read_image(path).size == (1000, 900)
    monkeypatch.setattr(safe_reading, "MIN_ALLOWANCE", 0)
    safe_reading.set_allowance(lambda: 10_000_000)  # 900 x 1000 x 3 x 4 bytes are 10.8 MB
    try:
        for path in paths:
            with pytest.raises(OutOfResources, match="1000x900"):
                read_image(path)
    finally:
        safe_reading.set_allowance(None)


def test_a_large_picture_is_decoded_once(tmp_path):
    # 3000 x 3000 RGB as float32 are 108 MB: whole in eight bits as well, or twice in float32, would show.
    path = store(tmp_path / "a.png", np.zeros((3000, 3000, 3), np.uint8))
    code = (
        "import sys\nfrom schemas.images import read_image\n"
        "peak = lambda: next(int(line.split()[1]) for line in open('/proc/self/status') if line.startswith('VmHWM'))\n"
        "before = peak()\nimage = read_image(sys.argv[1])\nprint(peak() - before)"
    )
    command = [sys.executable, "-c", code, path]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert 108 * 0.9 < int(done.stdout) * 1024 / 1e6 < 108 + 22  # the bands, and the codec's own


def test_pipes_devices_and_folders_are_no_images(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "zero.png").symlink_to("/dev/zero")
    (tmp_path / "folder.png").mkdir()
    for name in ("pipe.png", "zero.png", "folder.png"):
        for read in (read_image, image_size):
            with pytest.raises(BadInput, match=name):
                read(tmp_path / name)


def test_codecs_print_nothing_of_their_own(tmp_path):
    path = tmp_path / "a.png"
    write_png(path, noise(32, 32, 3))
    path.write_bytes(path.read_bytes()[:-200])
    code = (
        "import sys\nfrom schemas.errors import BadInput\nfrom schemas.images import read_image\n"
        "try: read_image(sys.argv[1])\nexcept BadInput: print('refused')"
    )
    command = [sys.executable, "-c", code, path]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert (done.stdout, done.stderr) == ("refused\n", "")


def test_a_codec_that_cannot_write_is_reported_as_the_disk_refusing(tmp_path):
    code = (
        "import resource, signal, sys, numpy as np\n"
        "from schemas.errors import OutOfResources\nfrom schemas.images import write_png\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, resource.RLIM_INFINITY))\n"
        "pixels = np.random.default_rng(0).integers(0, 256, (200, 200, 3)).astype(np.uint8)\n"
        "try: write_png(sys.argv[1], pixels)\nexcept OutOfResources as e: print(e)"
    )
    command = [sys.executable, "-c", code, tmp_path / "a.png"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert done.stdout.startswith("no space left") and done.stderr == ""
    assert os.listdir(tmp_path) == []
    with pytest.raises(OutOfResources):
        write_png("/proc/nowhere/a.png", noise(3, 3, 3))


def test_srgb_curve_against_published_values_and_its_inverse():
    # IEC 61966-2-1: code 0.5 is 0.2140 light; the breakpoint is 0.04045 -> 0.0031308.
    encoded = np.array([0.0, 0.04045, 0.5, 1.0])
    np.testing.assert_allclose(linear_from_srgb(encoded), [0, 0.0031308, 0.21404114, 1], atol=2e-7)
    values = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-7)
    assert linear_from_srgb(np.float32([0.2])).dtype == np.float32
