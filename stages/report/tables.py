"""The tables of a page: figures with their protocols, values of each view, stages with what they cost."""

from collections.abc import Sequence

from stages.evaluation.metrics import is_number
from stages.report.formatting import count, duration, escape, megabytes, number

HELD_OUT = "Values of each held-out view; the same stand in views.csv"
TRAINING = "Values of each training view; the same stand in training.csv"
BETTER = {"higher": "higher", "lower": "lower", "": "–"}


def figures_table(figures: Sequence[dict]) -> str:
    """One row a figure: mean, spread, what it is compared with, number of views, protocol."""
    if not figures:
        return "<p>No figure could be measured; the notes below say why.</p>"
    compared = list(dict.fromkeys(name for figure in figures for name in figure["reference"]))
    others = [f"Mean of {name}" for name in compared]
    heads = ["Figure", "Mean", "Lowest", "Highest", *others, "Better", "Count", "Protocol"]
    numeric = range(1, 4 + len(compared))
    rows = []
    for figure in figures:
        digits, unit = figure["digits"], f" ({figure['unit']})" if figure["unit"] not in ("", "share") else ""
        of = f"{figure['count']}" + (f" ({figure['left_out']} left out)" if figure["left_out"] else "")
        cells = [
            f'<td class="number mean">{number(figure["mean"], digits)}</td>',
            *(f'<td class="number">{number(figure[key], digits)}</td>' for key in ("min", "max")),
            *(f'<td class="number">{number(figure["reference"].get(name), digits)}</td>' for name in compared),
            f"<td>{BETTER[figure['better']]}</td><td>{of}</td>",
            f'<td class="protocol">{escape(figure["protocol"])}</td>',
        ]
        rows.append(f'<tr><th scope="row">{escape(figure["label"] + unit)}</th>{"".join(cells)}</tr>')
    caption = "Means over views or pairs of views, with the lowest and highest value among them"
    return table("Figures with their protocols", caption, heads, numeric, rows)


def views_table(views: Sequence[dict], figures: Sequence[dict], caption: str = HELD_OUT) -> str:
    """One row a view with its measured values; views that hold values that are not finite are marked in words."""
    keys = [figure for figure in figures if any(figure["key"] in view for view in views)]
    if not views or not keys:
        return ""
    heads = ["View", *(figure["label"] for figure in keys), "Remark"]
    rows = []
    for view in views:
        cells = "".join(f'<td class="number">{number(view.get(f["key"]), f["digits"])}</td>' for f in keys)
        marked = ' class="marked"' if view.get("remark") else ""
        rows.append(
            f'<tr{marked}><th scope="row">{escape(str(view["name"]))}</th>{cells}'
            f"<td>{escape(str(view.get('remark') or ''))}</td></tr>"
        )
    return table(caption.partition(";")[0], caption, heads, range(1, 1 + len(keys)), rows, "dense")


def stages_table(stages: Sequence[dict]) -> str:
    """One row an artifact upstream: seconds, peak memory, parameters, bytes."""
    if not stages:
        return ""
    heads = ["Artifact", "Made by", "Time", "Peak memory", "Parameters", "On disk", "Device", "Remark"]
    rows = []
    for made in stages:
        cells = (
            f"<td>{escape(made['stage'] or '–')}</td>"
            f'<td class="number">{duration(made["seconds"])}</td>'
            f'<td class="number">{megabytes(made["peak_memory_mb"])}</td>'
            f'<td class="number">{count(made["parameters"])}</td>'
            f'<td class="number">{megabytes(made["bytes"], 1e6)}</td>'
            f"<td>{escape(made['device'] or '–')}</td><td>{escape(made['remark'])}</td>"
        )
        marked = ' class="marked"' if made["remark"] else ""
        rows.append(f'<tr{marked}><th scope="row">{escape(made["kind"])} {escape(made["name"])}</th>{cells}</tr>')
    known = [made["seconds"] for made in stages if is_number(made["seconds"])]
    rows.append(
        f'<tr><th scope="row">All together</th><td></td><td class="number mean">{duration(sum(known))}</td>'
        '<td colspan="5"></td></tr>'
    )
    caption = "Every stage that led here, sources first; wall time of all its runs, greatest memory of its process"
    return table("Stages with their cost", caption, heads, range(2, 6), rows)


def table(label: str, caption: str, heads: Sequence[str], numeric: range, rows: Sequence[str], look: str = "") -> str:
    """A table in a region that a keyboard can scroll sideways."""
    head = "".join(
        f'<th scope="col"{" class=number" if i in numeric else ""}>{escape(text)}</th>' for i, text in enumerate(heads)
    )
    return (
        f'<div class="wide" role="region" tabindex="0" aria-label="{escape(label)}"><table class="{look}">'
        f"<caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )
