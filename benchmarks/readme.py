"""Write README, docs/results.md, docs/stress.md and their charts from benchmarks/results.

Use: `python -m benchmarks.readme [--check]`.
"""

import json
import sys
from pathlib import Path

from benchmarks import charts
from benchmarks.results_page import page
from schemas.canonical_json import digest_of

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
IMAGES = ROOT / "docs" / "images"
REMEDIED = " + remedies"
WITHIN_DB, WITHIN = 0.5, 0.03  # scores of fits, of all else: as much as a baseline lets pass


def result(name: str) -> dict:
    return json.loads((RESULTS / name).read_text())


def where(report: dict) -> str:
    """Machine, day and command of a report."""
    cores = report["machine"]["cores"]
    remark = f" Remark: {report['remark']}." if "remark" in report else ""
    seeds = int(report.get("conditions", {}).get("seeds", 1))
    told_seeds = f"{seeds} seeds" if seeds > 1 else "one seed"
    measured = f"{cores} CPU cores, no GPU, {report['date']}; `{report['command']}`; {told_seeds}."
    return f"{measured} Not measured on a GPU.{remark}"


def fits() -> str:
    """Markdown of the fits, with the protocol under it."""
    report = result("fit.json")
    lines = [
        "| scene | training | held-out PSNR | SSIM | parameters | grid | peak memory |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        lines.append(
            f"| {row['scene']} | {row['train_seconds']:.0f} s | {row['psnr']:.2f} dB | {row['ssim']:.3f} "
            f"| {row['parameters'] / 1e6:.2f} M | {row['resolution']}^3 | {row['peak_memory_mb'] / 1000:.1f} GB |"
        )
    return "\n".join([*lines, "", where(report)])


def tensorf() -> str:
    """Markdown of the times to a quality beside another code's; nothing where it has not been measured."""
    if not (RESULTS / "tensorf.json").is_file():
        return ""
    report = result("tensorf.json")
    own = report["rows"][0]
    qualities = [int(key.split("_")[2]) for key in own if key.startswith("seconds_to_")]
    lines = [
        f"| code | schedule | {' | '.join(f'to {quality} dB' for quality in qualities)} | at last | peak memory |",
        "|---|---|" + "---|" * (len(qualities) + 2),
    ]
    for row in report["rows"]:
        cells = [_time_beside(row, own, f"seconds_to_{quality}_db") for quality in qualities]
        lines.append(
            f"| {row['code']} | {row['schedule']} | {' | '.join(cells)} "
            f"| {row['last_psnr']:.2f} dB, {row['last_seconds']:.0f} s | {row['peak_memory_mb'] / 1000:.1f} GB |"
        )
    chart = "![PSNR against seconds of training](docs/images/tensorf.svg)"
    views = "PSNR is the mean of all test views for ours, of a few of them, evenly spread, for TensoRF. "
    return "\n".join([chart, "", *lines, "", "Lego at 200x200. " + views + where(report)])


def _time_beside(row: dict, own: dict, key: str) -> str:
    """Seconds, and how many times ours; at least so many where the run ended before."""
    seconds, reached = row[key], row[key] is not None
    seconds = seconds if reached else row["last_seconds"]
    ratio = f" ({seconds / own[key]:.0f}x)" if row is not own and own[key] else ""
    return f"{'' if reached else 'over '}{seconds:.0f} s{ratio}"


