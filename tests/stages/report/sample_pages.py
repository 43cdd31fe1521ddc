"""One page each of eval, compare and stress, with everything that can be on it, made without computing anything."""

import copy
from dataclasses import asdict
from pathlib import Path

import numpy as np

from schemas.images import write_png
from stages.comparison import page as comparison_page
from stages.comparison.page import comparison_charts
from stages.comparison.runs import CHARTED, EDITS, FITS, STYLIZATIONS, Gap, Run, RunMetric
from stages.evaluation.metric_definitions import BY_KEY, DEFINITIONS
from stages.evaluation.metrics import summarize
from stages.report import evaluation_page
from stages.report.charts import bar_chart, curve_chart, pairs_chart
from stages.report.contact_sheet import Picture, Pictures, SheetRow, encode
from stages.stress import page as stress_page
from stages.stress.baseline import Compared
from stages.stress.outcomes import cells_of
from stages.stress.page import heat_map
from tests.stages.comparison_fixture import FACTS
from tests.stages.stress_fixture import outcome

REPORT = {
    "field": "fern <b>", "scene": "fern & co", "stylized": False, "style_image": "", "view_count": 2, "edit": None,
    "resolution": "40x30", "pairs": [], "curve": None, "device": "cpu", "seed": 7, "versions": {"torch": "2.13"},
    "training_views": [{"name": "c", "train_bleeding": 0.25, "remark": ""}],
    "views": [
        {"name": "a", "psnr": 21.25, "ssim": 0.7345, "remark": ""},
        {"name": "b", "psnr": None, "ssim": None, "remark": "3 of 9 pixels of the render are NaN or infinite"},
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


def report_with_all_metrics() -> dict:
    """REPORT with a value of every metric there is."""
    report = copy.deepcopy(REPORT)
    values = {metric.key: 0.123456 + i for i, metric in enumerate(DEFINITIONS)}
    facts = {"gap": 7, "style_label": "the style image"}
    metrics = summarize([{"name": "a", **values}, {"name": "b", **values}], facts, {"nnfm": {"the photos": 9.5}})
    report["metrics"] = [asdict(metric) for metric in metrics]
    return report


def pictures() -> Pictures:
    """A contact sheet of two views, a style image and one chart of each kind."""
    image = np.random.default_rng(0).random((90, 120, 3))
    names = ("photo", "render, 21.25 dB", "error", "depth")
    encoded = encode([Picture(image, name, f'{name} of "a"') for name in names], 10**6)
    curve = [{"seconds": s, "psnr": 20 + s, "held_out": s < 3, "parameters": 1e5} for s in (1, 2, 3)]
    charts = [
        bar_chart("psnr_views", "PSNR", "dB", [f"image_{i:03d}" for i in range(9)], [21.25, None, *range(15, 22)]),
        curve_chart("quality_seconds", "Quality against time", curve),
        pairs_chart("consistency_pairs", "RMSE", {"1 frame apart": [(0, 0.1), (1, 0.2)]}),
    ]
    sheet = [SheetRow("a (worst)", encoded), SheetRow("b", encoded)]
    return Pictures(sheet, style_image=encoded[0], depth_range=(1.0, 2.0), charts=charts)


def evaluation() -> str:
    return evaluation_page.build_page(report_with_all_metrics(), pictures())


def runs() -> list[Run]:
    """Three runs of each family, with their charted metrics; two protocols among the fits."""
    found = []
    for family in (FITS, STYLIZATIONS, EDITS):
        for i in range(3):
            metrics = {
                key: RunMetric(
                    0.2 + i / 10, BY_KEY[key].label.format_map(FACTS), BY_KEY[key].unit,
                    BY_KEY[key].better, f"protocol {i // 2 if family == FITS else 0}", 3, 0,
                )
                for key in CHARTED[family]
            }  # fmt: skip
            costs = {"seconds": 10.0 * 4**i, "peak_memory_mb": 900.0 + i, "parameters": 1e5 * (i + 1)}
            found.append(
                Run(
                    family=family, work="lego", name=f"{family}-with-a-rather-long-name-{i}", group="lego, starry.jpg",
                    method="arf", settings="60s, grow", device="cpu", stages=("edit_dataset", "finetune"), costs=costs,
                    metrics=metrics,
                )
            )  # fmt: skip
    return found


def comparison() -> str:
    fronts = {run.title: ["psnr/seconds", "sifid/seconds"] if run.name.endswith("0") else [] for run in runs()}
    gaps = [Gap("lego/fit: psnr", "Not in its report; run: stylerf eval /somewhere/rather/deep/in/a/file/system/lego")]
    return comparison_page.build_page(runs(), comparison_charts(runs()), gaps, fronts)


def stress(folder: Path) -> str:
    """folder: where the worst views are written."""
    write_png(folder / "arf.png", np.random.default_rng(1).integers(0, 255, (80, 160, 3), np.uint8))
    outcomes = [outcome(seed=seed, score=20.0 + seed, ok=seed > 0, fault="views-3") for seed in range(3)]
    outcomes.append(outcome("arf", "style-white", score=0.1, ok=False, remedies=True, picture="arf.png"))
    outcomes.append(outcome("arf", "style-white", score=0.5, picture="arf.png"))
    cells = cells_of(outcomes)
    compared = Compared(["arf under style-white: 0 of 1, was 1 of 1"], [], ["fit under blur: not in the baseline"], 2)
    conditions = {"work": "/somewhere/lego", "side": 24, "features": ""}
    return stress_page.build_page(cells, heat_map(cells), conditions, [("views-8", "too few views")], compared, folder)
