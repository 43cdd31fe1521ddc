"""Write the result tables and charts of README.md and docs/ from benchmarks/results.

Usage: `python -m benchmarks.readme [--check]`; with --check, nothing is written and stale files give exit code 1.
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
WITHIN_DB, WITHIN = 0.5, 0.03  # for scores of fits, and of everything else: the tolerance of a stress baseline


def result(name: str) -> dict:
    return json.loads((RESULTS / name).read_text())


def where(report: dict) -> str:
    """Machine, date, command and seeds of a report, in one line."""
    cores = report["machine"]["cores"]
    note = f" Note: {report['remark']}." if "remark" in report else ""
    seeds = int(report.get("conditions", {}).get("seeds", 1))
    seeds_text = f"{seeds} seeds" if seeds > 1 else "one seed"
    gpu = report["machine"].get("gpu", "no GPU")
    return f"{cores} CPU cores, {gpu}, {report['date']}; `{report['command']}`; {seeds_text}.{note}"


def summary() -> str:
    """Markdown of the fits, one row per scene: the table in README."""
    report = result("fit.json")
    lines = [
        "| scene | PSNR, 60 s | PSNR, 300 s | SSIM, 300 s | parameters | peak memory |",
        "|---|---|---|---|---|---|",
    ]
    for scene in dict.fromkeys(row["scene"] for row in report["rows"]):
        short, long = (
            next(row for row in report["rows"] if (row["scene"], row["budget"]) == (scene, budget))
            for budget in ("60s", "300s")
        )
        lines.append(
            f"| {scene} | {short['psnr']:.2f} dB | {long['psnr']:.2f} dB | {long['ssim']:.3f} "
            f"| {long['parameters'] / 1e6:.2f} M | {long['peak_memory_mb'] / 1000:.1f} GB |"
        )
    measured = f"Test views, {report['machine']['cores']} CPU cores, no GPU, one seed, {report['date']}."
    return "\n".join([*lines, "", measured])


def fits() -> str:
    """Markdown of the fits."""
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
    chart = "![PSNR and SSIM against seconds of training; objects dashed, captures solid](images/fit.svg)"
    return "\n".join([*lines, "", chart, "", where(report)])


def on_gpu() -> str:
    """Markdown of measurements on a GPU: fits, a stylization, rendering."""
    report = result("gpu.json")
    lines = [
        "| run | training | whole stage | steps | held-out PSNR | SSIM | GPU memory |",
        "|---|---|---|---|---|---|---|",
    ]
    fits = [("lego 800x800", row) for row in report["lego"]["rows"]] + [("fern 1008x756", report["fern"])]
    for name, row in [*fits, ("arf on that fern", report["arf"])]:
        quality = f"{row['psnr']:.2f} dB | {row['ssim']:.3f}" if "psnr" in row else "– | –"
        memory = f"{row['gpu_memory_mb'] / 1000:.1f} GB" if row["gpu_memory_mb"] else "–"
        lines.append(
            f"| {name} | {row['train_seconds']:.0f} s | {row['wall_seconds']:.0f} s | {row['steps']} | {quality} "
            f"| {memory} |"
        )
    frames = [
        f"{scene.capitalize()} {made['width']}x{made['height']} renders at {made['frames_per_s']:.0f} views a second "
        f"({made['mrays_per_s']:.0f} million rays)"
        for scene, made in report["render"].items()
    ]
    rendering = f"{'. '.join(frames)}. The times of each kernel are in `benchmarks/results/gpu.json`."
    return "\n".join([*lines, "", rendering, "", where(report)])


def splats() -> str:
    """Markdown of exported splats compared with their fields."""
    report = result("splats.json")
    lines = [
        "| field | splats | steps | splats to field | splats to photos | field to photos |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        names = ("psnr_to_photos", "field_psnr_to_photos")
        to_photos = [f"{row[name]:.2f} dB" if name in row else "–" for name in names]
        lines.append(
            f"| {row['work']}, {row['field']} | {row['splats']:,} | {row['steps']} | {row['psnr_to_field']:.2f} dB "
            f"| {to_photos[0]} | {to_photos[1]} |"
        )
    return "\n".join([*lines, "", where(report)])


def tensorf() -> str:
    """Markdown of the training time to reach a quality, for ours and TensoRF; empty if not measured."""
    if not (RESULTS / "tensorf.json").is_file():
        return ""
    report = result("tensorf.json")
    own = report["rows"][0]
    qualities = [int(key.split("_")[2]) for key in own if key.startswith("seconds_to_")]
    lines = [
        f"| code | schedule | {' | '.join(f'to {quality} dB' for quality in qualities)} | final | peak memory |",
        "|---|---|" + "---|" * (len(qualities) + 2),
    ]
    for row in report["rows"]:
        cells = [_time_beside(row, own, f"seconds_to_{quality}_db") for quality in qualities]
        lines.append(
            f"| {row['code']} | {row['schedule']} | {' | '.join(cells)} "
            f"| {row['last_psnr']:.2f} dB, {row['last_seconds']:.0f} s | {row['peak_memory_mb'] / 1000:.1f} GB |"
        )
    chart = "![PSNR against seconds of training](images/tensorf.svg)"
    views = "PSNR is the mean over all test views for stylerf, over a few evenly spaced ones for TensoRF. "
    return "\n".join([chart, "", *lines, "", "Lego at 200x200. " + views + where(report)])


def _time_beside(row: dict, own: dict, key: str) -> str:
    """Seconds and the ratio to ours; a lower bound if the run ended before."""
    seconds, reached = row[key], row[key] is not None
    seconds = seconds if reached else row["last_seconds"]
    ratio = f" ({seconds / own[key]:.0f}x)" if row is not own and own[key] else ""
    return f"{'' if reached else 'over '}{seconds:.0f} s{ratio}"


def strategies() -> str:
    """Markdown of the ray strategies, speedups relative to `full`."""
    report = result("strategies.json")
    full = report["rows"][0]
    lines = [
        "| rays with gradients | step | in the field | field memory | style, equal steps "
        "| style, equal time | content, equal time |",
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
            "![Style distance against the field's seconds a step](images/strategies.svg)",
            "",
            *lines,
            "",
            f"{report['scene']}, {report['method']}; equal time is that of {steps} steps of `full`. Distances on "
            "held-out views; lower is better. " + where(report),
        ]
    )


def edits() -> str:
    """Markdown of the local edits, with the published times in the last row."""
    report = result("edits.json")
    lines = [
        "| edit | extract | learn | distill | finetune | total | background MSE (before) | change inside "
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
    """Markdown of a region recolored by two methods; empty if not measured."""
    if not (RESULTS / "palettes.json").is_file():
        return ""
    report = result("palettes.json")
    lines = ["| region, blue | method | time | background MSE (before) | change inside | bleeding | colors, L_sp |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    lines += [f"{_region_cells(row)} {row['colors']}, {row['sparsity']:.2f} |" for row in report["rows"]]
    over = "L_sp: over the region's pixels for LAENeRF, over all pixels of the scene for PaletteNeRF. "
    return "\n".join([*lines, "", over + where(report)])


def parts() -> str:
    """Markdown of a region stylized by two methods; empty if not measured."""
    if not (RESULTS / "parts.json").is_file():
        return ""
    report = result("parts.json")
    lines = ["| region, stylized | method | time | background MSE (before) | change inside | bleeding |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    return "\n".join([*lines, *map(_region_cells, report["rows"]), "", where(report)])


def _region_cells(row: dict) -> str:
    """Cells that describe one method on one region."""
    before = row["background_mse"] / row["background_ratio"]
    return (
        f"| {row['case']} | {row['method']} | {row['seconds']:.0f} s | {row['background_mse']:.5f} ({before:.5f}) "
        f"| {row['change_lab']:.0f} dE | {row['bleeding']:.4f} |"
    )


def pareto() -> str:
    """The chart of methods, rays and capacities, and failed runs; empty if not measured."""
    if not (RESULTS / "pareto.json").is_file():
        return ""
    report = result("pareto.json")
    lines = [
        "![Quality against seconds, one column per scene, area by parameters](images/pareto.svg)",
        "",
        f"Filled: on the Pareto front of quality and time. Style image: {report['painting']}. " + where(report),
    ]
    lines += [f"Failed: {row['scene']} {row['name']}: {row['failed']}" for row in report["failed"]]
    return "\n".join(lines)


def capacities() -> str:
    """Markdown of the capacity search against fixed sizes; empty if not measured."""
    if not (RESULTS / "capacity.json").is_file():
        return ""
    report = result("capacity.json")
    lines = [
        "| scene | capacity search | parameters | best fixed size | parameters | search against fixed |",
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
            f"| {grown['psnr'] - best['psnr']:+.2f} dB at {share:.2f} times the size |"
        )
    chart = "![Held-out PSNR against parameters, one panel per scene](images/capacity.svg)"
    return "\n".join([chart, "", *lines, "", where(report)])


def kinds() -> str:
    """Markdown of field kinds at equal time; empty if not measured."""
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
    """Markdown of the ablations on captures; empty if not measured."""
    if not (RESULTS / "captures.json").is_file():
        return ""
    report = result("captures.json")
    lines = [
        "| scene | ablation | held-out PSNR | SSIM | samples a ray over 0.01 | occupied cells "
        "| pixels nearer than a third of the median depth |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        ablation = row["measure"] + (f" (`{row['flags']}`)" if row["flags"] else "")
        cells = [row["scene"], ablation, f"{row['psnr']:.2f} dB", f"{row['ssim']:.3f}"]
        cells += [f"{row['heavy']:.1f}", f"{row['occupied']:.0f} %", f"{row['near']:.2f} %"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", where(report)])


def profile() -> str:
    """Markdown of kernel times and their memory bounds by capacity, and the speedup by threads."""
    if not (RESULTS / "profile.json").is_file():
        return ""
    report = result("profile.json")
    most = max(row["threads"] for row in report["rows"])
    rows = [row for row in report["rows"] if row["threads"] == most]
    alone = {row["capacity"]: row for row in report["rows"] if row["threads"] == 1}
    names = sorted(rows[-1]["kernels_ms"], key=lambda name: -rows[-1]["kernels_ms"][name])
    heads = [f"{row['capacity']}, {row['parameters'] / 1e6:.1f} M" for row in rows]
    lines = [f"| ms per step (times its bound) | {' | '.join(heads)} | {most} threads over one |",
             "|---|" + "---|" * (len(rows) + 1)]  # fmt: skip
    for name in names:
        cells = [_beside_bound(row, name) for row in rows]
        gain = alone[rows[-1]["capacity"]]["kernels_ms"].get(name, 0.0) / max(rows[-1]["kernels_ms"][name], 1e-9)
        lines.append(f"| {name} | {' | '.join(cells)} | {gain:.2f}x |")
    gain = alone[rows[-1]["capacity"]]["step_ms"] / rows[-1]["step_ms"]
    steps = " | ".join(f"**{row['step_ms']:.1f}**" for row in rows)
    lines.append(f"| **whole step** | {steps} | **{gain:.2f}x** |")
    held = [f"{row['rays']} rays, {row['samples']} samples, {row['colored']} with color" for row in rows]
    bandwidths = ", ".join(f"{row['bandwidth_gb_s']:.1f}" for row in rows)
    return "\n".join(
        [*lines, "", f"{report['scene']}; last batches: {'; '.join(held)}. Triad bandwidth on arrays of that size: "
         f"{bandwidths} GB/s. " + where(report)]
    )  # fmt: skip


def _beside_bound(row: dict, name: str) -> str:
    ms, bound = row["kernels_ms"].get(name, 0.0), row["bounds_ms"].get(name)
    return f"{ms:.1f}" + (f" ({ms / bound:.1f}x)" if bound else "")


def looks() -> str:
    """Markdown of the cost of features and their gradient on the CPU, by layers and size; empty if not measured."""
    if not (RESULTS / "extractor.json").is_file():
        return ""
    report = result("extractor.json")
    lines = [
        "| layers | image | direct | Winograd | ratio | direct, GFLOP/s |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["looks"]:
        lines.append(
            f"| {row['layers']} | {row['size']} | {row['direct_seconds']:.2f} s | {row['winograd_seconds']:.2f} s "
            f"| {row['ratio']:.2f} | {row['direct_gflops']:.0f} |"
        )
    targets = ", ".join(f"{row['seconds']:.3f} s at {row['channels']} channels" for row in report["transport"])
    return "\n".join([*lines, "", f"Transport: {targets}. " + where(report)])


METHOD_COLUMNS = {
    "sifid": "style, SIFID",
    "judge_gram": "style, Gram",
    "edges_kept": "edges kept",
    "short_rmse": "short-range error",
    "long_rmse": "long-range error",
    "seconds": "seconds",
    "peak_memory_mb": "memory, MB",
}


def method_ranks() -> str:
    """Markdown of the methods' mean ranks, with values relative to the mean over methods; empty if not run."""
    if not (RESULTS / "methods.json").is_file():
        return ""
    report = result("methods.json")
    columns = [column for column in METHOD_COLUMNS if any(one["column"] == column for one in report["standings"])]
    lines = [
        "| method | " + " | ".join(METHOD_COLUMNS[column] for column in columns) + " |",
        "|---" * (1 + len(columns)) + "|",
    ]
    for method in dict.fromkeys(one["method"] for one in report["standings"]):
        found = {one["column"]: one for one in report["standings"] if one["method"] == method}
        values = (f"{found[c]['rank']:.1f} ({found[c]['relative']:.2f})" if c in found else "–" for c in columns)
        lines.append(f"| {method} | {' | '.join(values)} |")
    numbers = {one["column"]: one["blocks"] for one in report["standings"]}
    blocks = max(numbers.values())
    fewer = "".join(f", {METHOD_COLUMNS[c]} over {numbers[c]}" for c in columns if numbers[c] < blocks)
    hours = f"; all jobs together took {report['job_hours']} hours" if "job_hours" in report else ""
    return "\n".join([*lines, "", f"Over {blocks} pairs of a scene and a painting{fewer}{hours}. {where(report)}"])


