"""Deep EXR, read back and flattened by OpenImageIO and by the rules of OpenEXR's document on deep pixels."""

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.deep_exr import DeepSamples, write_deep_exr
from schemas.errors import BadInput
from schemas.exr import ExrView, read_exr

HEIGHT, WIDTH = 5, 7
# Half rounds alpha by up to 2^-12 and colors below 1 by as much, in proportion to what is left behind.
ROUNDING = 1.5e-3


def samples() -> DeepSamples:
    """None to six in a pixel; the first pixels are opaque."""
    generator = np.random.default_rng(3)
    counts = generator.integers(0, 7, (HEIGHT, WIDTH))
    counts[0] = 4
    parts = [generator.dirichlet([1] * count) for count in counts.ravel()]
    alphas = np.where(np.arange(counts.size) < WIDTH, 1.0, generator.random(counts.size))
    weights = np.concatenate([part * alpha for part, alpha in zip(parts, alphas, strict=True)])
    edges = [np.sort(generator.uniform(1, 9, 2 * count)).reshape(-1, 2) for count in counts.ravel()]
    z, z_back = np.concatenate(edges).T
    rgb = generator.random((len(weights), 3)) * weights[:, None]
    return DeepSamples(counts, *(values.astype(np.float32) for values in (z, z_back, rgb, weights)))


def flat(deep: DeepSamples) -> np.ndarray:
    """[h w, 4]: what the samples add up to."""
    pixel = np.repeat(np.arange(deep.counts.size), deep.counts.ravel())
    values = np.column_stack([deep.rgb, deep.weights])
    return np.stack([np.bincount(pixel, values[:, a], deep.counts.size) for a in range(4)], axis=-1)


@pytest.fixture
def written(tmp_path) -> tuple[DeepSamples, oiio.ImageBuf]:
    deep, plane = samples(), np.ones((HEIGHT, WIDTH), np.float32)
    rgb = np.repeat(plane[..., None], 3, 2)
    view = ExrView(rgb, plane, plane, plane, np.eye(4), (7, 7, 3, 2), 0.5, 20, {}, {"field": "fox"})
    write_deep_exr(tmp_path / "d.exr", view, deep)
    return deep, oiio.ImageBuf(str(tmp_path / "d.exr"))


def test_channels_are_those_of_a_deep_picture(written):
    _, image = written
    kinds = dict(zip(image.spec().channelnames, map(str, image.spec().channelformats), strict=True))
    assert image.deep and kinds == dict.fromkeys("RGBA", "half") | {"Z": "float", "ZBack": "float"}
    assert image.spec().getattribute("stylerf:field") == "fox"
    assert image.spec().getattribute("compression") == "zips"


def test_samples_composite_to_the_flat_pixel(written):
    """Front to back by `over`, in a loop over what OpenImageIO reads."""
    deep, image = written
    data = image.deepdata()
    channels = [image.spec().channelnames.index(name) for name in "RGBA"]
    found = np.zeros((data.pixels, 4))
    for pixel in range(data.pixels):
        assert data.samples(pixel) == deep.counts.flat[pixel]
        for sample in range(data.samples(pixel)):
            value = np.array([data.deep_value(pixel, channel, sample) for channel in channels])
            found[pixel] += (1 - found[pixel, 3]) * value
    np.testing.assert_allclose(found, flat(deep), atol=ROUNDING)


def test_openimageio_flattens_to_the_flat_pixel(written):
    deep, image = written
    made = oiio.ImageBufAlgo.flatten(image)
    pixels = made.get_pixels(oiio.FLOAT).reshape(deep.counts.size, -1)
    order = [made.spec().channelnames.index(name) for name in "RGBA"]
    np.testing.assert_allclose(pixels[:, order], flat(deep), atol=ROUNDING)


def test_depths_keep_their_bits_and_order(written):
    deep, image = written
    data, names = image.deepdata(), image.spec().channelnames
    found = {
        name: [data.deep_value(p, names.index(name), s) for p in range(data.pixels) for s in range(data.samples(p))]
        for name in ("Z", "ZBack")
    }
    np.testing.assert_array_equal(np.float32(found["Z"]), deep.z)
    np.testing.assert_array_equal(np.float32(found["ZBack"]), deep.z_back)


def test_equal_samples_give_equal_bytes_and_flat_readers_refuse(tmp_path, written):
    plane = np.ones((HEIGHT, WIDTH), np.float32)
    view = ExrView(np.repeat(plane[..., None], 3, 2), plane, plane, plane, np.eye(4), (7, 7, 3, 2), 0.5, 20)
    for name in ("a", "b"):
        write_deep_exr(tmp_path / f"{name}.exr", view, samples())
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    with pytest.raises(BadInput, match="deep"):
        read_exr(tmp_path / "a.exr")


def test_a_picture_without_samples_is_written(tmp_path):
    plane = np.zeros((2, 3), np.float32)
    view = ExrView(np.zeros((2, 3, 3), np.float32), plane, plane, plane, np.eye(4), (7, 7, 3, 2), 0.5, 20)
    empty = np.zeros(0, np.float32)
    nothing = DeepSamples(np.zeros((2, 3), int), empty, empty, np.zeros((0, 3), np.float32), empty)
    write_deep_exr(tmp_path / "e.exr", view, nothing)
    data = oiio.ImageBuf(str(tmp_path / "e.exr")).deepdata()
    assert data.pixels == 6 and not any(data.samples(pixel) for pixel in range(6))


def test_nan_is_refused(tmp_path):
    plane = np.ones((1, 1), np.float32)
    view = ExrView(np.ones((1, 1, 3), np.float32), plane, plane, plane, np.eye(4), (7, 7, 3, 2), 0.5, 20)
    one = np.ones(1, np.float32)
    deep = DeepSamples(np.ones((1, 1), int), one, one, np.full((1, 3), np.nan, np.float32), one)
    with pytest.raises(ValueError, match="color"):
        write_deep_exr(tmp_path / "n.exr", view, deep)
    assert list(tmp_path.iterdir()) == []
