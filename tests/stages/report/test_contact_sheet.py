"""The contact sheet: which views it shows, in bounded memory."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from stages.evaluation.test_views import Photo, Render
from stages.report.contact_sheet import (
    NOT_FINITE,
    ContactSheet,
    Picture,
    chosen_views,
    depth_picture,
    depth_range,
    displayable,
    encode,
    error_picture,
)
from tests.stages import evaluation_fixture as made


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


def test_memory_per_view_does_not_grow_with_the_photos():
    held = []
    for scale in (6, 12):
        view = made.camera(0.0, "a").scaled(scale)
        seen = made.look(view)
        render = Render("a", view, seen.rgb, seen.alpha, seen.z, 0, 0)
        sheet = ContactSheet(Picture(seen.rgb, "the style image", "P").small(), stylized=True)
        sheet.add("a", {}, render, Photo(seen.rgb, None, None, False, False), render)
        (kept,) = sheet._views
        held.append([one.image.nbytes for one in kept.pictures] + [kept.z.nbytes, kept.alpha.nbytes])
        encoded = sheet.encoded()
        assert [picture.width for picture in encoded.sheet[0].pictures] == [480] * 4
        assert encoded.depth_range == pytest.approx((2.42, 5.0), abs=0.05)  # the ball's front, the wall
    assert held[0] == held[1] == [480 * 360 * 3 * 4] * 3 + [480 * 360 * 4] * 2


def test_the_sheet_shows_worst_best_and_what_failed():
    rows = [{"name": str(i), "psnr": value, "remark": ""} for i, value in enumerate([20.0, 25.0, 15.0, 22, 23, 24, 21])]
    assert dict(chosen_views(rows, "psnr", 3)) == {1: "best", 2: "worst", 0: ""}
    rows[4].update(psnr=None, remark="not finite")
    chosen = dict(chosen_views(rows, "psnr", 4))
    assert chosen[4] == "see the remark" and chosen[1] == "best" and chosen[2] == "worst" and len(chosen) == 4
    assert chosen_views(rows[:1], "psnr", 6) == [(0, "")]