def method_seconds() -> str:
    """Markdown of the minimum seconds for every method and scene; empty if not run."""
    if not (RESULTS / "methods.json").is_file():
        return ""
    rows = result("methods.json")["least_seconds"]
    least = {(row["method"], row["scene"]): row["seconds"] for row in rows}
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    lines = [f"| method | {' | '.join(scenes)} |", "|---" * (1 + len(scenes)) + "|"]
    for method in sorted({row["method"] for row in rows}):
        lines.append(f"| {method} | {' | '.join(f'{least[method, scene]:.0f} s' for scene in scenes)} |")
    return "\n".join(lines)


def method_cells() -> str:
    """Markdown of every scene, painting and method; empty if not run."""
    if not (RESULTS / "methods.json").is_file():
        return ""
    report = result("methods.json")
    columns = [column for column in METHOD_COLUMNS if any(column in cell["values"] for cell in report["cells"])]
    lines = [
        "| scene | painting | method | seeds | " + " | ".join(METHOD_COLUMNS[column] for column in columns) + " |",
        "|---" * (4 + len(columns)) + "|",
    ]
    for cell in sorted(report["cells"], key=lambda cell: (cell["scene"], cell["style"])):
        place = f"{cell['scene']} | {cell['style']} | {cell['method']} | {len(cell['seeds'])}"
        lines.append(f"| {place} | {' | '.join(_mean_and_spread(cell['values'].get(c)) for c in columns)} |")
    return "\n".join(lines)


