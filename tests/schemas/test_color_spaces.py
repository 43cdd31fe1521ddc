"""Color spaces: against OpenColorIO's ACES config, published numbers, and OpenEXR's own check of headers."""

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from schemas.color_spaces import ACESCG, COLOR_SPACES, REC709, matrix_between
from schemas.exr import ExrView, read_exr, write_exr
from stages.configs.render import COLORSPACES

# colour-science and OpenColorIO print these for Rec.709 to ACEScg by Bradford.
PUBLISHED = [[0.613097, 0.339523, 0.047379], [0.070194, 0.916354, 0.013452], [0.020616, 0.109570, 0.869815]]


def test_the_matrix_to_acescg_is_the_published_one():
    np.testing.assert_allclose(matrix_between(REC709, ACESCG), PUBLISHED, atol=2e-6)


def test_white_and_grays_stay_what_they_are():
    np.testing.assert_allclose(matrix_between(REC709, ACESCG) @ np.ones(3), 1, atol=1e-12)
    both = matrix_between(ACESCG, REC709) @ matrix_between(REC709, ACESCG)
    np.testing.assert_allclose(both, np.eye(3), atol=1e-12)
    assert np.array_equal(matrix_between(REC709, REC709), np.eye(3))


def test_colors_convert_as_opencolorio_does():
    config = oiio.ColorConfig("ocio://default")
    colors = np.vstack([np.eye(3), np.random.default_rng(0).random((20, 3))]).astype(np.float32)[None]
    source = oiio.ImageBuf(np.ascontiguousarray(colors))
    target = oiio.ImageBufAlgo.colorconvert(
        source, "Linear Rec.709 (sRGB)", "ACEScg", colorconfig="ocio://default", unpremult=False
    )
    assert config.getNumColorSpaces() > 0 and not target.has_error
    np.testing.assert_allclose(colors @ matrix_between(REC709, ACESCG).T, target.get_pixels(oiio.FLOAT), atol=2e-5)


@pytest.mark.parametrize("name", COLOR_SPACES)
def test_headers_name_their_space_without_contradiction(tmp_path, name):
    plane = np.ones((2, 3), np.float32)
    rgb = np.full((2, 3, 3), 0.5, np.float32)
    write_exr(
        tmp_path / "v.exr",
        ExrView(rgb, plane, plane, plane, np.eye(4), (3, 3, 1, 1), 0.1, 9, colorspace=name),
    )
    spec = oiio.ImageInput.open(str(tmp_path / "v.exr")).spec()
    space = COLOR_SPACES[name]
    assert spec.getattribute("colorInteropID") == space.interop_id
    np.testing.assert_allclose(spec.getattribute("chromaticities"), space.chromaticities, atol=1e-7)
    header = OpenEXR.File(str(tmp_path / "v.exr"), header_only=True).header()
    assert OpenEXR.checkColorMetadata(header) == OpenEXR.OK
    assert OpenEXR.chromaticitiesToColorInteropID(space.chromaticities) == space.interop_id
    assert read_exr(tmp_path / "v.exr").colorspace == name


def test_options_name_the_spaces_that_there_are():
    assert set(COLORSPACES) == set(COLOR_SPACES) and COLOR_SPACES[COLORSPACES[0]] == REC709
