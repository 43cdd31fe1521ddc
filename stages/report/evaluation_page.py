"""One self-contained HTML page of an evaluation: no script, no external reference, readable without seeing."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from stages.report.charts import Chart
from stages.report.formatting import clock, count, escape, number
from stages.report.stylesheet import CSS
from stages.report.tables import TRAINING, figures_table, stages_table, views_table
from stages.report.thumbnails import DEPTH_COLORS, ERROR_COLORS, ERROR_FULL, Encoded, color_bar


@dataclass(frozen=True)
class SheetRow:
    """One view on the contact sheet."""

    heading: str
    pictures: Sequence[Encoded]


@dataclass(frozen=True)
class Pictures:
    """All pictures of a page. `depth_range`: the depths at the ends of the depth colors, scene units."""

    sheet: Sequence[SheetRow]
    painting: Encoded | None = None
    depth_range: tuple[float, float] | None = None
    charts: Sequence[Chart] = field(default_factory=list)


EDIT_TILES = ("background_mse", "background_ratio", "change_lab", "bleeding", "short_rmse")
TILES = {
    False: ("psnr", "ssim", "lpips", "stlpips", "depth_abs_rel"),
    True: ("nnfm", "content_ssim", "palette", "short_rmse", "long_rmse"),
}


def build_page(report: dict, pictures: Pictures) -> str:
    """The page of a report (report.json as a dictionary) with its pictures; HTML 5, UTF-8."""
    title = f"{report['field']} on {report['scene']}"
    sections = [
        ("pictures", "Held-out views", _sheet(pictures, any(view.get("remark") for view in report["views"]))),
        ("figures", "Figures", figures_table(report["figures"])),
        ("charts", "Charts", "".join(_chart(chart) for chart in pictures.charts)),
        ("views", "View by view", views_table(report["views"], report["figures"])),
        ("training", "Training views", views_table(report.get("training_views", ()), report["figures"], TRAINING)),
        ("cost", "What it cost", stages_table(report["stages"])),
        ("notes", "What was not measured, and why", _notes(report["not_measured"])),
    ]
    sections = [section for section in sections if section[2]]
    links = "".join(f'<li><a href="#{key}">{escape(heading)}</a></li>' for key, heading, _ in sections)
    body = "".join(
        f'<section id="{key}" aria-labelledby="{key}-heading"><h2 id="{key}-heading">{escape(heading)}</h2>'
        f"{content}</section>"
        for key, heading, content in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<title>Evaluation: {escape(title)}</title><link rel="icon" href="data:,"><style>{CSS}</style></head><body>'
        '<a class="skip" href="#content">Skip to the content</a>'
        f"{_header(report, pictures.painting, links)}"
        f'<main id="content">{_warnings(report["warnings"])}{_tiles(report)}{body}</main>'
        f"{_footer(report)}</body></html>\n"
    )


def _header(report: dict, painting: Encoded | None, links: str) -> str:
    kind = "edited field" if report.get("edit") else "stylized field" if report["stylized"] else "radiance field"
    told = (
        f"{report['view_count']} held-out view{'s' if report['view_count'] != 1 else ''} of "
        f"{report['resolution']} pixels of the scene “{report['scene']}”, rendered from the {kind} “{report['field']}”."
    )
    shown = ""
    if painting:
        caption = f"<figcaption>{escape(painting.caption)}</figcaption>"
        shown = f'<figure class="painting">{_image(painting)}{caption}</figure>'
    return (
        f'<header><div><h1><span class="soft">Evaluation of</span> {escape(report["field"])} <span class="soft">on '
        f"{escape(report['scene'])}</span></h1>"
        f'<p class="soft">{escape(told)}</p><nav aria-label="Sections"><ul>{links}</ul></nav></div>{shown}</header>'
    )


def _tiles(report: dict) -> str:
    by_key = {figure["key"]: figure for figure in report["figures"]}
    tiles = []
    for key in EDIT_TILES if report.get("edit") else TILES[report["stylized"]]:
        if figure := by_key.get(key):
            notes = [f"{name} {number(value, figure['digits'])}" for name, value in figure["reference"].items()]
            better = {"higher": "higher is better", "lower": "lower is better"}.get(figure["better"], "")
            digits = figure["digits"] if report.get("edit") else min(figure["digits"], 3)
            unit = "" if figure["unit"] == "share" else figure["unit"]
            tiles.append((figure["label"], number(figure["mean"], digits), unit, "; ".join(notes) or better))
    maker = next((made for made in reversed(report["stages"]) if made["kind"] == "field"), None)
    if maker:
        size = f"{count(maker['parameters'])} parameters" if maker["parameters"] else ""
        tiles.append((f"Time of {maker['stage'] or 'its stage'}", *clock(maker["seconds"]), size))
    items = "".join(
        f'<li><span class="value">{escape(value)} <span class="unit">{escape(unit)}</span></span>'
        f'<span class="label">{escape(label)}</span><span class="note">{escape(note)}</span></li>'
        for label, value, unit, note in tiles
    )
    return f'<ul class="tiles" aria-label="Main figures">{items}</ul>' if items else ""


def _warnings(warnings: Sequence[str]) -> str:
    if not warnings:
        return ""
    items = "".join(f"<li>{escape(text)}</li>" for text in warnings)
    return (
        '<section class="warnings" aria-labelledby="warnings-heading"><h2 id="warnings-heading">Read this first</h2>'
        f"<ul>{items}</ul></section>"
    )


def _sheet(pictures: Pictures, remarked: bool) -> str:
    rows = []
    for row in pictures.sheet:
        cells = "".join(
            f"<figure>{_image(picture)}<figcaption>{escape(picture.caption)}</figcaption></figure>"
            for picture in row.pictures
        )
        rows.append(
            f'<section class="sheet"><h3>{escape(row.heading)}</h3>'
            f'<div class="row" style="{_row_style(row.pictures)}">{cells}</div></section>'
        )
    return _legends(pictures, remarked) + "".join(rows) if rows else ""


def _row_style(pictures: Sequence[Encoded]) -> str:
    """Columns side by side, none taller than about 22 lines: portraits would fill the screen otherwise."""
    columns = len(pictures)
    aspect = max((picture.width / picture.height for picture in pictures), default=1.0)
    return f"--columns:{columns};max-width:{columns * 22 * aspect:.0f}rem"


def _legends(pictures: Pictures, remarked: bool) -> str:
    captions = {picture.caption for row in pictures.sheet for picture in row.pictures}
    legends = []
    if any(caption.startswith("error") for caption in captions):
        legends.append(("Error: 0", f"{ERROR_FULL:g} or more, mean over RGB", color_bar(ERROR_COLORS)))
    if "change" in captions:
        legends.append(("Change: 0", f"{ERROR_FULL:g} or more, mean over RGB", color_bar(ERROR_COLORS)))
    if pictures.depth_range and any("depth" in caption for caption in captions):
        near, far = pictures.depth_range
        legends.append((f"Depth: {near:.3g}", f"{far:.3g} scene units; gray: nothing", color_bar(DEPTH_COLORS)))
    items = "".join(
        f'<li>{escape(low)}<span class="bar" style="background:{bar}" role="img" aria-label="colors from low to high">'
        f"</span>{escape(high)}</li>"
        for low, high, bar in legends
    )
    if remarked:
        items += "<li>Magenta: pixels that are not finite</li>"
    return f'<ul class="legends">{items}</ul>' if items else ""


def _chart(chart: Chart) -> str:
    return (
        f'<section class="chart"><h3>{escape(chart.title)}</h3><figure>{chart.inline()}'
        f"<figcaption>{escape(chart.told)}.</figcaption></figure></section>"
    )


def _image(picture: Encoded) -> str:
    return f'<img src="{picture.uri}" width="{picture.width}" height="{picture.height}" alt="{escape(picture.alt)}">'


def _notes(not_measured: Sequence[dict]) -> str:
    if not not_measured:
        return "<p>Every figure that this evaluation knows was measured.</p>"
    items = "".join(f"<dt>{escape(note['what'])}</dt><dd>{escape(note['why'])}</dd>" for note in not_measured)
    return f'<dl class="notes">{items}</dl>'


def _footer(report: dict) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in sorted(report["versions"].items()))
    told = f"Written by stylerf eval; device {report['device']}, seed {report['seed']}."
    return (
        f"<footer><p>{escape(told)} {escape(versions)}</p><p>The same figures are in report.json, the views’ values "
        "in views.csv, the charts in the folder charts, all beside this page.</p></footer>"
    )
