"""Consistency between the frames of a camera path, by one protocol or several."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.metrics import Row
from stages.evaluation.optical_flow import FieldFlows, FileFlows
from stages.evaluation.perceptual_metrics import PerceptualMetrics
from stages.evaluation.test_views import FrameViews, Render
from stages.evaluation.view_metrics import ViewRow, spoiled_words, spread
from stylerf.metrics.consistency import pair_consistency
from stylerf.metrics.flow_consistency import flow_consistency, laenerf_script, stylerf_family

Inside = Callable[[Render], np.ndarray]  # of a local edit: the pixels [h, w] of a frame that show its region
PARTS = {  # of the keys of each protocol: its error, the share of pixels it is over, its perceptual distance
    "correct": ("rmse", "share", "perceptual"),
    "laenerf-script": ("laenerf_script_mse", "laenerf_script_flagged", "laenerf_script_perceptual"),
    "stylerf-family": ("stylerf_family_rmse", "stylerf_family_share", "stylerf_family_perceptual"),
}


def pairs_of(count: int, gap: int, most: int) -> list[tuple[int, int]]:
    """Pairs (k, k + gap) among `count` frames, at most `most` (0: all), evenly spread."""
    return [(k, k + gap) for k in spread(max(0, count - gap), most)]


class PathConsistency:
    """The frames of a path under measurement, and the pairs measured so far.

    Pairs are 1 frame apart (range `short`) and `gap` frames (`long`).
    """

    def __init__(
        self, frames: FrameViews, config: EvaluateConfig, lenses: PerceptualMetrics, inside: Inside | None
    ) -> None:
        self.frames, self.config, self._inside = frames, config, inside
        self.modes = tuple(PARTS) if config.consistency == "all" else (config.consistency,)
        flows = (Path(config.flow).expanduser(), frames, config.flow_digest)
        self.flows = FileFlows(*flows) if config.flow else FieldFlows()
        gaps = {"short": 1, "long": config.gap}
        self._ranges = {label: pairs_of(len(frames), gap, config.pairs) for label, gap in gaps.items()}
        size = frames.render(0).alpha.shape
        self._pixels, self._whole = lenses.pixel_distance(size), lenses.whole_distance(size)
        self.rows: list[Row] = []

    def measure(self, progress) -> None:
        """Fills `rows`."""
        pairs = [pair for some in self._ranges.values() for pair in some]
        if isinstance(self.flows, FileFlows):
            self.flows.require([*pairs, *((second, first) for first, second in pairs)])
        progress.start("warping views", len(pairs), "pair")
        for row in self.measured(self._ranges):
            self.rows.append(row)
            progress.update(len(self.rows))
        progress.finish()

    def measured(self, ranges: dict[str, list[tuple[int, int]]]) -> Iterator[Row]:
        """One row a pair: `range`, names, and values under `<range>_<part>` by PARTS of each mode.

        The perceptual distances, by far the slowest, are taken of at most `perceptual_pairs` (0: all) pairs a range.
        """
        last: dict[int, Render] = {}
        for label, pairs in ranges.items():
            looked_at = self._looked_at(pairs) if self._pixels is not None else []
            for place, (source, target) in enumerate(pairs):
                last = {i: last[i] if i in last else self.frames.render(i) for i in (source, target)}
                row = self._pair(label, (last[source], last[target]), (source, target), place in looked_at)
                yield {**row.row(), "range": label, "frame": target}

    def _looked_at(self, pairs: list[tuple[int, int]]) -> list[int]:
        """Places of the pairs that a perceptual distance is taken of."""
        return spread(len(pairs), self.config.perceptual_pairs)

    def facts(self) -> dict:
        """What the protocols are filled in with."""
        counted = {f"{label}_pairs": len(pairs) for label, pairs in self._ranges.items()}
        looked_at = {f"{label}_looked_at": len(self._looked_at(pairs)) for label, pairs in self._ranges.items()}
        by_depth = (
            "by the field's own depth and poses; visible where the alpha of both is over 0.5 and "
            f"their depths agree to {self.config.depth_tolerance * 100:g} % at all four source pixels, worn down by 1 "
            "pixel"
        )
        by_flow = (
            f"along {self.flows.words}; visible where the target's alpha is over 0.5 and the flows of both directions "
            "cancel and have no step (Ruder et al. 2016)"
        )
        return {
            **counted,
            **looked_at,
            "path": f"the path {self._path()} of {len(self.frames)} frames",
            "warp_protocol": by_flow if self.config.flow else by_depth,
            "flow": self.flows.words[0].upper() + self.flows.words[1:],
        }

    def _path(self) -> str:
        """A file of cameras goes by its content: another of that name is another path."""
        path, digest = self.frames.frames.path, self.frames.artifact.manifest.config.get("path_digest")
        return f"{Path(path).name} ({digest[:8]})" if digest else path

    def _pair(self, label: str, views: tuple[Render, Render], places: tuple[int, int], looked_at: bool) -> ViewRow:
        row = ViewRow(f"{views[0].name} > {views[1].name}")
        count = 3 if looked_at else 2
        keys = {mode: tuple(f"{label}_{part}" for part in PARTS[mode][:count]) for mode in self.modes}
        bad = next((view for view in views if view.spoiled), None)
        if bad is not None:
            row.spoil(sum(keys.values(), ()), f"{bad.name}: {spoiled_words(bad)}")
            return row
        forward, backward = self._flows(views, places)
        for mode, wanted in keys.items():
            row.measure(wanted, lambda mode=mode: self._values(mode, views, forward, backward, looked_at)[:count])
        if self._inside is not None and "correct" in self.modes:
            within = self._inside(views[1])
            key = (f"edit_{label}_rmse",)
            row.measure(key, lambda: self._values("correct", views, forward, backward, False, within)[0])
        return row

    def _flows(self, views: tuple[Render, Render], places: tuple[int, int]):
        """Flow from the first view to the second, and back; None where no mode asks for it."""
        if self.modes == ("correct",) and not self.config.flow:
            return None, None
        first, second = views
        return self.flows.between(first, second, places), self.flows.between(second, first, places[::-1])

    def _values(
        self,
        mode: str,
        views: tuple[Render, Render],
        forward: np.ndarray | None,
        backward: np.ndarray | None,
        looked_at: bool,
        within: np.ndarray | None = None,
    ) -> tuple:
        """Error, share, perceptual distance of one pair by one protocol."""
        first, second = views
        pixels, whole = (self._pixels, self._whole) if looked_at else (None, None)
        if mode == "correct" and not self.config.flow:
            one, other = first.posed(), second.posed()
            found = pair_consistency(one, other, pixels, self.config.depth_tolerance, within=within)
            return found.rmse, found.share, found.perceptual
        if mode == "correct":
            opaque = second.alpha > 0.5
            asked = opaque if within is None else opaque & within
            found = flow_consistency(first.image, second.image, forward, backward, pixels, asked)
        elif mode == "laenerf-script":
            found = laenerf_script(first.image, second.image, forward, backward, whole)
        else:
            found = stylerf_family(first.image, second.image, forward, pixels)
        return found.error, found.share, found.perceptual
