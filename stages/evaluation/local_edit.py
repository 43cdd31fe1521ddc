"""Metrics of a local edit: change in its region, bleeding around it, and the background it should preserve."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from schemas.safe_names import listed
from schemas.work_folder import Artifact
from stages.artifacts.edit import OF_WEIGHTS
from stages.artifacts.provenance import palette_behind
from stages.artifacts.region import ROLE
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.metrics import Metric, Row, is_number, number_in
from stages.evaluation.region_masks import ImageMasks, RegionMasks
from stages.evaluation.test_views import FrameViews, Photo, Render, SceneViews
from stages.evaluation.view_metrics import ViewRow
from stages.run.progress import Context
from stylerf.metrics.local_edit import Change, background_mse, mean_change, split_view

TRAIN = "train_"
UNEDITED = "background_mse_unedited"
REFERENCE = "the unedited renders"


class LocalEdit:
    """A local edit under evaluation: frames of the unedited field, and masks of the region."""

    def __init__(self, inputs: Mapping[str, Artifact], config: EvaluateConfig, scene: SceneViews, context: Context):
        self._inputs, self._config, self._scene, self._context = inputs, config, scene, context
        self.regions = {role: one for role, one in inputs.items() if role.startswith(ROLE)}
        self.unedited = self._frames("unedited_frames")
        self._masks = self._find_masks()
        self.training_rows: list[Row] = []

    @classmethod
    def from_inputs(cls, inputs: Mapping[str, Artifact], config: EvaluateConfig, scene: SceneViews, context: Context):
        """The edit among the inputs; None if there is none."""
        return cls(inputs, config, scene, context) if "unedited_frames" in inputs else None

    def _frames(self, role: str) -> FrameViews:
        return FrameViews(self._inputs[role], self._scene.background)

    def _find_masks(self) -> ImageMasks | RegionMasks:
        if not self._config.masks:
            return RegionMasks(self.regions, self._inputs["base_field"], self._context)
        roles = [role for role in ("unedited_frames", "unedited_train_frames") if role in self._inputs]
        names = [view.name for role in roles for view in self._frames(role).frames.views]
        return ImageMasks(Path(self._config.masks).expanduser(), names)

    @property
    def margin(self) -> int:
        """Width in pixels of the ring that is neither region nor background; 0 for masks given as images."""
        return 0 if self._config.masks else self._config.margin

    def unedited_render(self, render: Render) -> Render | None:
        """Return the same view of the unedited field; None if it was not rendered."""
        return self.unedited.same_view(render)

    def measure(
        self, row: ViewRow, render: Render, photo: Photo | None, unedited: FrameViews | None = None, prefix: str = ""
    ) -> None:
        """Add the edit's metrics of one view to `row`, their keys prefixed."""
        unedited = unedited or self.unedited
        index = unedited.index_of(render.scene_view)
        if index is None:
            row.skip((prefix + "background_mse",), "the unedited field has no frame of this view")
            return
        base, inside = unedited.render(index), self._masks.inside(unedited, index, render)
        if inside is None:
            return
        parts = split_view(inside, self.margin, self._config.ring)
        row.measure((prefix + "region_share",), lambda: float(inside.mean()))
        if photo is not None:
            excluded = ~parts.outside if photo.visible is None else ~(parts.outside & photo.visible)
            row.measure((prefix + UNEDITED,), lambda: background_mse(base.image, photo.image, excluded))
            row.measure((prefix + "background_mse",), lambda: background_mse(render.image, photo.image, excluded))
            _put_ratio(row, prefix)
        if inside.any():
            keys = (prefix + "change_inside", prefix + "change_lab")
            row.measure(keys, lambda: _rgb_and_lab(mean_change(render.image, base.image, parts.inside)))
        if parts.ring.any():
            key = prefix + "bleeding"
            row.measure((key,), lambda: _rgb_and_lab(mean_change(render.image, base.image, parts.ring))[0])

    def path_masks(self) -> Callable[[Render], np.ndarray] | None:
        """A function giving the region's pixels [h, w] of a frame of a camera path; None with masks given as images.

        The masks come from the unedited field: those stored with the frames are based on the edited field's density.
        """
        return None if isinstance(self._masks, ImageMasks) else self._masks.march

    def measure_training(self) -> None:
        """Fill `training_rows` if frames of the training views were given."""
        if "train_frames" not in self._inputs:
            return
        frames, unedited = self._frames("train_frames"), self._frames("unedited_train_frames")
        self._context.progress.start("measuring training views", len(frames), "view")
        for done, render in enumerate(frames, start=1):
            row, view, size = ViewRow(render.name), render.scene_view, (render.camera.width, render.camera.height)
            photo = None if view is None or view >= len(self._scene) else self._scene.photo(view, *size)
            self.measure(row, render, photo, unedited, TRAIN)
            self.training_rows.append(row.row())
            self._context.progress.update(done)
        self._context.progress.finish()

    def facts(self) -> dict:
        """What fills in the protocols."""
        return {
            "masked": self._masks.description.format(margin=self.margin),
            "inside": self._masks.description.partition(", and all")[0],
            "ring": self._config.ring,
            "unedited": self.unedited.frames.field,
        }

    def with_unedited(self, metrics: list[Metric], rows: Sequence[Row]) -> list[Metric]:
        """Add the unedited field's background MSE as a reference, and make the ratio that of the two means."""
        found = []
        for metric in metrics:
            prefix = TRAIN if metric.key.startswith(TRAIN) else ""
            if (means := _means([*rows, *self.training_rows], prefix)) is not None:
                edited, unedited = means
                if metric.key == prefix + "background_mse":
                    metric = replace(metric, reference={REFERENCE: unedited})
                elif metric.key == prefix + "background_ratio" and unedited:
                    metric = replace(metric, mean=edited / unedited)
            found.append(metric)
        return found

    def as_json(self) -> dict:
        """For the report."""
        return {
            "regions": [one.name for one in self.regions.values()],
            "unedited": self.unedited.frames.field,
            "masks": self._config.masks,
            "margin": self.margin,
            "ring": self._config.ring,
        }

    def warnings(self) -> list[str]:
        """Return what a reader must know before trusting these metrics."""
        if not isinstance(self._masks, ImageMasks):
            return []
        missing, folder, found = self._masks.missing, self._config.masks, []
        if self._masks.nonempty and not any(self._masks.nonempty):
            found.append(f"All masks in {folder} are empty, so everything is treated as background.")
        if missing:
            found.append(f"{len(missing)} views have no mask in {folder} and are left out: {listed(missing)}.")
        return found


