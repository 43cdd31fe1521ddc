"""The report on a table: what `compare` writes about its runs, and table.html, table.csv, table.json by its axes."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

from schemas.atomic_write import sweeping, write_bytes, write_json
from schemas.errors import ArtifactStale, StylerfError
from schemas.work_folder import WorkFolder
from stages.comparison.contenders import Contender, contenders_of
from stages.comparison.page import COLORS, compared
from stages.comparison.runs import STYLIZATIONS, Gap, Run, runs_of
from stages.comparison.runs import fields_of as fields_of_works
from stages.evaluation.metric_definitions import BY_KEY
from stages.evaluation.metrics import Row, write_csv
from stages.farm.cells import (
    COLUMNS,
    COSTS,
    EDIT_COLUMNS,
    Cell,
    Front,
    Standing,
    better_of,
    cells_of,
    fronts_of,
    standings_of,
)
from stages.farm.jobs import EDIT, Axes, fields_of, jobs_of
from stages.farm.table import Table
from stages.report.charts import INK, SETTINGS, Chart, finish
from stages.report.contact_sheet import PICTURES_BYTES, Picture, SheetRow, encode
from stages.report.pages import number, render_page
from stylerf.environment.matplotlib_defaults import Figure as Drawing
from stylerf.environment.matplotlib_defaults import rc_context

FOLDER = "report"
MOST_ROWS = 40  # of the contact sheet


def written_report(table: Table) -> dict[str, Any]:
    """Write compare.html and table.html with their data to OUT/report; return where they are and what is missing.

    Raises:
        ArtifactStale: no scene of the table contains a field.
    """
    works = [WorkFolder(table.out / scene.name) for scene in table.scenes]
    works = [work for work in works if work.artifacts("field")]
    if not works:
        raise ArtifactStale(f"no field of this table in {table.out}; make them with: stylerf farm {table.file}")
    out = table.out / FOLDER
    compared(works, out)
    axes = fields_of(table)
    runs, _ = runs_of(works)
    # runs_of labels work folders by name, which are the scenes' names.
    known = [(run, axes[run.work, run.name]) for run in runs if (run.work, run.name) in axes]
    stylized = [(run, at) for run, at in known if run.family == STYLIZATIONS and at.method != EDIT]
    styles = _ranking(stylized, COLUMNS)
    edited = [(_of_any_seed(run, at.seed), replace(at, style="", method=at.style)) for run, at in known
              if at.method == EDIT]  # fmt: skip
    edits = _ranking(edited, EDIT_COLUMNS)
    fronts = fronts_of(styles.cells, styles.better)
    gaps = [*_fields_missing(table, known), *_values_missing(styles.cells, COLUMNS),
            *_values_missing(edits.cells, EDIT_COLUMNS)]  # fmt: skip
    with sweeping((out,)):
        sheet, unseen = _sheet(table, runs, works, axes)
        chart = _chart(fronts, styles.labels)
        write_csv(out / "table.csv", [*_rows(styles, COLUMNS), *_rows(edits, EDIT_COLUMNS)])
        content = {
            "name": table.file.name,
            "seeds": table.seeds,
            "cells": [asdict(cell) for cell in styles.cells],
            "standings": [asdict(one) for one in styles.standings],
            "fronts": {column: front.best for column, front in fronts.items()},
            "edits": {
                "cells": [asdict(cell) for cell in edits.cells],
                "standings": [asdict(one) for one in edits.standings],
            },
            "missing": [asdict(gap) for gap in (*gaps, *unseen)],
        }
        write_json(out / "table.json", content)
        page = render_page(
            "table.html",
            name=table.file.name,
            summary=f"{len(table.scenes)} scenes, {len(table.styles)} styles, {len(table.methods)} methods, "
            f"{len(table.seeds)} seeds: {len(known)} of {len(axes)} fields are finished.",
            styles=_shown(styles),
            edits=_shown(edits),
            chart=chart,
            sheet=sheet,
            gaps=[*gaps, *unseen],
        )
        write_bytes(out / "table.html", page.encode())
    return {"page": out / "table.html", "compare": out / "compare.html", "table": out / "table.csv", **content}


@dataclass(frozen=True)
class Ranking:
    """Stylizations, or edits, of a table: their cells and ranks. better, labels: by column; no better end, no rank."""

    cells: list[Cell]
    standings: list[Standing]
    better: dict[str, str]
    labels: dict[str, str]


def _of_any_seed(run: Run, seed: int) -> Run:
    """Return the run with protocols that omit the seed of the field before the edit, so that seeds agree."""
    metrics = {key: replace(one, protocol=one.protocol.replace(f"-s{seed}", "")) for key, one in run.metrics.items()}
    return replace(run, metrics=metrics)


def _ranking(placed: Sequence[tuple[Run, Axes]], columns: Sequence[str]) -> Ranking:
    runs = [run for run, _ in placed]
    cells = cells_of(placed, columns)
    better = {column: better_of(runs, column) for column in columns}
    return Ranking(cells, standings_of(cells, better), better, _labels(runs, columns))


def _labels(runs: Sequence[Run], columns: Sequence[str]) -> dict[str, str]:
    found = {key: f"{label} ({unit}, {better} is better)" for key, (label, unit, better, _) in COSTS.items()}
    for run in runs:
        for key in columns:
            if key in run.metrics:
                one = run.metrics[key]
                unit = one.unit if one.unit != "fraction" else ""
                notes = ", ".join(filter(None, (unit, one.better and f"{one.better} is better")))
                found.setdefault(key, f"{one.label} ({notes})" if notes else one.label)
    return found


def _digits(column: str) -> int:
    return COSTS[column][3] if column in COSTS else BY_KEY[column].digits


def _shown(ranking: Ranking) -> dict[str, Any]:
    """Return what the page shows of a ranking: columns with headings, ranks by method, cells as "mean ± spread"."""
    columns = [column for column in ranking.better if any(column in cell.values for cell in ranking.cells)]
    cells = [
        {
            "scene": cell.scene,
            "style": cell.style,
            "method": cell.method,
            "seeds": len(cell.seeds),
            "values": {
                column: number(value.mean, _digits(column))
                + ("" if value.spread is None else f" ± {number(value.spread, _digits(column))}")
                for column, value in cell.values.items()
            },
        }
        for cell in ranking.cells
    ]
    ranked = [column for column in columns if ranking.better[column]]
    return {
        "columns": columns,
        "heads": [ranking.labels[column] for column in columns],
        "ranked": ranked,
        "ranked_heads": [ranking.labels[column] for column in ranked],
        "methods": _methods(ranking.standings),
        "cells": cells,
    }


def _methods(standings: Sequence[Standing]) -> dict[str, dict[str, Standing]]:
    found: dict[str, dict[str, Standing]] = {}
    for one in standings:
        found.setdefault(one.method, {})[one.column] = one
    return found


def _rows(ranking: Ranking, columns: Sequence[str]) -> list[Row]:
    rows: list[Row] = []
    for cell in ranking.cells:
        row: Row = {"scene": cell.scene, "style": cell.style, "method": cell.method, "seeds": len(cell.seeds)}
        for column in columns:
            value = cell.values.get(column)
            row |= {
                column: value.mean if value else None,
                f"{column}_spread": value.spread if value else None,
                f"{column}_count": value.count if value else None,
            }
        rows.append(row)
    return rows


def _fields_missing(table: Table, known: Sequence[tuple[Run, Axes]]) -> list[Gap]:
    """Return the missing fields, scene by scene."""
    there = {(at.scene, run.name) for run, at in known}
    gaps = []
    fields = [job for job in jobs_of(table).values() if job.kind == "field" and job.rule != "deform"]
    for scene in table.scenes:
        lost = [job.name for job in fields if job.scene == scene.name and (job.scene, job.name) not in there]
        if lost:
            gaps.append(Gap(f"{scene.name}: {len(lost)} fields", f"Missing: {', '.join(lost[:8])}"
                            + (" ..." if len(lost) > 8 else "")))  # fmt: skip
    return gaps


def _values_missing(cells: Sequence[Cell], columns: Sequence[str]) -> list[Gap]:
    """Return the columns that a cell lacks, or has for some seeds only."""
    gaps = []
    for cell in cells:
        short = [column for column in columns
                 if column not in cell.values or cell.values[column].count < len(cell.seeds)]  # fmt: skip
        if short:
            name = ", ".join(filter(None, (cell.scene, cell.style, cell.method)))
            why = "Not measured for every seed, over too few pixels, or by different protocols."
            gaps.append(Gap(f"{name}: {', '.join(short)}", why))
    return gaps


def _sheet(
    table: Table, runs: Sequence[Run], works: Sequence[WorkFolder], axes: Mapping[tuple[str, str], Axes]
) -> tuple[list[SheetRow], list[Gap]]:
    """Return one row per scene and style: the photo, the style image, and each method's first seed, in one view."""
    first = table.seeds[0]
    stylized = {key for key, at in axes.items() if at.method not in ("", EDIT) and at.seed == first}
    wanted = [run for run in runs if (run.work, run.name) in stylized]
    found, gaps = contenders_of(wanted, fields_of_works(works))
    blocks: dict[tuple[str, str], list[Contender]] = {}
    for one in found:
        at = axes[one.run.work, one.run.name]
        blocks.setdefault((at.scene, at.style), []).append(one)
    pictures: list[list[Picture]] = []
    names = []
    for (scene, style), members in list(blocks.items())[:MOST_ROWS]:
        with suppress(StylerfError):
            pictures.append(_pictures(scene, style, members, axes))
            names.append(f"{scene}, {style}")
    encoded = iter(encode([one for row in pictures for one in row], PICTURES_BYTES))
    return [SheetRow(name, [next(encoded) for _ in row]) for name, row in zip(names, pictures, strict=True)], gaps


