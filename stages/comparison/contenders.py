"""The stylizations that people compare: their labels and pictures."""

import shlex
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from schemas.errors import ArtifactStale, StylerfError, UsageError
from schemas.frames import FRAMES_FILE, read_frames
from schemas.safe_names import listed
from schemas.work_folder import Artifact, WorkFolder, newest
from stages.artifacts.style_images import read_colors
from stages.comparison.runs import STYLIZATIONS, Gap, Run, scene_behind
from stages.configs.evaluate import EvaluateConfig
from stages.configs.stylize import CONFIGS
from stages.evaluation.perceptual_metrics import style_file
from stages.evaluation.test_views import FrameViews, SceneViews

PATH = "test"  # the held-out views, which no method saw
# Options that do not distinguish methods or settings: the group has the style image; the rest has no visible effect.
PASSED = frozenset(
    ("style", "style_digest", "features_digest", "reference", "references_digest", "checkpoint_every_seconds")
)


@dataclass(frozen=True, eq=False)
class Contender:
    """A stylized field with its frames of the held-out views.

    Attributes:
        label: method and the options in which contenders of this method differ; the same in every scene.
        views: indices of the scene's views that it shows.
    """

    run: Run
    label: str
    field: Artifact
    frames: FrameViews
    scene: SceneViews
    style: Path
    views: tuple[int, ...]

    def picture(self, view: int) -> np.ndarray:
        """Return its render of a view of the scene, [h, w, 3] sRGB over the scene's background."""
        index = self.frames.index_of(view)
        if index is None:
            raise ArtifactStale(f"frames {self.frames.artifact.name} do not show view {view}; render them again")
        return self.frames.render(index).image

    def style_image(self) -> np.ndarray:
        """The style image, [h, w, 3] sRGB."""
        return read_colors(self.style)


def contenders_of(
    runs: Sequence[Run], fields: Mapping[str, tuple[WorkFolder, Artifact]], named: Sequence[str] = ()
) -> tuple[list[Contender], list[Gap]]:
    """Return the stylizations that can be compared, and why others cannot.

    Args:
        runs: As runs_of found them.
        fields: Work folder and artifact of each run, by title.
        named: Fields to take, by name or title; empty for all.

    Raises:
        UsageError: A name is not that of a stylization.
    """
    runs = [run for run in runs if run.family == STYLIZATIONS]
    known = {name for run in runs for name in (run.name, run.title)}
    if unknown := [name for name in named if name not in known]:
        raise UsageError(f"--of {unknown[0]}: unknown stylization; choose from {listed(sorted(known))}")
    found, gaps = [], []
    for run in runs:
        if named and not {run.name, run.title} & {*named}:
            continue
        work, field = fields[run.title]
        try:
            found.append(_contender(run, work, field))
        except StylerfError as error:
            gaps.append(Gap(run.title, str(error)))
    labels = labels_of([(one.run, one.field.manifest.config) for one in found])
    return [replace(one, label=label) for one, label in zip(found, labels, strict=True)], gaps


def labels_of(runs: Sequence[tuple[Run, Mapping]]) -> list[str]:
    """Name runs by method and by the options in which runs of this method differ.

    Contenders of one group that would share a label also get the names of their fields.
    """
    values: dict[tuple[str, str], set[str]] = defaultdict(set)
    keys = {run.method: sorted({key for one, config in runs if one.method == run.method for key in config} - PASSED)
            for run, _ in runs}  # fmt: skip
    for run, config in runs:
        for key in keys[run.method]:
            values[run.method, key].add(str(config.get(key)))
    labels = []
    for run, config in runs:
        varying = [key for key in keys[run.method] if len(values[run.method, key]) > 1 and key != "method"]
        # An option that a run lacks, or that has its default, appears only in the labels of others.
        kind = CONFIGS.get(run.method)
        usual = {item.name: item.default for item in fields(kind)} if kind else {}
        given = [f"{key.replace('_', '-')} {config[key]}" for key in varying
                 if config.get(key) not in (None, "", usual.get(key))]  # fmt: skip
        labels.append(", ".join([run.method, *given]))
    places = [(run.group, label) for (run, _), label in zip(runs, labels, strict=True)]
    return [
        f"{label} ({run.name})" if places.count(place) > 1 else label
        for (run, _), label, place in zip(runs, labels, places, strict=True)
    ]


def _contender(run: Run, work: WorkFolder, field: Artifact) -> Contender:
    scene = SceneViews(scene_behind(field))
    frames = _test_frames(work, field, scene)
    style = style_file(EvaluateConfig(), field)
    if style is None:
        raise ArtifactStale("its style image no longer exists")
    views = sorted({view.scene_view for view in frames.frames.views if view.scene_view is not None})
    return Contender(run, "", field, frames, scene, style, tuple(view for view in views if view < len(scene)))


def _test_frames(work: WorkFolder, field: Artifact, scene: SceneViews) -> FrameViews:
    """Return the newest complete, full-size frames of exactly this field from the held-out views, or ArtifactStale."""
    found = []
    for one in work.artifacts("frames"):
        config = one.manifest.config
        shows = any(ref.kind == "field" and ref.digest == field.digest for ref in one.manifest.inputs)
        whole = config.get("exr", True) and config.get("scale", 1) == 1 and not config.get("frames")
        if shows and whole and one.has(FRAMES_FILE):
            with suppress(StylerfError):
                one.check_sizes()
                if read_frames(one.path).path == PATH:
                    found.append(one)
    if not found:
        command = shlex.join(["stylerf", "eval", str(work.root), "--of", field.name])
        raise ArtifactStale(f"It has no EXR frames of its held-out views; render them with: {command}")
    return FrameViews(newest(found)[0], scene.background)
