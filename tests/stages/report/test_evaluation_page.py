"""The page of an evaluation shows everything the report holds."""

import html

from stages.report.contact_sheet import Pictures
from stages.report.evaluation_page import build_page
from stages.report.pages import number
from tests.stages.report.sample_pages import REPORT, pictures, report_with_all_metrics


def test_every_metric_is_on_the_page_with_its_protocol():
    page = html.unescape(build_page(report_with_all_metrics(), pictures()))
    for metric in report_with_all_metrics()["metrics"]:
        assert metric["label"] in page and metric["protocol"] in page
        assert number(metric["mean"], metric["digits"]) in page
    for text in ("9.5", "1 of 2 views could not", "Its weights were not found.", "5 min 1 s", "1.23 GB", "2.50 million",
                 "cannot be read: gone", "3 of 9 pixels", "0.2500"):  # fmt: skip
        assert text in page, text


def test_sections_without_content_are_left_out():
    empty = REPORT | {"metrics": [], "views": [], "training_views": [], "stages": [], "not_measured": []}
    page = build_page(empty, Pictures([]))
    assert "Nothing could be measured" in page and "Every metric was measured" in page
    assert not any(f'id="{name}"' in page for name in ("pictures", "charts", "views", "training", "cost"))
