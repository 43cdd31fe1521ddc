"""Words of strangers in pages, charts and tables: shown as text, never as markup, formula or TeX."""

import csv
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from schemas.images import write_png
from stages.comparison.page import comparison_charts
from stages.comparison.runs import Run, RunMetric
from stages.evaluation.metrics import write_csv
from stages.report.charts import bar_chart, pairs_chart
from stages.report.pages import escape
from stages.stress.outcomes import FOLDER, Outcome, cells_of, load_outcome, save_outcome
from stages.stress.page import build_page

HOSTILE = "m$\\frac$q <b>&\"'\x1b[31m\u202e"


def outcome(**changed):
    reported = dict(
        key="k" * 64, method="fit", fault="blur", seed=1, remedies=False, ok=True, why="", score=20.0,
        figures={"psnr": 20.0}, seconds=3.0, picture="",
    )  # fmt: skip
    return Outcome(**{**reported, **changed})


def test_labels_of_charts_are_literal():
    labels = [HOSTILE, "a_b^c", "$x$"]
    for chart in (
        bar_chart("psnr", f"PSNR {HOSTILE}", "dB", labels, [1.0, 2.0, 3.0]),
        pairs_chart("p", HOSTILE, {HOSTILE: [(0, 1.0), (1, 2.0)], "$y$": [(0, 1.0)]}),
    ):
        texts = "".join(ElementTree.fromstring(chart.svg).itertext())
        assert r"m$\frac$q <b>&" in texts and r"\x1b[31m\u202e" in texts
        inline = chart.inline()
        assert "<b>" not in inline and "\x1b" not in inline and "\u202e" not in inline
    assert "$x$" in bar_chart("a", "A", "", ["$x$"], [1.0]).svg


def test_labels_of_a_comparison_are_literal_on_logarithmic_axes_too():
    runs = [
        Run(
            family="fits", work=HOSTILE, name=f"main{power}", group=HOSTILE, method="vm", settings="", device="cpu",
            stages=("nerf_fit",), costs={"seconds": 10.0**power, "peak_memory_mb": 1.0, "parameters": 10.0},
            metrics={"psnr": RunMetric(20.0, "PSNR", "dB", "higher", "of views", 4, 0)},
        )
        for power in range(3)
    ]  # fmt: skip
    seconds = next(chart for chart in comparison_charts(runs) if chart.name == "fits_seconds")
    texts = "\n".join(ElementTree.fromstring(seconds.svg).itertext())
    assert r"m$\frac$q <b>&" in texts and "mathdefault" not in texts and re.search(r"^\s*100\s*$", texts, re.M)


def test_text_of_pages_is_no_markup():
    shown = escape(HOSTILE)
    assert not re.search(r"[<>\"'\x1b\u202e]", shown) and r"\x1b[31m\u202e" in shown


@pytest.mark.parametrize(
    "text", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", " =1", "\n@x", "\uff1d1+1", '=HYPERLINK("http://x")']
)
def test_cells_are_no_formulas(tmp_path, text):
    write_csv(tmp_path / "a.csv", [{"name": text, "value": -1.5, text: 2}])
    with open(tmp_path / "a.csv", newline="") as stream:
        head, row = csv.reader(stream)
    for cell in (row[0], head[2]):
        assert cell.startswith("'") and cell[1:].isprintable()
    assert row[1:] == ["-1.5", "2"]  # numbers stay numbers


def test_plain_cells_are_left_alone(tmp_path):
    write_csv(tmp_path / "a.csv", [{"name": "fox, a=b", "none": None}])
    assert (tmp_path / "a.csv").read_text() == 'name,none\n"fox, a=b",\n'


def test_an_outcome_comes_back(tmp_path):
    for kept in (outcome(), outcome(score=None, picture="a.png", figures={"x": float("inf")})):
        save_outcome(tmp_path, kept)
        found = load_outcome(tmp_path, kept.name, kept.key)
        assert (found.name, found.score, found.picture) == (kept.name, kept.score, kept.picture)


@pytest.mark.parametrize(
    "changed",
    [
        {"picture": "../../secret.png"}, {"picture": "/etc/passwd"}, {"picture": 3}, {"picture": "a\x1b.png"},
        {"seed": "<b>"}, {"seed": True}, {"score": "high"}, {"seconds": None}, {"figures": []},
        {"figures": {"a": "<b>"}}, {"method": "mine"}, {"fault": "<script>"}, {"ok": 1}, {"why": ["x"]},
        {"remedies": "no"},
    ],
)  # fmt: skip
def test_an_outcome_of_a_stranger_is_not_believed(tmp_path, changed):
    kept = outcome()
    save_outcome(tmp_path, kept)
    path = tmp_path / FOLDER / f"{kept.name}.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    assert load_outcome(tmp_path, kept.name, kept.key) is None
    path.write_text("[" * 100_000)
    assert load_outcome(tmp_path, kept.name, kept.key) is None


def test_only_a_png_of_the_folder_itself_is_embedded(tmp_path):
    chart = bar_chart("a", "A", "", ["a"], [1.0])
    folder = tmp_path / "worst"
    folder.mkdir()
    write_png(folder / "own.png", np.zeros((4, 4, 3), np.uint8))
    write_png(tmp_path / "other.png", np.zeros((4, 4, 3), np.uint8))
    (folder / "link.png").symlink_to(tmp_path / "other.png")
    (folder / "text.png").write_text("secret")
    shown = {
        name: "data:image" in build_page(cells_of([outcome(picture=name)]), chart, {}, [], None, folder)
        for name in ("own.png", "link.png", "text.png", "absent.png", ".")
    }
    assert shown == {"own.png": True, "link.png": False, "text.png": False, "absent.png": False, ".": False}
