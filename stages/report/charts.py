"""Charts of an evaluation, each as SVG and PNG; the SVG inlined in a page takes the page's text color."""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

from schemas.safe_names import printable
from stages.report.formatting import escape
from stylerf.environment.matplotlib_defaults import Figure as Drawing
from stylerf.environment.matplotlib_defaults import FigureCanvasAgg, MaxNLocator, rc_context

INK = "#24292f"  # text and axes; becomes the page's own color when inlined
BLUE, ORANGE = "#3d85c6", "#d9822b"  # both read on white and on near-black
LINES = {"held out": "-", "trained on": "--"}  # a fit's views kept aside, until they are trained on too, and from then
SETTINGS = {
    "svg.fonttype": "none",  # text stays text: selectable, small, and in the page's own font
    "svg.hashsalt": "stylerf",  # the same chart gives the same bytes
    "text.parse_math": False,  # names may hold dollar signs
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
    """A finished chart. `told` says in words what it shows, for who cannot see it."""

    name: str
    title: str
    told: str
    svg: str
    png: bytes

    def inline(self) -> str:
        """The SVG for an HTML page: no XML head, no metadata, ids of its own, text in the color around it."""
        svg = self.svg[self.svg.index("<svg") :]
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
        svg = re.sub(r' xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href").replace(INK, "currentColor")
        svg = re.sub(r'\bid="', f'id="{self.name}-', svg)
        svg = re.sub(r'(url\(|href=")#', rf"\1#{self.name}-", svg)
        head, rest = svg.split(">", 1)
        head = re.sub(r' (width|height)="[^"]*"', "", head)
        title = f"{self.name}-title"
        return f'{head} role="img" aria-labelledby="{title}"><title id="{title}">{escape(self.told)}</title>{rest}'


def bar_chart(name: str, title: str, unit: str, labels: Sequence[str], values: Sequence[float | None]) -> Chart:
    """One bar a view, in the given order, from zero; a dashed line at the mean. None shows as a cross."""
    known = [value for value in values if value is not None]
    mean = sum(known) / len(known)
    worst, best = min(known), max(known)
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
                    axes.text(i, 0, "  not measured", ha="center", va="bottom", rotation=90, fontsize=8)
                else:
                    axes.annotate(f"{value:.3g}", (i, 0), xytext=(0, 4), textcoords="offset points", ha="center",
                                  va="bottom", fontsize=8, color="white")  # fmt: skip
        step = max(1, -(-len(values) // 30))
        long = max(len(label) for label in labels) * len(labels) / step > 90
        axes.set_xticks(list(places)[::step], list(labels)[::step], rotation=90 if long else 0, fontsize=8)
        axes.set_ylabel(f"{title} ({unit})" if unit else title)
        axes.set_axisbelow(True)
        axes.grid(axis="y")
        told = f"{title} of {len(known)} views: from {worst:.4g} to {best:.4g}, mean {mean:.4g} {unit}".strip()
        return finished(drawing, name, f"{title}, view by view", told)


def curve_chart(name: str, title: str, curve: Sequence[dict]) -> Chart:
    """PSNR of the views that a fit looks at against its seconds and, where recorded, parameters below it.

    curve: [{seconds, psnr, held_out, parameters (optional)}], in order of time. What is trained on by then is dashed,
    and never joined to what is held out.
    """
    seconds = [point["seconds"] for point in curve]
    kinds = {label: [point for point in curve if point["held_out"] == (label == "held out")] for label in LINES}
    kinds = {label: points for label, points in kinds.items() if points}
    sized = all(isinstance(point.get("parameters"), (int, float)) for point in curve)
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(8, 4.2 if sized else 3.2), layout="constrained")
        grid = drawing.add_gridspec(2 if sized else 1, 1, height_ratios=[3, 1] if sized else None)
        upper = drawing.add_subplot(grid[0])
        for label, points in kinds.items():
            places = [point["seconds"] for point in points], [point["psnr"] for point in points]
            fill = BLUE if label == "held out" else "none"
            upper.plot(*places, LINES[label] + "o", color=BLUE, markerfacecolor=fill, markersize=3.5, label=label)
        leading, points = next(iter(kinds.items()))
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
        told = [f"{label} {_ends(points)}" for label, points in kinds.items()]
        return finished(drawing, name, title, f"PSNR against seconds of views {'; of views '.join(told)}")


def _ends(points: Sequence[dict]) -> str:
    told = [f"{point['psnr']:.2f} dB at {point['seconds']:.0f} s" for point in points]
    return " to ".join(dict.fromkeys((told[0], told[-1])))


def pairs_chart(name: str, title: str, series: dict[str, Sequence[tuple[float, float]]]) -> Chart:
    """Lines of (frame, value) for each name, at most two, on one axis from zero."""
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(8, 3), layout="constrained")
        axes = drawing.add_subplot()
        told = []
        for (label, points), color, marker in zip(series.items(), (BLUE, ORANGE), "os"):
            axes.plot(*zip(*points), "-" + marker, color=color, markersize=3.5, label=label)
            told.append(f"{label}: up to {max(value for _, value in points):.3g}")
        axes.set_xlabel("frame")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylabel(title)
        axes.set_ylim(bottom=0)
        axes.grid()
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.18), ncols=2)
        return finished(drawing, name, title, f"{title} along the path. {'; '.join(told)}")


def finished(drawing: Drawing, name: str, title: str, told: str) -> Chart:
    """The drawing as a chart; made within `matplotlib.rc_context(SETTINGS)`."""
    FigureCanvasAgg(drawing)
    text, picture = io.StringIO(), io.BytesIO()
    drawing.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    drawing.savefig(picture, format="png", dpi=144, facecolor="white", metadata={"Software": None})
    # Of control characters in a name XML takes none.
    svg = "".join(letter if letter in "\n\t" else printable(letter) for letter in text.getvalue())
    return Chart(name, title, told, svg, picture.getvalue())
