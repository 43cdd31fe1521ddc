"""The page of an evaluation: complete, well-formed, self-contained, readable without seeing."""

import base64
import copy
import io
import re
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from schemas.safe_names import listed
from stages.evaluation.metric_definitions import KINDS
from stages.evaluation.metrics import summarize
from stages.evaluation.test_views import Photo, Render
from stages.report.charts import bar_chart, curve_chart, pairs_chart
from stages.report.contact_sheet import ContactSheet, chosen_views
from stages.report.evaluation_page import Pictures, SheetRow, build_page
from stages.report.formatting import clock, count, duration, megabytes, number
from stages.report.thumbnails import NOT_FINITE, Picture, depth_picture, depth_range, encode, error_picture, shown
from tests.stages import evaluation_fixture as made

VOID = {"meta", "link", "img", "br", "hr", "input"}


class Reader(HTMLParser):
    """Collects tags and text; complains of tags that are not closed in order."""

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.text = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        self.text.append(data)


REPORT = {
    "field": "fern <b>", "scene": "fern & co", "stylized": False, "painting": "", "view_count": 2,
    "resolution": "40x30", "pairs": [], "curve": None, "device": "cpu", "seed": 7, "versions": {"torch": "2.13"},
    "views": [
        {"name": "a", "psnr": 21.25, "ssim": 0.7345, "remark": ""},
        {"name": "b", "psnr": None, "ssim": None, "remark": "3 of 9 pixels of the render are not finite"},
    ],
    "stages": [
        {"kind": "field", "name": "fern", "stage": "fit", "seconds": 301.0, "peak_memory_mb": 1234.5,
         "bytes": 5_000_000, "parameters": 2_500_000, "device": "cpu", "created": "", "remark": ""},
        {"kind": "scene", "name": "gone", "stage": "", "seconds": None, "peak_memory_mb": None, "bytes": None,
         "parameters": None, "device": "", "created": "", "remark": "cannot be read: gone"},
    ],
    "warnings": ["1 of 2 views could not be measured"],
    "not_measured": [{"what": "LPIPS", "why": "Its weights were not found."}],
}  # fmt: skip


def report_with_all_figures():
    report = copy.deepcopy(REPORT)
    values = {kind.key: 0.123456 + i for i, kind in enumerate(KINDS)}
    figures = summarize([{"name": "a", **values}, {"name": "b", **values}], {"gap": 7}, {"nnfm": {"the photos": 9.5}})
    report["figures"] = [figure.as_json() for figure in figures]
    return report


def pictures():
    image = np.random.default_rng(0).random((30, 40, 3))
    encoded = encode([Picture(image, "photo", 'Photo of "a"'), Picture(image, "error", "Error")], 10**6)
    curve = [{"seconds": s, "psnr": 20 + s, "held_out": s < 3, "parameters": 1e5} for s in (1, 2, 3)]
    charts = [
        bar_chart("psnr_views", "PSNR", "dB", ["a", "b"], [21.25, None]),
        curve_chart("quality_seconds", "Quality", curve),
        pairs_chart("consistency_pairs", "RMSE", {"1 frame apart": [(0, 0.1), (1, 0.2)]}),
    ]
    return Pictures([SheetRow("a (worst)", encoded)], painting=encoded[0], depth_range=(1.0, 2.0), charts=charts)


@pytest.fixture(scope="module")
def page():
    return build_page(report_with_all_figures(), pictures())


def read(page):
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader


def test_every_figure_stands_on_the_page_with_its_protocol(page):
    told = " ".join(read(page).text)
    for figure in report_with_all_figures()["figures"]:
        assert figure["label"] in told and figure["protocol"] in told
        assert number(figure["mean"], figure["digits"]) in told
    for text in ("9.5", "1 of 2 views could not", "Its weights were not found.", "5 min 1 s", "1.23 GB", "2.50 million",
                 "cannot be read: gone", "3 of 9 pixels"):  # fmt: skip
        assert text in told, text


def test_nothing_is_fetched_from_elsewhere(page):
    for tag, attributes in read(page).tags:
        assert tag not in ("script", "iframe", "object", "embed")
        for key, value in attributes.items():
            if key in ("src", "href", "xlink:href", "srcset", "data", "action"):
                assert value.startswith(("data:", "#")), (tag, key, value)
    assert not re.search(r"@import|url\((?!#)|https?:", page)