def palette_rows(field: Artifact | None, edited: bool) -> list[Row]:
    """Sparsity and TV of the weights of the field's color palette, as recorded when it was trained.

    edited: whether a local edit is measured; its palette is not that of the whole field.
    """
    made = None if field is None else palette_behind(field)
    if made is None or (made.kind == "edit" and not edited):
        return []
    recorded = made.manifest.figures
    return [{"name": made.name, **{key: recorded[key] for key in OF_WEIGHTS if is_number(recorded.get(key))}}]


def palette_facts(field: Artifact | None) -> dict:
    """What fills in the protocols of these metrics."""
    made = None if field is None else palette_behind(field)
    if made is None or made.kind == "edit":
        return {"palette_pixels": "the region's pixels", "palette_source": "the edit the field was fine-tuned to"}
    return {"palette_pixels": "the opaque pixels", "palette_source": "the field the palette was trained in"}


def _rgb_and_lab(change: Change | None) -> tuple[float, float]:
    return (math.nan, math.nan) if change is None else (change.absolute, change.lab)


def _put_ratio(row: ViewRow, prefix: str) -> None:
    edited, unedited = row.values[prefix + "background_mse"], row.values[prefix + UNEDITED]
    if edited is not None and unedited is not None and unedited > 0:
        row.values[prefix + "background_ratio"] = edited / unedited


def _means(rows: Sequence[Row], prefix: str) -> tuple[float, float] | None:
    """Mean background MSE of the edited and the unedited field, over views that have both; None without any."""
    both = [(number_in(row, prefix + "background_mse"), number_in(row, prefix + UNEDITED)) for row in rows]
    pairs = [(edited, unedited) for edited, unedited in both if edited is not None and unedited is not None]
    if not pairs:
        return None
    return sum(edited for edited, _ in pairs) / len(pairs), sum(unedited for _, unedited in pairs) / len(pairs)
