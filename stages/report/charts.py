"""Charts as SVG and PNG; inlined in a page, the SVG takes the page's text color."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from schemas.safe_names import printable
from stages.evaluation.metrics import Row, number_in
from stages.report.pages import escape
from stylerf.environment.matplotlib_defaults import Figure as Drawing
from stylerf.environment.matplotlib_defaults import FigureCanvasAgg, MaxNLocator, rc_context

INK = "#24292f"  # text and axes; becomes the page's own color when inlined
BLUE, ORANGE = "#3d85c6", "#d9822b"  # legible on white and on near-black
LINES = {"held out": "-", "trained on": "--"}  # late in a fit, its validation views join the training views
SETTINGS: dict[Any, Any] = {  # the type of matplotlib's keys is newer than the oldest version supported
    "svg.fonttype": "none",  # text stays text: selectable, small, and in the page's own font
    "svg.hashsalt": "stylerf",  # the same chart gives the same bytes
    "text.parse_math": False,  # names may contain dollar signs
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": "#888888",
    "grid.alpha": 0.3,
    "legend.frameon": False,
}


@dataclass(frozen=True)
class Chart:
    """A finished chart. description: its content, as the text alternative."""

    name: str
    title: str
    description: str
    svg: str
    png: bytes

    def inline(self) -> Markup:
        """The SVG for an HTML page: no XML head or metadata, unique ids, text in the surrounding color."""
        svg = self.svg[self.svg.index("<svg") :]
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
        svg = re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href").replace(INK, "currentColor")
        svg = re.sub(r'\bid="', f'id="{self.name}-', svg)
        svg = re.sub(r'(url\(|href=")#', rf"\1#{self.name}-", svg)
        head, rest = svg.split(">", 1)
        inches = float(head.partition(' width="')[2].partition("pt")[0]) / 72
        head = re.sub(r' (width|height)="[^"]*"', "", head) + f' style="--inches:{inches:g}"'
        title = f"{self.name}-title"
        label = f'role="img" aria-labelledby="{title}"><title id="{title}">{escape(self.description)}</title>'
        return Markup(f"{head} {label}{rest}")


def bar_chart(name: str, title: str, unit: str, labels: Sequence[str], values: Sequence[float | None]) -> Chart:
    """One bar per view, in the given order, and a dashed line at the mean; None is drawn as a cross."""
    known = [value for value in values if value is not None]
    mean = sum(known) / len(known)
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(8, 3.2), layout="constrained")
        axes = drawing.add_subplot()
        places = range(len(values))
        axes.bar(places, [value or 0 for value in values], color=BLUE, width=0.75)
        missing = [i for i, value in enumerate(values) if value is None]
        if missing:  # an empty line would still widen the layout
            axes.plot(missing, [0] * len(missing), "x", color=ORANGE, clip_on=False, markersize=8)
        axes.axhline(mean, color=ORANGE, linestyle="--", linewidth=1.5, label=f"mean {mean:.4g}")
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1))
        if len(values) <= 16:
            for i, value in enumerate(values):
                if value is None:
                    axes.annotate("not measured", (i, 0), xytext=(0, 10), textcoords="offset points", ha="center",
                                  va="bottom", rotation=90, fontsize=8)  # fmt: skip
                else:
                    axes.annotate(f"{value:.3g}", (i, 0), xytext=(0, 4), textcoords="offset points", ha="center",
                                  va="bottom", fontsize=8, color="white")  # fmt: skip
        step = max(1, -(-len(values) // 30))
        long = max(len(label) for label in labels) * len(labels) / step > 90
        axes.set_xticks(list(places)[::step], list(labels)[::step], rotation=90 if long else 0, fontsize=8)
        axes.set_ylabel(f"{title} ({unit})" if unit else title)
        axes.set_axisbelow(True)
        axes.grid(axis="y")
        text = f"{title} of {len(known)} views: {min(known):.4g} to {max(known):.4g}, mean {mean:.4g} {unit}".strip()
        return finish(drawing, name, f"{title} per view", text)


def curve_chart(name: str, title: str, curve: Sequence[dict]) -> Chart:
    """PSNR of a fit's validation views against seconds, with the parameter count below where recorded.

    curve: [{seconds, psnr, held_out, parameters (optional)}] in order of time. Points measured after these views joined
    the training set are a separate, dashed line.
    """
    seconds = [point["seconds"] for point in curve]
    lines = {label: [point for point in curve if point["held_out"] == (label == "held out")] for label in LINES}
    lines = {label: points for label, points in lines.items() if points}
    sized = all(isinstance(point.get("parameters"), (int, float)) for point in curve)
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(8, 4.2 if sized else 3.2), layout="constrained")
        grid = drawing.add_gridspec(2 if sized else 1, 1, height_ratios=[3, 1] if sized else None)
        upper = drawing.add_subplot(grid[0])
        for label, points in lines.items():
            places = [point["seconds"] for point in points], [point["psnr"] for point in points]
            fill = BLUE if label == "held out" else "none"
            upper.plot(*places, LINES[label] + "o", color=BLUE, markerfacecolor=fill, markersize=3.5, label=label)
        leading, points = next(iter(lines.items()))
        at = points[-1]["seconds"], points[-1]["psnr"]
        upper.annotate(f"{at[1]:.2f} dB {leading}", at, xytext=(0, 6), textcoords="offset points", ha="right")
        upper.legend(loc="lower right")
        upper.set_ylabel("PSNR (dB)")
        upper.margins(y=0.15)
        upper.grid()
        lowest = upper
        if sized:
            lowest = drawing.add_subplot(grid[1], sharex=upper)
            lowest.step(seconds, [point["parameters"] / 1e6 for point in curve], where="post", color=ORANGE)
            lowest.set_ylabel("million\nparameters")
            lowest.set_ylim(bottom=0)
            lowest.grid()
            upper.tick_params(labelbottom=False)
        lowest.set_xlabel("seconds of fitting")
        lowest.set_xlim(left=0)
        ranges = [f"of views {label}: {_ends(points)}" for label, points in lines.items()]
        return finish(drawing, name, title, f"PSNR against seconds, {'; '.join(ranges)}")


def _ends(points: Sequence[dict]) -> str:
    texts = [f"{point['psnr']:.2f} dB at {point['seconds']:.0f} s" for point in (points[0], points[-1])]
    return " to ".join(dict.fromkeys(texts))


def pairs_chart(name: str, title: str, series: Mapping[str, Sequence[tuple[float, float]]]) -> Chart:
    """At most two named lines of (frame, value), on one axis from zero."""
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(8, 3), layout="constrained")
        axes = drawing.add_subplot()
        ranges = []
        for (label, points), color, marker in zip(series.items(), (BLUE, ORANGE), "os"):
            axes.plot(*zip(*points), "-" + marker, color=color, markersize=3.5, label=label)
            ranges.append(f"{label}: up to {max(value for _, value in points):.3g}")
        axes.set_xlabel("frame")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylabel(title)
        axes.set_ylim(bottom=0)
        axes.grid()
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.18), ncols=2)
        return finish(drawing, name, title, f"{title} along the path. {'; '.join(ranges)}")


def finish(drawing: Drawing, name: str, title: str, description: str) -> Chart:
    """Export a drawing made inside `rc_context(SETTINGS)` as a chart."""
    FigureCanvasAgg(drawing)
    text, picture = io.StringIO(), io.BytesIO()
    drawing.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    drawing.savefig(picture, format="png", dpi=144, facecolor="white", metadata={"Software": None})
    # XML forbids control characters.
    svg = "".join(letter if letter in "\n\t" else printable(letter) for letter in text.getvalue())
    return Chart(name, title, description, svg, picture.getvalue())


def evaluation_charts(
    stylized: bool, rows: Sequence[Row], pairs: Sequence[Row], curve: dict | None, gap: int, style_label: str
) -> list[Chart]:
    """Draw the charts that have data: the leading metric per view, quality against time, consistency along the path."""
    charts = []
    key, title, unit = ("sifid", f"SIFID-style distance to {style_label}", "") if stylized else ("psnr", "PSNR", "dB")
    values = [number_in(row, key) for row in rows]
    if any(value is not None for value in values):
        charts.append(bar_chart(f"{key}_views", title, unit, [str(row["name"]) for row in rows], values))
    if curve:
        charts.append(curve_chart("quality_seconds", f"Quality against time: fit of {curve['of']}", curve["points"]))
    series = {}
    for label, words in (("short", "1 frame apart"), ("long", f"{gap} frames apart")):
        found = [(number_in(row, "frame"), number_in(row, f"{label}_rmse")) for row in pairs]
        points = [(frame, value) for frame, value in found if frame is not None and value is not None]
        if len(points) > 1:
            series[words] = points
    if series:
        charts.append(pairs_chart("consistency_pairs", "RMSE between warped frames", series))
    return charts