def strategies() -> str:
    """Markdown of the ray strategies: everything relative to `full`."""
    report = result("strategies.json")
    full = report["rows"][0]
    lines = [
        "| rays that learn | step | its field part | field memory | style, equal steps | style, equal time "
        "| content, equal time |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        faster = full["field_seconds"] / row["field_seconds"]
        lines.append(
            f"| {row['case']} | {row['step_seconds']:.2f} s | {row['field_seconds']:.2f} s ({faster:.1f}x) "
            f"| {row['field_memory_mb']:.0f} MB | {row['at_equal_steps']['style']:.4f} "
            f"| {row['at_equal_time']['style']:.4f} | {row['at_equal_time']['content']:.3f} |"
        )
    steps = full["steps_at_equal_time"]
    return "\n".join(
        [
            "![Style distance against the field's seconds a step](docs/images/strategies.svg)",
            "",
            *lines,
            "",
            f"{report['scene']}, {report['method']}, {steps} steps of `full` and as long for the others; "
            "distances on held-out views, lower is better. " + where(report),
        ]
    )


def edits() -> str:
    """Markdown of the local edits, with the published seconds beside ours."""
    report = result("edits.json")
    lines = [
        "| edit | extract | learn | distill | finetune | in all | background MSE (before) | change inside "
        "| colors, L_sp |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        s = row["seconds"]
        before = row["background_mse"] / row["background_ratio"]
        cells = [
            row["case"],
            *(f"{s[stage]:.0f} s" for stage in report["published_seconds"]),
            f"{row['seconds_after_selection']:.0f} s",
            f"{row['background_mse']:.5f} ({before:.5f})",
            f"{row['change_lab']:.0f} dE",
            f"{row['colors']}, {row['sparsity']:.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    p = report["published_seconds"]
    lines.append(
        f"| LAENeRF, published, on a GPU | {p['edit-dataset']} s | {p['edit']} s | {p['scene']} s | {p['field']} s "
        f"| {sum(p.values())} s | | | |"
    )
    return "\n".join([*lines, "", where(report)])


def palettes() -> str:
    """Markdown of a part recolored by two methods; nothing where it has not been measured."""
    if not (RESULTS / "palettes.json").is_file():
        return ""
    report = result("palettes.json")
    lines = ["| part, blue | method | time | background MSE (before) | change inside | bleeding | colors, L_sp |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    lines += [f"{_of_part(row)} {row['colors']}, {row['sparsity']:.2f} |" for row in report["rows"]]
    over = "L_sp: of LAENeRF over the region's pixels, of PaletteNeRF over all pixels that show the scene. "
    return "\n".join([*lines, "", over + where(report)])


def parts() -> str:
    """Markdown of a part stylized by two methods; nothing where it has not been measured."""
    if not (RESULTS / "parts.json").is_file():
        return ""
    report = result("parts.json")
    lines = ["| part, stylized | method | time | background MSE (before) | change inside | bleeding |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    return "\n".join([*lines, *map(_of_part, report["rows"]), "", where(report)])


def _of_part(row: dict) -> str:
    """What is told of a method on a part, as cells of a table."""
    before = row["background_mse"] / row["background_ratio"]
    return (
        f"| {row['case']} | {row['method']} | {row['seconds']:.0f} s | {row['background_mse']:.5f} ({before:.5f}) "
        f"| {row['change_lab']:.0f} dE | {row['bleeding']:.4f} |"
    )


def pareto() -> str:
    """The chart over methods, rays and capacities, and what failed; nothing where it has not been measured."""
    if not (RESULTS / "pareto.json").is_file():
        return ""
    report = result("pareto.json")
    lines = [
        "![Figures against seconds, parameters by area, for every scene](docs/images/pareto.svg)",
        "",
        f"Filled: on the Pareto front of accuracy and time. Painting: {report['painting']}. " + where(report),
    ]
    lines += [f"Failed: {row['scene']} {row['name']}: {row['failed']}" for row in report["failed"]]
    return "\n".join(lines)


def capacities() -> str:
    """Markdown of fits grown and of fixed sizes; nothing where it has not been measured."""
    if not (RESULTS / "capacity.json").is_file():
        return ""
    report = result("capacity.json")
    lines = [
        "| scene | grown | parameters | best fixed size | parameters | grown against it |",
        "|---|---|---|---|---|---|",
    ]
    for scene in dict.fromkeys(row["scene"] for row in report["rows"]):
        rows = [row for row in report["rows"] if row["scene"] == scene]
        grown, best = (
            max((row for row in rows if (row["capacity"] == "grow") == so), key=lambda row: row["psnr"])
            for so in (True, False)
        )
        share = grown["parameters"] / best["parameters"]
        lines.append(
            f"| {scene} | {grown['psnr']:.2f} dB | {grown['parameters'] / 1e6:.2f} M "
            f"| {best['psnr']:.2f} dB, {best['capacity']} | {best['parameters'] / 1e6:.2f} M "
            f"| {grown['psnr'] - best['psnr']:+.2f} dB, {share:.2f} times the size |"
        )
    chart = "![Held-out PSNR against parameters, for every scene](docs/images/capacity.svg)"
    return "\n".join([chart, "", *lines, "", where(report)])


def kinds() -> str:
    """Markdown of kinds of fields at equal time; nothing where it has not been measured."""
    if not (RESULTS / "kinds.json").is_file():
        return ""
    report = result("kinds.json")
    lines = [
        "| scene | kind | held-out PSNR | SSIM | parameters | steps | peak memory | rendering |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        lines.append(
            f"| {row['scene']} | {row['kind']} | {row['psnr']:.2f} dB | {row['ssim']:.3f} "
            f"| {row['parameters'] / 1e6:.2f} M | {row['steps']} | {row['peak_memory_mb'] / 1000:.1f} GB "
            f"| {row['mrays_a_second']:.2f} Mrays/s |"
        )
    return "\n".join([*lines, "", where(report)])


def captures() -> str:
    """Markdown of what captures gain by what is done for them; nothing where it has not been measured."""
    if not (RESULTS / "captures.json").is_file():
        return ""
    report = result("captures.json")
    lines = [
        "| scene | fitted | held-out PSNR | SSIM | test pixels nearer than a third of the median depth |",
        "|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        told = row["measure"] + (f" (`{row['flags']}`)" if row["flags"] else "")
        lines.append(f"| {row['scene']} | {told} | {row['psnr']:.2f} dB | {row['ssim']:.3f} | {row['near']:.2f} % |")
    return "\n".join([*lines, "", where(report)])


def profile() -> str:
    """Markdown of a step's kernels beside their bounds, by capacity, on all threads; then what threads bring."""
    if not (RESULTS / "profile.json").is_file():
        return ""
    report = result("profile.json")
    most = max(row["threads"] for row in report["rows"])
    rows = [row for row in report["rows"] if row["threads"] == most]
    alone = {row["capacity"]: row for row in report["rows"] if row["threads"] == 1}
    names = sorted(rows[-1]["kernels_ms"], key=lambda name: -rows[-1]["kernels_ms"][name])
    heads = [f"{row['capacity']}, {row['parameters'] / 1e6:.1f} M" for row in rows]
    lines = [f"| ms a step (times its bound) | {' | '.join(heads)} | {most} threads against one |",
             "|---|" + "---|" * (len(rows) + 1)]  # fmt: skip
    for name in names:
        cells = [_beside_bound(row, name) for row in rows]
        gain = alone[rows[-1]["capacity"]]["kernels_ms"].get(name, 0.0) / max(rows[-1]["kernels_ms"][name], 1e-9)
        lines.append(f"| {name} | {' | '.join(cells)} | {gain:.2f}x |")
    gain = alone[rows[-1]["capacity"]]["step_ms"] / rows[-1]["step_ms"]
    steps = " | ".join(f"**{row['step_ms']:.1f}**" for row in rows)
    lines.append(f"| **a step** | {steps} | **{gain:.2f}x** |")
    held = [f"{row['rays']} rays, {row['samples']} samples, {row['colored']} of them colored" for row in rows]
    bandwidths = ", ".join(f"{row['bandwidth_gb_s']:.1f}" for row in rows)
    return "\n".join(
        [*lines, "", f"{report['scene']}; the last batches held {'; '.join(held)}. Triads as long: {bandwidths} GB/s. "
         + where(report)]
    )  # fmt: skip


def _beside_bound(row: dict, name: str) -> str:
    ms, bound = row["kernels_ms"].get(name, 0.0), row["bounds_ms"].get(name)
    return f"{ms:.1f}" + (f" ({ms / bound:.1f}x)" if bound else "")


def stress() -> str:
    """The heat map of methods under faults; nothing where it has not been measured."""
    if not (RESULTS / "stress.json").is_file():
        return ""
    report = result("stress.json")
    asked, scenes = report["conditions"], dict.fromkeys(row["work"] for row in report["rows"])
    lines = [
        "![Runs that succeed, of methods under faults, all scenes together](docs/images/stress.svg)",
        "",
        f"{', '.join(scenes)} together: {successes(report['rows'])}; photos of {asked['side']} pixels, "
        f"{told(asked['budget'])} a fit, {told(asked['style_budget'])} a stylization. Made scenes once. "
        + where(report),
    ]
    return "\n".join(lines)


def successes(rows: list[dict]) -> str:
    """How many runs succeed, in words: without and with remedies over the cells that have both, apart from all others.

    Counts of seeds may differ between the two, so that their shares are means over cells.
    """
    both, alone = _by_remedies(rows)
    before, after = ([pair[side] for pair in both] for side in (0, 1))
    told = []
    if both:
        shares = [f"{100 * sum(row['rate'] for row in some) / len(both):.0f} %" for some in (before, after)]
        told.append(
            f"of the {len(both)} cells run both ways {_done(before)} runs succeed without remedies, {_done(after)} "
            f"with them ({' and '.join(shares)} in the mean of the cells)"
        )
    for remedied, words in ((False, "without"), (True, "with")):
        if some := [row for row in alone if row["method"].endswith(REMEDIED) == remedied]:
            told.append(f"of the cells run {words} remedies alone {_done(some)} runs")
    return "; ".join(told)


def _by_remedies(rows: list[dict]) -> tuple[list[tuple[dict, dict]], list[dict]]:
    """Cells (work, fault, method) without and with remedies, in pairs; those of which there is one alone."""
    cells = {(row["work"], row["fault"], row["method"]): row for row in rows}
    pairs = {(work, fault, method): (work, fault, method + REMEDIED) for work, fault, method in cells}
    pairs = {before: after for before, after in pairs.items() if after in cells}
    lone = [row for key, row in cells.items() if key not in pairs and key not in pairs.values()]
    return [(cells[before], cells[after]) for before, after in pairs.items()], lone


def _done(rows: list[dict]) -> str:
    return f"{sum(row['successes'] for row in rows)} of {sum(row['count'] for row in rows)}"


def told(budget: str) -> str:
    """A budget in words: a plain number is one of steps."""
    return f"{budget} steps" if budget.isdigit() else budget


def remedies() -> str:
    """Markdown of every cell before and after, by scene; nothing where it has not been measured."""
    if not (RESULTS / "stress.json").is_file():
        return ""
    lines = ["| scene | fault | method | without remedies | with them |", "|---|---|---|---|---|"]
    alike = 0
    for row, after in _by_remedies(result("stress.json")["rows"])[0]:
        if _alike(row, after):
            alike += 1
            continue
        cell = f"{row['work']} | {row['fault']} | {row['method']}"
        lines.append(f"| {cell} | {_outcome(row)} | {_outcome(after)} |")
    if len(lines) == 2 and not alike:
        return ""
    left_out = (
        f"Left out: {alike} cells that succeed as often and whose scores are within {WITHIN_DB:g} dB or {WITHIN:g} of "
        "one another."
    )
    return "\n".join([*lines, "", left_out, "", where(result("stress.json"))])


def scenes_under_stress() -> str:
    """The heat map of every scene; nothing where it has not been measured."""
    if not (RESULTS / "stress.json").is_file():
        return ""
    return "![Runs that succeed and their scores, of methods under faults, a panel a scene](images/stress-scenes.svg)"


def _alike(before: dict, after: dict) -> bool:
    """Whether remedies change next to nothing."""
    if None in (before["median"], after["median"]) or before["rate"] != after["rate"]:
        return False
    least = WITHIN_DB if before["method"].startswith("fit") else WITHIN
    return abs(before["median"] - after["median"]) < least


def _outcome(row: dict) -> str:
    fit = row["method"].startswith("fit")
    score = "–" if row["median"] is None else f"{row['median']:.2f} dB" if fit else f"{row['median']:.3f}"
    return f"{row['successes']} of {row['count']}, {score}"


BLOCKS = {
    "README.md": {
        "figures": fits,
        "tensorf": tensorf,
        "capacities": capacities,
        "strategies": strategies,
        "edits": edits,
        "palettes": palettes,
        "parts": parts,
        "pareto": pareto,
        "stress": stress,
    },
    "docs/stress.md": {"scenes": scenes_under_stress, "remedies": remedies},
    "docs/profile.md": {"profile": profile},
    "docs/captures.md": {"captures": captures},
    "docs/fields.md": {"kinds": kinds},
}
# By name of the picture, which begins with that of its result.
CHARTS = {
    "strategies": charts.strategies_chart,
    "capacity": charts.capacity_chart,
    "pareto": charts.pareto_chart,
    "stress": charts.stress_chart,
    "stress-scenes": charts.stress_scenes_chart,
    "tensorf": charts.tensorf_chart,
}


def main() -> int:
    stale = False
    for paper, blocks in BLOCKS.items():
        path = ROOT / paper
        text = wanted = path.read_text()
        for name, block in blocks.items():
            begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
            head, _, rest = wanted.partition(begin)
            _, _, tail = rest.partition(end)
            wanted = f"{head}{begin}\n{block()}\n{end}{tail}"
        stale |= wanted != text
        if "--check" not in sys.argv:
            path.write_text(wanted)
    results = ROOT / "docs" / "results.md"
    stale |= page() != results.read_text()
    if "--check" not in sys.argv:
        results.write_text(page())
    for name, chart in CHARTS.items():
        of, picture = f"{name.partition('-')[0]}.json", IMAGES / f"{name}.svg"
        if (RESULTS / of).is_file():
            report = result(of)
            stale |= not (picture.is_file() and picture.read_text().endswith(mark(report)))
            if "--check" not in sys.argv:
                picture.write_text(chart(report) + mark(report))
    return int(stale and "--check" in sys.argv)


def mark(report: dict) -> str:
    """The end of a chart: tells the rows that it was drawn of, so that one of other rows is seen without drawing."""
    return f"<!-- rows {digest_of(report['rows'])} -->\n"


if __name__ == "__main__":
    sys.exit(main())