def votes() -> str:
    """Markdown of blind votes, and of how often figures agree with them; empty if there are none."""
    if not (RESULTS / "votes.json").is_file():
        return ""
    report = result("votes.json")
    lines = ["| scene, painting | method | preferred | share (95 %) |", "|---|---|---|---|"]
    lines += [f"| {row['group']} | {row['contender']} | {_votes_won(row)} |" for row in report["rows"]]
    if report["matchups"]:
        lines += ["", "| method | against | preferred | share (95 %) |", "|---|---|---|---|"]
    lines += [f"| {row['contender']} | {row['against']} | {_votes_won(row)} |" for row in report["matchups"]]
    lines += ["", "| figure | agrees with the votes | share (95 %) |", "|---|---|---|"]
    lines += [f"| {one['metric']} | {_votes_won(one)} |" for one in report["agreement"]]
    return "\n".join([*lines, "", f"{report['votes']} votes. {where(report)}"])


def _votes_won(row: dict) -> str:
    """Two cells: the votes won of those decided, and their share with its interval."""
    if not row["decided"]:
        return "0 of 0 | –"
    return f"{row['won']} of {row['decided']} | {row['share']:.2f} ({row['low']:.2f} to {row['high']:.2f})"


def _mean_and_spread(value: dict | None) -> str:
    if value is None:
        return "–"
    spread = "" if value["spread"] is None else f" ± {value['spread']:.2g}"
    return f"{value['mean']:.3g}{spread}" if value["mean"] < 1000 else f"{value['mean']:.0f}{spread}"


