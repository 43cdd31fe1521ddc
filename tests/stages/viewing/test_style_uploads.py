"""Paintings from the page: checked, cropped, kept by their content."""

import io

import numpy as np
import pytest
from PIL import Image

from schemas.errors import BadInput
from schemas.images import read_image
from stages.viewing.style_uploads import cropped, kept, read_upload


def painting(format: str = "PNG") -> tuple[bytes, np.ndarray]:
    pixels = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format)
    return stream.getvalue(), pixels


def test_an_upload_is_read_and_kept_under_a_name_of_its_content(tmp_path):
    content, pixels = painting()
    image = read_upload("../../Star y Night.PNG", content)
    np.testing.assert_allclose(image, pixels / 255, atol=1e-6)
    path = kept(image, tmp_path / "styles")
    assert path == kept(image, tmp_path / "styles") and path.parent == tmp_path / "styles"
    np.testing.assert_allclose(read_image(path).pixels, pixels / 255, atol=1e-6)
    assert [one.name for one in (tmp_path / "styles").iterdir()] == [path.name]


def test_a_crop_stays_within_the_painting():
    _, pixels = painting()
    np.testing.assert_array_equal(cropped(pixels, 0.5, 0.5, 1.0), pixels)
    np.testing.assert_array_equal(cropped(pixels, 0.5, 0.5, 0.5), pixels[10:30, 15:45])
    np.testing.assert_array_equal(cropped(pixels, 1.0, 0.0, 0.5), pixels[:20, 30:])
    assert cropped(pixels, 0.5, 0.5, 0.01).shape[:2] == (16, 16)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"no image", "style.png"),
        ("a.exe", b"MZ", "expected a style image in one of"),
        ("a", painting()[0], "expected a style image in one of"),
        ("a.png", b"\0" * 50_000_001, "at most 50 MB"),
    ],
)
def test_what_is_no_painting_is_refused(name, content, words):
    with pytest.raises(BadInput, match=words):
        read_upload(name, content)


def test_a_painting_of_a_few_pixels_is_refused():
    with pytest.raises(BadInput, match="at least 16 pixels"):
        cropped(np.zeros((8, 80, 3)), 0.5, 0.5, 1.0)
