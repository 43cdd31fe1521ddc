"""The contact sheet: which views it shows, in bounded memory."""

import pytest

from stages.evaluation.test_views import Photo, Render
from stages.report.contact_sheet import ContactSheet, chosen_views
from stages.report.thumbnails import Picture
from tests.stages import evaluation_fixture as made


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
