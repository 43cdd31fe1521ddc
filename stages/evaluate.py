"""Evaluate: how good a field is by held-out views, along a path, and by its cost; as JSON, CSV, charts and HTML.

Roles of the inputs: `scene`, `frames` (test views); where at hand `path_frames` (a camera path, for consistency),
`base_frames` (the unstylized field at the same test views), `twin_frames` (a field whose renders were the references of
this one, at the same test views) and `field`. Of a local edit also `unedited_frames` and
`base_field` (the field before it), `region.<name>` for each region that counts as edited, and where training views are
wanted `train_frames` and `unedited_train_frames`.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from schemas.atomic_write import write_bytes, write_json
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import OF_WEIGHTS
from stages.artifacts.provenance import is_stylized, upstream
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.local_edit import LocalEdit, palette_facts, palette_rows
from stages.evaluation.metrics import Metric, Row, summarize, write_csv
from stages.evaluation.path_consistency import PathConsistency
from stages.evaluation.perceptual_metrics import PerceptualMetrics
from stages.evaluation.pinned_inputs import digests_of_files
from stages.evaluation.reference_metrics import NEAREST, References, measure_robustness
from stages.evaluation.test_views import FrameViews, Photo, Render, SceneViews
from stages.evaluation.view_metrics import (
    ViewRow,
    measure_content,
    measure_fit,
    measure_palette,
    measure_see_through,
    measure_shape,
    measure_style,
    spoiled_words,
)
from stages.report.contact_sheet import ContactSheet, chosen_views
from stages.report.evaluation_page import build_page
from stages.report.notes import Presence, curve_of, draw_charts, not_measured, warnings_of
from stages.report.thumbnails import Picture
from stages.run.progress import Context
from stages.run.runner import Spec, versions

SPEC = Spec(stage="evaluate", verb="eval", revision=5, writes="report", outside=digests_of_files)
STYLE_KEYS = ("nnfm", "gram", "sifid", "palette", "palette_mean", "palette_covariance", "content_ssim")


def run(inputs: dict[str, Artifact], config: EvaluateConfig, partial: PartialArtifact, context: Context) -> dict:
    """Writes report.json, views.csv, pairs.csv, training.csv, charts/ and report.html; returns the means by key."""
    task = Evaluation(inputs, config, context)
    task.measure_views()
    task.measure_path()
    report, figures = task.report()
    charts = draw_charts(task.stylized, task.rows, task.pairs, report["curve"], config.gap, task.lenses.style_words)
    for chart in charts:
        write_bytes(partial.path / "charts" / f"{chart.name}.svg", chart.svg.encode())
        write_bytes(partial.path / "charts" / f"{chart.name}.png", chart.png)
    write_json(partial.path / "report.json", report)
    for name, rows in (("views", task.rows), ("pairs", task.pairs), ("training", task.training_rows)):
        if rows or name == "views":
            write_csv(partial.path / f"{name}.csv", rows)
    page = build_page(report, replace(task.sheet().encoded(), charts=charts))
    write_bytes(partial.path / "report.html", page.encode())
    return {
        **{figure.key: figure.mean for figure in figures},
        "views": len(task.rows),
        "warnings": len(report["warnings"]),
    }


class Evaluation:
    """One evaluation in progress: what it looks at, and the rows measured so far."""

    def __init__(self, inputs: Mapping[str, Artifact], config: EvaluateConfig, context: Context) -> None:
        self.inputs, self.config, self.context = dict(inputs), config, context
        self.scene = SceneViews(inputs["scene"])
        self.frames = FrameViews(inputs["frames"], self.scene.background)
        self.base = self._frames("base_frames")
        self.twin = self._frames("twin_frames")
        self.field = inputs.get("field")
        self.edit = LocalEdit.found(inputs, config, self.scene, context)
        self.lenses = PerceptualMetrics.found(config, self.field, context)
        path = self._frames("path_frames")
        inside = self.edit.inside_film() if self.edit and path else None
        self.film = PathConsistency(path, config, self.lenses, inside) if path else None
        self.references = References(config.reference, self.scene, self.frames) if config.reference else None
        made_by_style = self.field is not None and is_stylized(self.field)
        self.stylized = made_by_style or self.base is not None or bool(config.style)
        self.rows: list[Row] = []
        self.reference_rows: list[Row] = []
        self.unmatched: list[str] = []
        self.resized = 0
        self.depth_sizes_differ = False
        self._sizes: set[tuple[int, int]] = set()

    def _frames(self, role: str) -> FrameViews | None:
        return FrameViews(self.inputs[role], self.scene.background) if role in self.inputs else None

    @property
    def training_rows(self) -> list[Row]:
        """Figures of a local edit on training views."""
        return self.edit.training_rows if self.edit else []

    @property
    def pairs(self) -> list[Row]:
        """Figures of pairs of frames of the path."""
        return self.film.rows if self.film else []

    def measure_views(self) -> None:
        """Fills `rows` (and `reference_rows` for a stylized field), view by view."""
        progress = self.context.progress
        progress.start("measuring views", len(self.frames), "view")
        before: Render | None = None
        for done, render in enumerate(self.frames, start=1):
            row = ViewRow(render.name)
            self._sizes.add((render.camera.width, render.camera.height))
            photo = self._photo(render)
            if self.stylized:
                self._measure_stylized(row, render, photo)
                self._measure_by_reference(row, done - 1, render)
            else:
                self._measure_fitted(row, render, photo)
            if self.edit is not None:
                self.edit.measure(row, render, photo)
            if before is not None:
                measure_see_through(row, render, before)
            before = render
            self.rows.append(row.row())
            leading = self.rows[-1].get("nnfm" if self.stylized else "psnr")
            progress.update(done, "" if leading is None else f"{leading:.3f}" if self.stylized else f"{leading:.2f} dB")
        progress.finish()
        if self.edit is not None:
            self.edit.measure_training()

    def _photo(self, render: Render) -> Photo | None:
        if render.scene_view is None or not 0 <= render.scene_view < len(self.scene):
            self.unmatched.append(render.name)
            return None
        photo = self.scene.photo(render.scene_view, render.camera.width, render.camera.height)
        self.resized += photo.resized
        self.depth_sizes_differ |= photo.depth_unfit
        return photo

    def _measure_fitted(self, row: ViewRow, render: Render, photo: Photo | None) -> None:
        if photo is not None:
            measure_fit(row, render, photo, self.lenses.scores(render.alpha.shape))

    def _measure_stylized(self, row: ViewRow, render: Render, photo: Photo | None) -> None:
        base = self._base_of(render)
        if render.spoiled:
            row.spoil(STYLE_KEYS if self.lenses.painting else STYLE_KEYS[-1:], spoiled_words(render))
        else:
            self._measure_look(row, render.image, render.alpha)
            if photo is not None:
                measure_content(row, render.image, photo)
        if base is not None:
            measure_shape(row, render, base)
        reference = ViewRow(render.name)
        if base is not None and not base.spoiled:
            self._measure_look(reference, base.image, base.alpha)
            if photo is not None and base.image.shape == photo.image.shape:
                measure_content(reference, base.image, photo)
        elif base is None and photo is not None:
            mask = photo.mask if photo.shown is None else photo.shown
            mask = np.ones(photo.image.shape[:2], np.float32) if mask is None else mask.astype(np.float32)
            self._measure_look(reference, photo.image, mask)
        self.reference_rows.append(reference.row())

    def _measure_by_reference(self, row: ViewRow, index: int, render: Render) -> None:
        if self.references is not None:
            self.references.measure(row, index, render, self.lenses.whole_distance(render.alpha.shape))
        if self.twin is not None:
            measure_robustness(row, render, self.twin)

    def _measure_look(self, row: ViewRow, image: np.ndarray, alpha: np.ndarray) -> None:
        painting = self.lenses.painting
        if painting is not None:
            measure_style(row, image, alpha, painting.distances)
            measure_palette(row, image, alpha, painting.image)

    def _base_of(self, render: Render) -> Render | None:
        """The unstylized render of the same view of the scene."""
        found = self.base.showing(render.scene_view) if self.base is not None else None
        return None if found is None else self.base.render(found)

    def measure_path(self) -> None:
        """Fills `pairs`: consistency of frames 1 and `gap` apart."""
        if self.film is not None:
            self.film.measure(self.context.progress)

    def facts(self) -> dict:
        """What the protocols are filled in with."""
        lenses = self.lenses
        return {
            **(self.edit.facts() if self.edit else {}),
            **palette_facts(self.field),
            "background": self.scene.background_words,
            "stlpips_net": lenses.tolerant.words if lenses.tolerant else "absent",
            "lpips_net": lenses.lpips.words if lenses.lpips else "absent",
            "perceptual_net": lenses.pixel_name,
            "style_protocol": lenses.painting.protocol if lenses.painting else "no painting",
            "style_words": lenses.style_words,
            "style_trunk": lenses.painting.trunk_name if lenses.painting else "no painting",
            "gap": self.config.gap,
            "nearest": NEAREST,
            "plain": self.base.frames.field if self.base else "none",
            "twin": self.twin.frames.field if self.twin else "none",
            **(self.film.facts() if self.film else {}),
        }

    def report(self) -> tuple[dict, list[Metric]]:
        """report.json as a dictionary, and its figures."""
        facts = self.facts()
        name = "the unstylized renders" if self.base is not None else "the photos"
        reference = {figure.key: {name: figure.mean} for figure in summarize(self.reference_rows, facts)}
        palette = palette_rows(self.field, self.edit is not None)
        figures = summarize([*self.rows, *self.pairs, *self.training_rows, *palette], facts, reference)
        if self.edit is not None:
            figures = self.edit.told(figures, self.rows)
        first = ("base_field", "field", "frames", "path_frames", "base_frames")
        roles = dict.fromkeys((*first, *sorted({*self.inputs} - {"scene"}), "scene"))
        stages = upstream(self.inputs[role] for role in roles if role in self.inputs)
        report = {
            "field": self.frames.frames.field,
            "scene": self.inputs["scene"].name,
            "stylized": self.stylized,
            "painting": self.lenses.painting_name,
            "view_count": len(self.rows),
            "resolution": " and ".join(f"{width}x{height}" for width, height in sorted(self._sizes)),
            "figures": [figure.as_json() for figure in figures],
            "views": self.rows,
            "pairs": self.pairs,
            "edit": self.edit.as_json() if self.edit else None,
            "training_views": self.training_rows,
            "stages": [made.as_json() for made in stages],
            "curve": curve_of(self.field),
            "warnings": [
                *warnings_of(self.rows, self.pairs, stages, self.unmatched, self.resized),
                *(self.edit.warnings() if self.edit else []),
            ],
            "not_measured": not_measured(self._presence()),
            "device": self.context.device,
            "seed": self.context.seed,
            "versions": versions(),
        }
        return report, figures

    def _presence(self) -> Presence:
        return Presence(
            stylized=self.stylized,
            painting=self.lenses.painting is not None,
            tolerant=self.lenses.tolerant is not None,
            lpips=self.lenses.lpips is not None,
            perceptual_wanted=self.config.perceptual != "none",
            large_enough=all(self.lenses.large_enough((height, width)) for width, height in self._sizes),
            true_depth=self.scene.has_depth,
            depth_sizes_differ=self.depth_sizes_differ,
            base=self.base is not None,
            path=self.film.frames.frames.path if self.film else "",
            path_length=len(self.film.frames) if self.film else 0,
            consistency=self.config.consistency,
            reference=self.references is not None,
            twin=self.twin is not None,
            gap=self.config.gap,
            field=self.field is not None,
            edited=self.edit is not None,
            masks=bool(self.config.masks),
            weights_changed=any(not {*row} & {*OF_WEIGHTS} for row in palette_rows(self.field, self.edit is not None)),
        )

    def sheet(self) -> ContactSheet:
        """The contact sheet of the views worth seeing."""
        key = "content_ssim" if self.stylized else "psnr"
        lenses, painting = self.lenses, None
        if lenses.painting:
            words = f"{lenses.style_words[:1].upper()}{lenses.style_words[1:]} {lenses.painting_name}"
            painting = Picture(lenses.painting.image, lenses.style_words, words)
        sheet = ContactSheet(painting, self.stylized, edited=self.edit is not None)
        for index, word in chosen_views(self.rows, key, self.config.sheet):
            render = self.frames.render(index)
            known = render.name not in self.unmatched
            size = (render.camera.width, render.camera.height)
            photo = self.scene.photo(render.scene_view, *size) if known else None
            heading = f"{render.name} ({word})" if word else render.name
            base = self.edit.unedited_twin(render) if self.edit else self._base_of(render) if self.stylized else None
            sheet.add(heading, self.rows[index], render, photo, base)
        return sheet
