"""Figures of a local edit: what it left of the background, how far it bleeds, what it changed in its region."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from schemas.work_folder import Artifact
from stages.artifacts.edit import OF_WEIGHTS
from stages.artifacts.provenance import palette_behind
from stages.artifacts.region_masks import ROLE
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.metrics import Metric, Row, is_number
from stages.evaluation.region_masks import PictureMasks, RegionMasks
from stages.evaluation.test_views import FrameViews, Photo, Render, SceneViews
from stages.evaluation.view_metrics import ViewRow
from stages.run.progress import Context
from stylerf.metrics.local_edit import background_mse, mean_change, split_view

TRAIN = "train_"
UNEDITED = "background_mse_unedited"
REFERENCE = "the unedited renders"


class LocalEdit:
    """A local edit under evaluation: the frames before it, and the masks of its region."""

    def __init__(self, inputs: Mapping[str, Artifact], config: EvaluateConfig, scene: SceneViews, context: Context):
        self._inputs, self._config, self._scene, self._context = inputs, config, scene, context
        self.regions = {role: one for role, one in inputs.items() if role.startswith(ROLE)}
        self.unedited = self._frames("unedited_frames")
        self._masks = self._found_masks()
        self.training_rows: list[Row] = []

    @classmethod
    def found(cls, inputs: Mapping[str, Artifact], config: EvaluateConfig, scene: SceneViews, context: Context):
        """None where the evaluation is of no edit."""
        return cls(inputs, config, scene, context) if "unedited_frames" in inputs else None

    def _frames(self, role: str) -> FrameViews:
        return FrameViews(self._inputs[role], self._scene.background)

    def _found_masks(self) -> PictureMasks | RegionMasks:
        if not self._config.masks:
            return RegionMasks(self.regions, self._inputs["base_field"], self._context)
        roles = [role for role in ("unedited_frames", "unedited_train_frames") if role in self._inputs]
        names = [view.name for role in roles for view in self._frames(role).frames.views]
        return PictureMasks(Path(self._config.masks).expanduser(), names)

    @property
    def margin(self) -> int:
        """Pixels around the region that count neither as region nor as background; given masks are taken as given."""
        return 0 if self._config.masks else self._config.margin

    def unedited_twin(self, render: Render) -> Render | None:
        """The same view of the field before the edit."""
        at = self.unedited.showing(render.scene_view)
        return None if at is None else self.unedited.render(at)

    def measure(
        self, row: ViewRow, render: Render, photo: Photo | None, unedited: FrameViews | None = None, prefix: str = ""
    ) -> None:
        """The edit's figures of one view into `row`, under keys with the prefix."""
        unedited = unedited or self.unedited
        at = unedited.showing(render.scene_view)
        if at is None:
            row.spoil((prefix + "background_mse",), "the unedited field has no frame of this view")
            return
        base, inside = unedited.render(at), self._masks.inside(unedited, at, render)
        if inside is None:
            return
        parts = split_view(inside, self.margin, self._config.ring)
        row.measure((prefix + "region_share",), lambda: float(inside.mean()))
        if photo is not None:
            covered = ~parts.outside if photo.shown is None else ~(parts.outside & photo.shown)
            row.measure((prefix + UNEDITED,), lambda: background_mse(base.image, photo.image, covered))
            row.measure((prefix + "background_mse",), lambda: background_mse(render.image, photo.image, covered))
            _put_ratio(row, prefix)
        if inside.any():
            keys = (prefix + "change_inside", prefix + "change_lab")
            row.measure(keys, lambda: _both(mean_change(render.image, base.image, parts.inside)))
        if parts.ring.any():
            row.measure((prefix + "bleeding",), lambda: mean_change(render.image, base.image, parts.ring).absolute)

    def inside_film(self) -> Callable[[Render], np.ndarray] | None:
        """The region's pixels [h, w] of a frame of a film; None where the region is known by pictures of other views.

        By the unedited field: masks that the film holds are of the edited one's density.
        """
        return None if isinstance(self._masks, PictureMasks) else self._masks.seen_from

    def measure_training(self) -> None:
        """Fills `training_rows` where frames of the training views were given."""
        if "train_frames" not in self._inputs:
            return
        frames, unedited = self._frames("train_frames"), self._frames("unedited_train_frames")
        self._context.progress.start("measuring training views", len(frames), "view")
        for done, render in enumerate(frames, start=1):
            row, at, size = ViewRow(render.name), render.scene_view, (render.camera.width, render.camera.height)
            photo = None if at is None or at >= len(self._scene) else self._scene.photo(at, *size)
            self.measure(row, render, photo, unedited, TRAIN)
            self.training_rows.append(row.row())
            self._context.progress.update(done)
        self._context.progress.finish()

    def facts(self) -> dict:
        """What the protocols are filled in with."""
        masked = self._masks.words.format(margin=self.margin)
        return {
            "masked": masked,
            "inside": self._masks.words.partition(", and all")[0],
            "ring": self._config.ring,
            "unedited": self.unedited.frames.field,
        }

    def told(self, figures: list[Metric], rows: Sequence[Row]) -> list[Metric]:
        """The figures with those of the unedited field beside them; the ratio is that of the two means."""
        found = []
        for figure in figures:
            prefix = TRAIN if figure.key.startswith(TRAIN) else ""
            edited, unedited = _means([*rows, *self.training_rows], prefix)
            if figure.key == prefix + "background_mse" and unedited is not None:
                figure = replace(figure, reference={REFERENCE: unedited})
            elif figure.key == prefix + "background_ratio" and unedited:
                figure = replace(figure, mean=edited / unedited)
            found.append(figure)
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
        """What a reader must know before believing the figures."""
        if not isinstance(self._masks, PictureMasks):
            return []
        absent, folder, told = self._masks.absent, self._config.masks, []
        if self._masks.held and not any(self._masks.held):
            told.append(f"No mask in {folder} shows anything of a region: all that is seen counts as background.")
        if absent:
            shown = ", ".join(absent[:6]) + (f" and {len(absent) - 6} more" if len(absent) > 6 else "")
            told.append(f"{len(absent)} views have no mask in {folder} and take no part in its figures: {shown}.")
        return told


