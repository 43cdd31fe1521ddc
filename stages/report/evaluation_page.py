"""The HTML page of an evaluation."""

from collections.abc import Sequence
from dataclasses import dataclass

from stages.evaluation.metrics import is_number
from stages.report.contact_sheet import DEPTH_COLORS, ERROR_COLORS, MAX_ERROR, Pictures, css_gradient
from stages.report.pages import clock, count, number, render_page

EDIT_TILES = ("background_mse", "background_ratio", "change_lab", "bleeding", "short_rmse")
STYLE_TILES = ("sifid", "edges_kept", "color_distribution", "speckle", "short_rmse", "long_rmse")
FIT_TILES = ("psnr", "ssim", "lpips", "stlpips", "depth_abs_rel")


@dataclass(frozen=True)
class Tile:
    """One large number at the top of the page."""

    label: str
    value: str
    unit: str
    note: str


@dataclass(frozen=True)
class Legend:
    """A color bar: text at its low end, CSS gradient, text at its high end."""

    low: str
    gradient: str
    high: str


def build_page(report: dict, pictures: Pictures) -> str:
    """The page of a report, from report.json as a dictionary and its pictures."""
    training = report.get("training_views", ())
    views = "1 held-out view" if report["view_count"] == 1 else f"{report['view_count']} held-out views"
    field_kind = "edited" if report.get("edit") else "stylized" if report["stylized"] else "radiance"
    return render_page(
        "evaluation.html",
        report=report,
        pictures=pictures,
        summary=f"{views} of {report['resolution']} pixels, rendered from the {field_kind} field “{report['field']}”.",
        tiles=_tiles(report),
        legends=_legends(pictures),
        remarked=any(view.get("remark") for view in report["views"]),
        references=list(dict.fromkeys(name for metric in report["metrics"] for name in metric["reference"])),
        view_metrics=_measured(report["metrics"], report["views"]),
        training_metrics=_measured(report["metrics"], training),
        total_seconds=sum(stage["seconds"] for stage in report["stages"] if is_number(stage["seconds"])),
        versions=", ".join(f"{name} {version}" for name, version in sorted(report["versions"].items())),
    )


def _measured(metrics: Sequence[dict], views: Sequence[dict]) -> list[dict]:
    """The metrics that any of these views has."""
    return [metric for metric in metrics if any(metric["key"] in view for view in views)]


def _tiles(report: dict) -> list[Tile]:
    by_key = {metric["key"]: metric for metric in report["metrics"]}
    tiles = []
    for key in EDIT_TILES if report.get("edit") else STYLE_TILES if report["stylized"] else FIT_TILES:
        if metric := by_key.get(key):
            references = [f"{name}: {number(mean, metric['digits'])}" for name, mean in metric["reference"].items()]
            better = f"{metric['better']} is better" if metric["better"] else ""
            digits = metric["digits"] if report.get("edit") else min(metric["digits"], 3)
            unit = "" if metric["unit"] == "fraction" else metric["unit"]
            tiles.append(Tile(metric["label"], number(metric["mean"], digits), unit, "; ".join(references) or better))
    maker = next((stage for stage in reversed(report["stages"]) if stage["kind"] == "field"), None)
    if maker:
        size = f"{count(maker['parameters'])} parameters" if maker["parameters"] else ""
        tiles.append(Tile(f"Time of {maker['stage'] or 'its stage'}", *clock(maker["seconds"]), size))
    return tiles


def _legends(pictures: Pictures) -> list[Legend]:
    captions = {picture.caption for row in pictures.sheet for picture in row.pictures}
    errors = css_gradient(ERROR_COLORS)
    legends = [
        Legend(f"{name.capitalize()}: 0", errors, f"{MAX_ERROR:g} or more, mean over RGB")
        for name in ("error", "change")
        if name in captions
    ]
    if pictures.depth_range and "depth" in captions:
        near, far = pictures.depth_range
        legends.append(
            Legend(f"Depth: {near:.3g}", css_gradient(DEPTH_COLORS), f"{far:.3g} scene units; gray: transparent")
        )
    return legends
