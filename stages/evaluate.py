"""Evaluate a field on held-out views and along a camera path, with its cost; writes JSON, CSV, charts and HTML.

Roles of the inputs: `scene`, `frames` (test views), and where available `field`, `path_frames` (a camera path, for
consistency), `base_frames` (test views of the unstylized field) and `reference_frames` (test views of the field whose
renders were the references). For a local edit also `unedited_frames` and `base_field` (the field before it),
`region.<name>` for each edited region, and for its training views `train_frames` and `unedited_train_frames`.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from schemas.atomic_write import write_bytes, write_json
from schemas.canonical_json import file_sha256
from schemas.errors import UsageError
from schemas.images import read_image
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import OF_WEIGHTS
from stages.artifacts.provenance import fields_behind, is_stylized, upstream
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.local_edit import LocalEdit, palette_facts, palette_rows
from stages.evaluation.metrics import Metric, Row, is_number, summarize, write_csv
from stages.evaluation.path_consistency import PathConsistency, flows_digest
from stages.evaluation.perceptual_metrics import PerceptualMetrics, available_networks, style_file
from stages.evaluation.reference_metrics import NEAREST, References, measure_robustness, references_digest
from stages.evaluation.region_masks import masks_digest
from stages.evaluation.test_views import FrameViews, Photo, Render, SceneViews
from stages.evaluation.view_metrics import (
    ViewRow,
    measure_colors,
    measure_content,
    measure_fit,
    measure_palette,
    measure_see_through,
    measure_shape,
    measure_speckle,
    measure_style,
    nonfinite_message,
)
from stages.report.charts import evaluation_charts
from stages.report.contact_sheet import ContactSheet, Picture, chosen_views
from stages.report.evaluation_page import build_page
from stages.report.notes import Inputs, not_measured, warnings_of
from stages.run.progress import Context
from stages.run.runner import Spec, versions


def pinned(config: EvaluateConfig, field: Artifact | None = None) -> EvaluateConfig:
    """Add the digests of the files it names and of the available networks, so that changes are noticed.

    field: may name a style image too. Raises BadInput if a file is missing, or an image cannot be read.
    """
    style = style_file(config, None)
    if style is not None:
        read_image(style)
    styled = style_file(config, field) is not None
    if config.ceiling and not styled:
        raise UsageError("--ceiling needs a style image; give one with --style")
    networks = available_networks(config.perceptual != "none", styled, config.features, field)
    digests: dict[str, Any] = digests_of_files(config)
    return replace(config, **digests, networks=networks, features=config.features if styled else "")


def digests_of_files(config: EvaluateConfig) -> dict[str, str]:
    """Return the current digests of the files that options name; empty for options that name none."""
    style = style_file(config, None)
    return {
        "style_digest": "" if style is None else file_sha256(style),
        "masks_digest": masks_digest(Path(config.masks).expanduser()) if config.masks else "",
        "flow_digest": flows_digest(Path(config.flow).expanduser()) if config.flow else "",
        "reference_digest": references_digest(config.reference) if config.reference else "",
    }


SPEC = Spec(stage="evaluate", verb="eval", revision=12, writes="report", outside=digests_of_files)
STYLE_KEYS = (
    "nnfm", "gram", "judge_gram", "sifid", "palette", "palette_mean", "palette_covariance", "colorfulness",
    "color_distribution", "speckle",
)  # fmt: skip
CONTENT_KEYS = ("content_ssim", "edges_kept")


def run(inputs: dict[str, Artifact], config: EvaluateConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write report.json, views.csv, pairs.csv, training.csv, charts/ and report.html; return the means by key."""
    task = Evaluation(inputs, config, context)
    task.measure_views()
    if config.ceiling:
        task.paint_views()
    if task.path is not None:
        task.path.measure(context.progress)
    report, metrics = task.report()
    charts = evaluation_charts(
        task.stylized, task.rows, task.pairs, report["curve"], config.gap, task.perceptual.style_label
    )
    for chart in charts:
        write_bytes(partial.path / "charts" / f"{chart.name}.svg", chart.svg.encode())
        write_bytes(partial.path / "charts" / f"{chart.name}.png", chart.png)
    write_json(partial.path / "report.json", report)
    for name, rows in (("views", task.rows), ("pairs", task.pairs), ("training", task.training_rows)):
        if rows or name == "views":
            write_csv(partial.path / f"{name}.csv", rows)
    page = build_page(report, replace(task.contact_sheet().encoded(), charts=charts))
    write_bytes(partial.path / "report.html", page.encode())
    return {
        **{metric.key: metric.mean for metric in metrics},
        "views": len(task.rows),
        "warnings": len(report["warnings"]),
    }


