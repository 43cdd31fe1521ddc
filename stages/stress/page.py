"""The stress as one self-contained HTML page, and as tables for other programs."""

import base64
from collections.abc import Sequence
from pathlib import Path

from schemas.errors import BadInput
from schemas.safe_reading import read_bytes
from stages.configs.faults import FAULTS, METHODS
from stages.evaluation.metrics import Row
from stages.report.charts import Chart
from stages.report.formatting import duration, escape, number
from stages.report.stylesheet import CSS
from stages.report.tables import table
from stages.stress.baseline import Compared
from stages.stress.criteria import (
    COLOR_NEAR,
    COLOR_SHARE,
    LEAST_CHANGE,
    LEAST_CONTENT,
    LEAST_GAIN,
    LEAST_STRUCTURE,
    MOST_SPILL,
    SCORES,
)
from stages.stress.success_rates import REMEDIED, Cell, Outcome

LARGEST_PICTURE = 64 << 20  # bytes; two views of 4000 pixels a side are 50 MB at most


def cell_rows(cells: Sequence[Cell]) -> list[Row]:
    """One flat row a cell."""
    keys = ("method", "fault", "successes", "count", "rate", "median", "spread", "lowest", "seconds")
    return [
        {key: getattr(cell, key) for key in keys} | {"worst_seed": cell.worst.seed, "why": " | ".join(cell.whys)}
        for cell in cells
    ]


def run_rows(outcomes: Sequence[Outcome]) -> list[Row]:
    """One flat row a run."""
    keys = ("fault", "seed", "ok", "score", "seconds", "why")
    return [{"method": one.label, **{key: getattr(one, key) for key in keys}, **one.figures} for one in outcomes]


def build_page(
    cells: Sequence[Cell],
    chart: Chart,
    conditions: dict,
    missing: Sequence[tuple[str, str]],
    held: Compared | None,
    worst: Path,
) -> str:
    """HTML 5, UTF-8; no script, nothing fetched from elsewhere. worst: folder of the worst pictures, by cell."""
    sections = [("map", "Methods under faults", _map(chart))]
    if held is not None:
        sections.append(("baseline", "Against the baseline", _held(held)))
    sections += [
        ("cells", "Every cell", _table(cells)),
        ("worst", "Worst pictures", _pictures(cells, worst)),
        ("how", "What is asked for", _how(conditions, missing)),
    ]
    links = "".join(f'<li><a href="#{key}">{escape(heading)}</a></li>' for key, heading, _ in sections)
    body = "".join(
        f'<section id="{key}" aria-labelledby="{key}-heading"><h2 id="{key}-heading">{escape(heading)}</h2>{content}'
        "</section>"
        for key, heading, content in sections
    )
    runs = sum(cell.count for cell in cells)
    told = f"{runs} runs of {len(cells)} cells; {sum(cell.successes for cell in cells)} succeed."
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<title>Stress: {escape(str(conditions.get("work", "")))}</title><link rel="icon" href="data:,">'
        f'<style>{CSS}</style></head><body><a class="skip" href="#content">Skip to the content</a>'
        f'<header><div><h1>Stress</h1><p class="soft">{escape(told)}</p><nav aria-label="Sections"><ul>{links}</ul>'
        f'</nav></div></header><main id="content">{body}</main><footer><p>Written by stylerf stress. The same figures '
        "are in cells.csv, runs.csv and stress.json, the heat map in the folder charts, all beside this page.</p>"
        "</footer></body></html>\n"
    )


def _map(chart: Chart) -> str:
    return f'<div class="chart"><figure>{chart.inline()}<figcaption>{escape(chart.told)}.</figcaption></figure></div>'


def _held(held: Compared) -> str:
    lists = (("Worse", held.worse), ("Better", held.better), ("Not compared", held.unmatched))
    return "".join(
        f"<h3>{title}</h3>" + ("<ul>" + "".join(f"<li>{escape(one)}</li>" for one in some) + "</ul>")
        for title, some in lists
        if some
    ) or "<p>No cell is worse, none better.</p>"  # fmt: skip