def test_ids_are_unique_and_references_meet_them(page):
    tags = read(page).tags
    ids = [attributes["id"] for _, attributes in tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in tags:
        wanted = [attributes.get("aria-labelledby", "")]
        wanted += [attributes[key][1:] for key in ("href",) if attributes.get(key, "").startswith("#")]
        wanted += re.findall(r"url\(#([^)]+)\)", " ".join(filter(None, attributes.values())))
        assert {name for name in wanted if name} <= set(ids), wanted


def test_it_can_be_read_without_seeing(page):
    reader = read(page)
    images = [attributes for tag, attributes in reader.tags if tag == "img"]
    assert len(images) == 3 and all(image["alt"].strip() and image["width"] for image in images)
    assert next(attributes for tag, attributes in reader.tags if tag == "html")["lang"] == "en"
    headings = [int(tag[1]) for tag, _ in reader.tags if re.fullmatch(r"h[1-6]", tag)]
    assert headings.count(1) == 1 and all(b - a <= 1 for a, b in pairwise(headings))
    assert all("scope" in attributes for tag, attributes in reader.tags if tag == "th")
    tags = [tag for tag, _ in reader.tags]
    assert tags.count("caption") == tags.count("table") == 3
    drawings = [attributes for tag, attributes in reader.tags if tag == "svg"]
    assert len(drawings) == 3 and all(d["role"] == "img" and d["aria-labelledby"] for d in drawings)


def test_names_are_escaped(page):
    assert "fern <b>" not in page and "fern &lt;b&gt;" in page and "fern & co" not in page


def test_charts_take_the_ink_of_the_page_only_when_inlined():
    chart = bar_chart("psnr_views", "PSNR", "dB", ["a"], [20.0])
    assert "currentColor" in chart.inline() and "currentColor" not in chart.svg
    assert "#24292f" not in chart.inline()


def test_a_curve_names_what_is_held_out_and_what_is_trained_on():
    """Decision 0003: from three quarters of the budget on, or always with few photos, the views looked at teach too."""
    curve = [{"seconds": s, "psnr": 20 + s, "held_out": s < 3} for s in (1, 2, 3, 4)]
    chart = curve_chart("quality_seconds", "Quality", curve)
    assert chart.told.endswith("held out 21.00 dB at 1 s to 22.00 dB at 2 s; of views trained on 23.00 dB at 3 s to "
                               "24.00 dB at 4 s")  # fmt: skip
    assert "22.00 dB held out" in chart.svg and "24.00" not in chart.svg and "stroke-dasharray" in chart.svg
    alone = curve_chart("quality_seconds", "Quality", curve[2:])
    assert "24.00 dB trained on" in alone.svg and "held out" not in alone.svg + alone.told


def test_pictures_shrink_until_they_fit():
    random = np.random.default_rng(1)
    noise = [Picture(random.random((400, 600, 3)), "photo", "noise") for _ in range(4)]
    roomy, tight = encode(noise, 10**7), encode(noise, 150_000)
    assert roomy[0].width == 480 and tight[0].width < 480
    assert sum(len(picture.uri) for picture in tight) <= 150_000
    decoded = Image.open(io.BytesIO(base64.b64decode(tight[0].uri.split(",")[1])))
    assert decoded.size == (tight[0].width, tight[0].height) and decoded.format == "JPEG"


def test_what_the_sheet_keeps_of_a_view_does_not_grow_with_the_photos():
    held = []
    for scale in (6, 12):
        view = made.camera(0.0, "a").scaled(scale)
        seen = made.look(view)
        render = Render("a", view, seen.rgb, seen.alpha, seen.z, 0, 0)
        sheet = ContactSheet(Picture(seen.rgb, "the painting", "P").small(), stylized=True)
        sheet.add("a", {}, render, Photo(seen.rgb, None, None, False, False), render)
        (kept,) = sheet._views
        held.append([one.image.nbytes for one in kept.pictures] + [kept.z.nbytes, kept.alpha.nbytes])
        encoded = sheet.encoded()
        assert [picture.width for picture in encoded.sheet[0].pictures] == [480] * 4
        assert encoded.depth_range == pytest.approx((2.42, 5.0), abs=0.05)  # the ball's front, the wall
    assert held[0] == held[1] == [480 * 360 * 3 * 4] * 3 + [480 * 360 * 4] * 2


def test_what_is_not_finite_is_seen():
    image = np.full((4, 4, 3), 0.5)
    image[1, 2, 0] = np.nan
    assert tuple(shown(image)[1, 2]) == NOT_FINITE and np.isfinite(shown(image)).all()
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


def test_the_sheet_shows_worst_best_and_what_failed():
    rows = [{"name": str(i), "psnr": value, "remark": ""} for i, value in enumerate([20.0, 25.0, 15.0, 22, 23, 24, 21])]
    assert dict(chosen_views(rows, "psnr", 3)) == {1: "best", 2: "worst", 0: ""}
    rows[4].update(psnr=None, remark="not finite")
    chosen = dict(chosen_views(rows, "psnr", 4))
    assert chosen[4] == "see the remark" and chosen[1] == "best" and chosen[2] == "worst" and len(chosen) == 4
    assert chosen_views(rows[:1], "psnr", 6) == [(0, "")]


def test_summaries_leave_out_what_is_not_a_number_and_say_so():
    rows = [{"psnr": 20.0}, {"psnr": None}, {"psnr": 30.0}, {"psnr": float("nan")}, {"ssim": None}]
    (figure,) = summarize(rows, {})
    assert (figure.mean, figure.median, figure.min, figure.max) == (25, 25, 20, 30)
    assert (figure.count, figure.left_out) == (2, 2)


def test_numbers_in_words():
    assert (number(-1.5, 1), number(None, 2), number(float("nan"), 2)) == ("−1.5", "–", "–")
    assert (duration(59.96), duration(245), duration(3725), duration(None)) == ("60.0 s", "4 min 5 s", "1 h 2 min", "–")
    assert (clock(12.34), clock(245), clock(3725)) == (("12.3", "s"), ("4:05", "min"), ("1:02", "h"))
    assert (megabytes(1500), megabytes(5e6, 1e6)) == ("1.50 GB", "5.0 MB")
    assert (count(950), count(12_345), count(4.56e6)) == ("950", "12.3 thousand", "4.56 million")
    assert listed(list("abcdefgh"), 3) == "a, b, c and 5 more"
