"""Thumbnails: sizes within a budget, NaN in magenta, near brighter than far."""

import base64
import io

import numpy as np
from PIL import Image

from stages.report.thumbnails import (
    NOT_FINITE,
    Picture,
    depth_picture,
    depth_range,
    displayable,
    encode,
    error_picture,
)


def test_pictures_shrink_until_they_fit():
    random = np.random.default_rng(1)
    noise = [Picture(random.random((400, 600, 3)), "photo", "noise") for _ in range(4)]
    roomy, tight = encode(noise, 10**7), encode(noise, 150_000)
    assert roomy[0].width == 480 and tight[0].width < 480
    assert sum(len(picture.uri) for picture in tight) <= 150_000
    decoded = Image.open(io.BytesIO(base64.b64decode(tight[0].uri.split(",")[1])))
    assert decoded.size == (tight[0].width, tight[0].height) and decoded.format == "JPEG"


def test_nan_is_magenta():
    image = np.full((4, 4, 3), 0.5)
    image[1, 2, 0] = np.nan
    assert tuple(displayable(image)[1, 2]) == NOT_FINITE and np.isfinite(displayable(image)).all()
    assert tuple(error_picture(image, np.zeros((4, 4, 3)))[1, 2]) == NOT_FINITE
    z, alpha = np.full((4, 4), 2.0), np.ones((4, 4))
    z[0, 0], alpha[3, 3] = np.nan, 0
    depth = depth_picture(z, alpha, 1, 4)
    assert tuple(depth[0, 0]) == NOT_FINITE and tuple(depth[3, 3]) == (0.5, 0.5, 0.5)
    assert depth_range([z], [alpha])[0] == 2.0 and depth_range([], []) == (1.0, 2.0)


def test_near_is_brighter_than_far():
    depth = depth_picture(np.array([[1.0, 2.0, 4.0]]), np.ones((1, 3)), 1, 4)
    light = depth.sum(axis=-1)[0]
    assert light[0] > light[1] > light[2]