def stress() -> str:
    """The heat map of methods under faults, and overall success rates; empty if not measured."""
    if not (RESULTS / "stress.json").is_file():
        return ""
    report = result("stress.json")
    conditions, scenes = report["conditions"], dict.fromkeys(row["work"] for row in report["rows"])
    lines = [
        "![Successful runs of each method under each fault, all scenes together](images/stress.svg)",
        "",
        f"{', '.join(scenes)} together: {successes(report['rows'])}; photos of {conditions['side']} pixels, "
        f"{budget_text(conditions['budget'])} a fit, {budget_text(conditions['style_budget'])} a stylization. "
        "Procedural scenes run once. " + where(report),
    ]
    return "\n".join(lines)


def successes(rows: list[dict]) -> str:
    """Format success rates: cells run without and with remedies, then the other cells.

    The number of seeds may differ between the two, so the percentages are means over cells.
    """
    both, alone = _by_remedies(rows)
    before, after = ([pair[side] for pair in both] for side in (0, 1))
    parts = []
    if both:
        shares = [f"{100 * sum(row['rate'] for row in some) / len(both):.0f} %" for some in (before, after)]
        parts.append(
            f"of the {len(both)} cells run both ways {_done(before)} runs succeed without remedies, {_done(after)} "
            f"with them ({' and '.join(shares)} averaged over cells)"
        )
    for remedied, words in ((False, "without"), (True, "with")):
        if some := [row for row in alone if row["method"].endswith(REMEDIED) == remedied]:
            parts.append(f"of the cells run {words} remedies alone {_done(some)} runs")
    return "; ".join(parts)