def _table(cells: Sequence[Cell]) -> str:
    heads = ["Fault", "Method", "Succeed", "Score", "Median", "Spread", "Lowest", "Time", "Why runs failed"]
    rows = []
    for cell in cells:
        name, unit, digits = SCORES[METHODS[cell.method.removesuffix(REMEDIED)].family]
        numbers = "".join(
            f'<td class="number">{number(value, digits)}</td>' for value in (cell.median, cell.spread, cell.lowest)
        )
        marked = ' class="marked"' if cell.successes < cell.count else ""
        rows.append(
            f'<tr{marked}><th scope="row">{escape(cell.fault)}</th><td>{escape(cell.method)}</td>'
            f'<td class="number">{cell.successes} of {cell.count}</td>'
            f"<td>{escape(f'{name} ({unit})' if unit else name)}</td>{numbers}"
            f'<td class="number">{duration(cell.seconds)}</td><td>{escape("; ".join(cell.whys))}</td></tr>'
        )
    caption = (
        "Scores on test views without a fault; spread: standard deviation over the seeds; – : no picture came; time: "
        "of all that the runs are made of, what they share counted with each"
    )
    return table("Every cell", caption, heads, (2, 4, 5, 6, 7), rows, "dense")


def _pictures(cells: Sequence[Cell], folder: Path) -> str:
    shown = []
    for cell in cells:
        data = _png(folder, cell.worst.picture)
        if data is None:
            continue
        uri = "data:image/png;base64," + base64.b64encode(data).decode("ascii")
        words = f"{cell.method} under {cell.fault}, seed {cell.worst.seed}"
        told = "failed" if not cell.worst.ok else "the lowest score, a success"
        shown.append(
            f'<figure><img src="{uri}" alt="Photo and render: {escape(words)}">'
            f"<figcaption>{escape(words)}: {told}</figcaption></figure>"
        )
    intro = "<p>The photo (of an edit: the field before) at the left, the render at the right, of the worst view.</p>"
    return f'{intro}<div class="row" style="--columns:3">{"".join(shown)}</div>' if shown else "<p>There is none.</p>"


def _png(folder: Path, name: str) -> bytes | None:
    """The picture of that name in the folder itself; None where there is none, a link, or something else."""
    path = folder / name
    if not name or path.is_symlink():
        return None
    try:
        data = read_bytes(path, LARGEST_PICTURE)
    except (BadInput, FileNotFoundError):
        return None
    return data if data.startswith(b"\x89PNG\r\n\x1a\n") else None


def _how(conditions: dict, missing: Sequence[tuple[str, str]]) -> str:
    faults = "".join(f"<dt>{escape(one.name)}</dt><dd>{escape(one.description)}</dd>" for one in FAULTS.values())
    gaps = "".join(f"<dt>{escape(what)}</dt><dd>{escape(why)}</dd>" for what, why in missing)
    told = ", ".join(f"{key} {value}" for key, value in conditions.items() if value != "")
    return (
        f"<p>A fit succeeds where every value is finite and its test views are {LEAST_GAIN:g} dB nearer to their "
        "photos than the best picture of one color (of an object: than its own outlines in one color). A stylization "
        f"succeeds where every value is finite, its test views keep at least {LEAST_STRUCTURE:.2f} of the photos’ "
        "structure (of the variance of luma around each pixel of the photo, the share that a straight line from the "
        "render’s luma explains, rising or falling; of an object, of what its outlines in one color leave), and their "
        f"colors are at most {COLOR_SHARE:g} times as far from the painting’s as the photos’ are, or at most "
        f"{COLOR_NEAR:g}. A local edit succeeds where every value is finite, the part changes by {LEAST_CHANGE:g} dE "
        f"or more and keeps {LEAST_CONTENT:g} of SSIM with the field before, and what is around it changes by at most "
        f"{MOST_SPILL:g} of that. Faults are "
        f'in training views, never in test views.</p><p>{escape(told)}</p><dl class="notes">{faults}</dl>'
        + (f'<h3>Not run</h3><dl class="notes">{gaps}</dl>' if gaps else "")
    )