def palette_rows(field: Artifact | None, edited: bool) -> list[Row]:
    """Sparsity and TV of the weights of the palette that the field's colors are mixed of, as told when it was made.

    edited: whether a local edit is measured; the palette of one is not that of a whole field.
    """
    made = None if field is None else palette_behind(field)
    if made is None or (made.kind == "edit" and not edited):
        return []
    told = made.manifest.figures
    return [{"name": made.name, **{key: told[key] for key in OF_WEIGHTS if is_number(told.get(key))}}]


def palette_facts(field: Artifact | None) -> dict:
    """What the protocols of these figures are filled in with."""
    made = None if field is None else palette_behind(field)
    if made is None or made.kind == "edit":
        return {"palette_pixels": "the region's pixels", "palette_teller": "the edit that the field learned"}
    return {"palette_pixels": "the pixels that show the scene", "palette_teller": "the field that learned the palette"}


def _both(change) -> tuple[float, float]:
    return change.absolute, change.lab


def _put_ratio(row: ViewRow, prefix: str) -> None:
    edited, unedited = row.values[prefix + "background_mse"], row.values[prefix + UNEDITED]
    if is_number(edited) and is_number(unedited) and unedited > 0:
        row.values[prefix + "background_ratio"] = edited / unedited


def _means(rows: Sequence[Row], prefix: str) -> tuple[float | None, float | None]:
    """Mean background errors of the edited and of the unedited field, over the views that have both."""
    keys = (prefix + "background_mse", prefix + UNEDITED)
    pairs = [tuple(float(row[key]) for key in keys) for row in rows if all(is_number(row.get(key)) for key in keys)]
    return tuple(sum(column) / len(pairs) for column in zip(*pairs, strict=True)) if pairs else (None, None)