def _by_remedies(rows: list[dict]) -> tuple[list[tuple[dict, dict]], list[dict]]:
    """Return pairs of cells (work, fault, method) without and with remedies, and unpaired cells."""
    cells = {(row["work"], row["fault"], row["method"]): row for row in rows}
    pairs = {(work, fault, method): (work, fault, method + REMEDIED) for work, fault, method in cells}
    pairs = {before: after for before, after in pairs.items() if after in cells}
    lone = [row for key, row in cells.items() if key not in pairs and key not in pairs.values()]
    return [(cells[before], cells[after]) for before, after in pairs.items()], lone


def _done(rows: list[dict]) -> str:
    return f"{sum(row['successes'] for row in rows)} of {sum(row['count'] for row in rows)}"


def budget_text(budget: str) -> str:
    """Format a budget; a plain number counts steps."""
    return f"{budget} steps" if budget.isdigit() else budget


def remedies() -> str:
    """Markdown of every cell without and with remedies, by scene; empty if not measured."""
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
    left_out = f"Left out: {alike} cells with the same success rate and scores within {WITHIN_DB:g} dB or {WITHIN:g}."
    return "\n".join([*lines, "", left_out, "", where(result("stress.json"))])


def scenes_under_stress() -> str:
    """The heat maps, one panel per scene; empty if not measured."""
    if not (RESULTS / "stress.json").is_file():
        return ""
    return "![Successful runs and median scores per method and fault, one panel per scene](images/stress-scenes.svg)"