class Evaluation:
    """An evaluation in progress: its inputs, and the rows measured so far."""

    def __init__(self, inputs: Mapping[str, Artifact], config: EvaluateConfig, context: Context) -> None:
        self.inputs, self.config, self.context = dict(inputs), config, context
        self.scene = SceneViews(inputs["scene"])
        self.frames = FrameViews(inputs["frames"], self.scene.background)
        self.base = self._frames("base_frames")
        self.reference_frames = self._frames("reference_frames")
        self.field = inputs.get("field")
        self.edit = LocalEdit.from_inputs(inputs, config, self.scene, context)
        self.perceptual = PerceptualMetrics.load(config, self.field, context)
        path = self._frames("path_frames")
        mask = self.edit.path_masks() if self.edit and path else None
        self.path = PathConsistency(path, config, self.perceptual, mask) if path else None
        self.references = References(config.reference, self.scene, self.frames) if config.reference else None
        made_by_style = self.field is not None and is_stylized(self.field)
        self.stylized = made_by_style or self.base is not None or bool(config.style)
        self.painted: dict[int, np.ndarray] = {}  # by index of the frame: its photo painted in 2D
        self.painted_rows: list[Row] = []
        self.rows: list[Row] = []
        self.base_rows: list[Row] = []
        self.unmatched: list[str] = []
        self.resized = 0
        self.depth_sizes_differ = False
        self._sizes: set[tuple[int, int]] = set()

    def _frames(self, role: str) -> FrameViews | None:
        return FrameViews(self.inputs[role], self.scene.background) if role in self.inputs else None

    @property
    def training_rows(self) -> list[Row]:
        """Values of a local edit on training views."""
        return self.edit.training_rows if self.edit else []

    @property
    def pairs(self) -> list[Row]:
        """Values of pairs of frames of the camera path."""
        return self.path.rows if self.path else []

    def measure_views(self) -> None:
        """Measure view by view into `rows`, and for a stylized field into `base_rows`."""
        progress = self.context.progress
        progress.start("measuring views", len(self.frames), "view")
        previous: Render | None = None
        for done, render in enumerate(self.frames, start=1):
            row = ViewRow(render.name)
            self._sizes.add((render.camera.width, render.camera.height))
            photo = self._photo(render)
            if self.stylized:
                self._measure_stylized(row, render, photo)
                self._measure_by_reference(row, done - 1, render)
            elif photo is not None:
                measure_fit(row, render, photo, self.perceptual.scores(render.alpha.shape))
            if self.edit is not None:
                self.edit.measure(row, render, photo)
            if previous is not None:
                measure_see_through(row, render, previous)
            previous = render
            self.rows.append(row.row())
            leading = self.rows[-1].get("sifid" if self.stylized else "psnr")
            progress.update(done, "" if leading is None else f"{leading:.3f}" if self.stylized else f"{leading:.2f} dB")
        progress.finish()
        if self.edit is not None:
            self.edit.measure_training()

    def paint_views(self) -> None:
        """Paint the photos of the views that are shown in 2D, into `painted`, and measure them like renders."""
        from stages.evaluation.painted_views import (
            PaintedViews,
        )  # imported late: it needs the trainer, which other evaluations do not

        style = style_file(self.config, self.field)
        shown = [index for index, _ in self._shown() if self.rows[index]["name"] not in self.unmatched]
        if style is None or not shown:
            return
        context, steps = self.context, self.config.ceiling
        painter = PaintedViews(self.field, style, self.config.features, context.seed, context.device)
        context.progress.start("painting views in 2D", len(shown), "view")
        for done, index in enumerate(shown, start=1):
            render = self.frames.render(index)
            if render.scene_view is None:
                continue
            photo = self.scene.photo(render.scene_view, render.camera.width, render.camera.height)
            self.painted[index] = image = painter.painted(photo, self.scene.background, steps)
            row = ViewRow(render.name)
            opaque = np.ones(image.shape[:2]) if photo.mask is None else photo.mask
            self._measure_style(row, image, opaque.astype(np.float32), photo)
            measure_content(row, image, photo)
            self.painted_rows.append(row.row())
            context.progress.update(done)
        context.progress.finish()

    def _shown(self) -> list[tuple[int, str]]:
        """Return the indices of the views on the contact sheet, each with a word for its heading."""
        return chosen_views(self.rows, "content_ssim" if self.stylized else "psnr", self.config.sheet)

    def _photo(self, render: Render) -> Photo | None:
        if render.scene_view is None or not 0 <= render.scene_view < len(self.scene):
            self.unmatched.append(render.name)
            return None
        photo = self.scene.photo(render.scene_view, render.camera.width, render.camera.height)
        self.resized += photo.resized
        self.depth_sizes_differ |= photo.depth_size_differs
        return photo

    def _measure_stylized(self, row: ViewRow, render: Render, photo: Photo | None) -> None:
        base = self._base_of(render)
        if render.nonfinite:
            row.skip((*(STYLE_KEYS if self.perceptual.style_image else ()), *CONTENT_KEYS), nonfinite_message(render))
        else:
            self._measure_style(row, render.image, render.alpha, photo)
            if photo is not None:
                measure_content(row, render.image, photo)
        if base is not None:
            measure_shape(row, render, base)
        base_row = ViewRow(render.name)
        if base is not None and not base.nonfinite:
            self._measure_style(base_row, base.image, base.alpha, photo)
            if photo is not None and base.image.shape == photo.image.shape:
                measure_content(base_row, base.image, photo)
        elif base is None and photo is not None:
            mask = photo.mask if photo.visible is None else photo.visible
            mask = np.ones(photo.image.shape[:2], np.float32) if mask is None else mask.astype(np.float32)
            self._measure_style(base_row, photo.image, mask, photo)
        self.base_rows.append(base_row.row())

    def _measure_by_reference(self, row: ViewRow, index: int, render: Render) -> None:
        if self.references is not None:
            self.references.measure(row, index, render, self.perceptual.image_distance(render.alpha.shape))
        if self.reference_frames is not None:
            measure_robustness(row, render, self.reference_frames)

    def _measure_style(self, row: ViewRow, image: np.ndarray, alpha: np.ndarray, photo: Photo | None) -> None:
        style = self.perceptual.style_image
        if style is not None:
            measure_style(row, image, alpha, style.distances)
            measure_palette(row, image, alpha, *style.palette)
            measure_colors(row, image, alpha, style.colors)
            same_size = photo if photo is not None and photo.image.shape == image.shape else None
            measure_speckle(row, image, alpha, same_size, style.speckle(max(image.shape[:2])))

    def _base_of(self, render: Render) -> Render | None:
        """The unstylized render of the same view of the scene."""
        return None if self.base is None else self.base.same_view(render)

    def facts(self) -> dict:
        """What fills in labels and protocols."""
        perceptual, style = self.perceptual, self.perceptual.style_image
        return {
            **(self.edit.facts() if self.edit else {}),
            **palette_facts(self.field),
            "background": self.scene.background_description,
            "stlpips_net": perceptual.st_lpips.source if perceptual.st_lpips else "not available",
            "lpips_net": perceptual.lpips.source if perceptual.lpips else "not available",
            "perceptual_net": perceptual.pixel_name,
            "style_protocol": style.protocol if style else "no style image",
            "style_label": perceptual.style_label,
            "style_network": style.judge.description if style else "no style image",
            "gap": self.config.gap,
            "nearest": NEAREST,
            "plain": self.base.frames.field if self.base else "none",
            "reference_field": self.reference_frames.frames.field if self.reference_frames else "none",
            **(self.path.facts() if self.path else {}),
        }

    def report(self) -> tuple[dict, list[Metric]]:
        """report.json as a dictionary, and its metrics."""
        facts = self.facts()
        name = "the unstylized renders" if self.base is not None else "the photos"
        references = {metric.key: {name: metric.mean} for metric in summarize(self.base_rows, facts)}
        count = len(self.painted_rows)
        painted = f"{count} view{'s' * (count != 1)} painted in 2D"
        for metric in summarize(self.painted_rows, facts):
            references.setdefault(metric.key, {})[painted] = metric.mean
        palette = palette_rows(self.field, self.edit is not None)
        metrics = summarize([*self.rows, *self.pairs, *self.training_rows, *palette], facts, references)
        if self.edit is not None:
            metrics = self.edit.with_unedited(metrics, self.rows)
        first = ("base_field", "field", "frames", "path_frames", "base_frames")
        roles = dict.fromkeys((*first, *sorted({*self.inputs} - {"scene"}), "scene"))
        stages = upstream(self.inputs[role] for role in roles if role in self.inputs)
        report = {
            "field": self.frames.frames.field,
            "scene": self.inputs["scene"].name,
            "stylized": self.stylized,
            "style_image": self.perceptual.style_name,
            "view_count": len(self.rows),
            "resolution": " and ".join(f"{width}x{height}" for width, height in sorted(self._sizes)),
            "metrics": [asdict(metric) for metric in metrics],
            "views": self.rows,
            "pairs": self.pairs,
            "edit": self.edit.as_json() if self.edit else None,
            "training_views": self.training_rows,
            "stages": [asdict(made) for made in stages],
            "curve": training_curve(self.field),
            "warnings": [
                *warnings_of(self.rows, self.pairs, stages, self.unmatched, self.resized),
                *(self.edit.warnings() if self.edit else []),
            ],
            "not_measured": not_measured(self._inputs()),
            "device": self.context.device,
            "seed": self.context.seed,
            "versions": versions(),
        }
        return report, metrics

    def _inputs(self) -> Inputs:
        return Inputs(
            stylized=self.stylized,
            style_image=self.perceptual.style_image is not None,
            st_lpips=self.perceptual.st_lpips is not None,
            lpips=self.perceptual.lpips is not None,
            perceptual_wanted=self.config.perceptual != "none",
            large_enough=all(self.perceptual.large_enough((height, width)) for width, height in self._sizes),
            true_depth=self.scene.has_depth,
            depth_sizes_differ=self.depth_sizes_differ,
            base=self.base is not None,
            path=self.path.frames.frames.path if self.path else "",
            path_length=len(self.path.frames) if self.path else 0,
            consistency=self.config.consistency,
            reference=self.references is not None,
            reference_field=self.reference_frames is not None,
            gap=self.config.gap,
            field=self.field is not None,
            edited=self.edit is not None,
            masks=bool(self.config.masks),
            weights_changed=any(not {*row} & {*OF_WEIGHTS} for row in palette_rows(self.field, self.edit is not None)),
        )

    def contact_sheet(self) -> ContactSheet:
        """Collect the views worth seeing."""
        style, label, thumbnail = self.perceptual.style_image, self.perceptual.style_label, None
        if style:
            alt = f"{label[:1].upper()}{label[1:]} {self.perceptual.style_name}"
            thumbnail = Picture(style.on_white, label, alt)
        sheet = ContactSheet(thumbnail, self.stylized, edited=self.edit is not None)
        for index, word in self._shown():
            render = self.frames.render(index)
            size = (render.camera.width, render.camera.height)
            matched = render.scene_view if render.name not in self.unmatched else None
            photo = None if matched is None else self.scene.photo(matched, *size)
            heading = f"{render.name} ({word})" if word else render.name
            base = self.edit.unedited_render(render) if self.edit else self._base_of(render) if self.stylized else None
            sheet.add(heading, self.rows[index], render, photo, base, self.painted.get(index))
        return sheet


def training_curve(field: Artifact | None) -> dict | None:
    """{"of": name, "points": [{seconds, psnr, held_out, ...}]} of this field, or of the nearest field behind it.

    held_out: false if the views were already being trained on, or if that is unknown.
    """
    for artifact in [field, *fields_behind(field)] if field is not None else []:
        points = artifact.manifest.figures.get("curve")
        usable = [point for point in points if _is_point(point)] if isinstance(points, list) else []
        if len(usable) > 1:
            points = [{**point, "held_out": point.get("held_out") is True} for point in usable]
            return {"of": artifact.name, "points": sorted(points, key=lambda point: point["seconds"])}
    return None


def _is_point(point: object) -> bool:
    return isinstance(point, dict) and is_number(point.get("seconds")) and is_number(point.get("psnr"))