def _pictures(
    scene: str, style: str, members: Sequence[Contender], axes: Mapping[tuple[str, str], Axes]
) -> list[Picture]:
    shared = set.intersection(*({*one.views} for one in members))
    view = min(shared)
    first = members[0]
    shown = first.picture(view)
    photo = first.scene.photo(view, shown.shape[1], shown.shape[0])
    found = [
        Picture(photo.image, "photo", f"A photo of {scene}").small(),
        Picture(first.style_image(), style, f"The style image {style}").small(),
    ]
    for one in members:
        method = axes[one.run.work, one.run.name].method
        found.append(Picture(one.picture(view), method, f"{scene} in the style {style} by {method}").small())
    return found


def _chart(fronts: Mapping[str, Front], labels: Mapping[str, str]) -> Chart | None:
    """Chart style against each other column, one mark per method; None unless two methods have both."""
    columns = [column for column, front in fronts.items() if len(front.points) > 1]
    if not columns:
        return None
    methods = list(dict.fromkeys(method for front in fronts.values() for method in front.points))
    with rc_context(SETTINGS):
        drawing = Drawing(figsize=(3.4 * len(columns) + 0.4, 3.4), layout="constrained")
        for place, column in enumerate(columns):
            axes = drawing.add_subplot(1, len(columns), place + 1)
            for one, point in fronts[column].points.items():
                color = COLORS[methods.index(one) % len(COLORS)]
                fill = color if one in fronts[column].best else "none"
                axes.plot(*point, "o", color=color, markerfacecolor=fill, markersize=7)
                axes.annotate(one, point, xytext=(5, 4), textcoords="offset points", fontsize=8, color=INK)
            axes.margins(x=0.3, y=0.2)
            axes.set_title(labels[column].partition(" (")[0], fontsize=9.5)
            end = labels[column].removesuffix(" is better)").split()[-1].strip("(")
            axes.set_xlabel(f"relative to the mean of methods; {end} is better", fontsize=8)
            if not place:
                axes.set_ylabel("style distance, relative; lower is better", fontsize=8.5)
            axes.grid()
        words = "; ".join(f"{labels[column]}: {', '.join(fronts[column].best)}" for column in columns)
        return finish(drawing, "methods", "Style against time, structure and consistency",
                      f"Filled: on the Pareto front with style. {words}")  # fmt: skip