def _alike(before: dict, after: dict) -> bool:
    """Whether remedies make no difference."""
    if None in (before["median"], after["median"]) or before["rate"] != after["rate"]:
        return False
    least = WITHIN_DB if before["method"].startswith("fit") else WITHIN
    return abs(before["median"] - after["median"]) < least


def _outcome(row: dict) -> str:
    fit = row["method"].startswith("fit")
    score = "–" if row["median"] is None else f"{row['median']:.2f} dB" if fit else f"{row['median']:.3f}"
    return f"{row['successes']} of {row['count']}, {score}"


BLOCKS = {
    "README.md": {"fits": summary},
    "docs/results.md": {
        "fits": fits,
        "gpu": on_gpu,
        "splats": splats,
        "tensorf": tensorf,
        "capacities": capacities,
        "kinds": kinds,
        "captures": captures,
        "strategies": strategies,
        "pareto": pareto,
        "edits": edits,
        "palettes": palettes,
        "parts": parts,
        "stress": stress,
        "scenes": scenes_under_stress,
        "remedies": remedies,
    },
    "docs/methods-compared.md": {
        "ranks": method_ranks,
        "seconds": method_seconds,
        "cells": method_cells,
        "votes": votes,
    },
    "docs/performance.md": {"profile": profile, "looks": looks},
}
# By image name, which starts with the name of its result file.
CHARTS = {
    "fit": charts.fits_chart,
    "strategies": charts.strategies_chart,
    "capacity": charts.capacity_chart,
    "pareto": charts.pareto_chart,
    "stress": charts.stress_chart,
    "stress-scenes": charts.stress_scenes_chart,
    "tensorf": charts.tensorf_chart,
}


def main() -> int:
    stale = False
    for document, blocks in BLOCKS.items():
        path = ROOT / document
        text = wanted = path.read_text()
        for name, block in blocks.items():
            begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
            head, _, rest = wanted.partition(begin)
            _, _, tail = rest.partition(end)
            wanted = f"{head}{begin}\n{block()}\n{end}{tail}"
        stale |= wanted != text
        if "--check" not in sys.argv:
            path.write_text(wanted)
    published = ROOT / "docs" / "published.md"
    stale |= page() != published.read_text()
    if "--check" not in sys.argv:
        published.write_text(page())
    for name, chart in CHARTS.items():
        of, picture = f"{name.partition('-')[0]}.json", IMAGES / f"{name}.svg"
        if (RESULTS / of).is_file():
            report = result(of)
            stale |= not (picture.is_file() and picture.read_text().endswith(mark(report)))
            if "--check" not in sys.argv:
                picture.write_text(chart(report) + mark(report))
    return int(stale and "--check" in sys.argv)


def mark(report: dict) -> str:
    """Return the last line of a chart: a digest of its rows, to detect stale charts without drawing them."""
    return f"<!-- rows {digest_of(report['rows'])} -->\n"


if __name__ == "__main__":
    sys.exit(main())
