"""Multi-view consistency of the frames of a camera path, by one protocol or several."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.metrics import Row
from stages.evaluation.optical_flow import FieldFlows, FileFlows
from stages.evaluation.perceptual_metrics import PerceptualMetrics
from stages.evaluation.test_views import FrameViews, Render
from stages.evaluation.view_metrics import ViewRow, nonfinite_message, spread
from stylerf.metrics.consistency import pair_consistency
from stylerf.metrics.flow_consistency import flow_consistency, laenerf_script, stylerf_family

RegionMask = Callable[[Render], np.ndarray]  # the pixels [h, w] of a frame that show the region of a local edit
METRICS = {  # of each protocol: error, fraction of pixels it is over, perceptual distance
    "correct": ("rmse", "share", "perceptual"),
    "laenerf-script": ("laenerf_script_mse", "laenerf_script_flagged", "laenerf_script_perceptual"),
    "stylerf-family": ("stylerf_family_rmse", "stylerf_family_share", "stylerf_family_perceptual"),
}


def pairs_of(count: int, gap: int, limit: int) -> list[tuple[int, int]]:
    """Pairs (k, k + gap) among `count` frames, at most `limit` (0: all), evenly spread."""
    return [(k, k + gap) for k in spread(max(0, count - gap), limit)]


class PathConsistency:
    """Consistency of the frames of a camera path: the pairs measured so far.

    Pairs are 1 frame apart (range `short`) or `gap` frames (range `long`).
    """

    def __init__(
        self, frames: FrameViews, config: EvaluateConfig, perceptual: PerceptualMetrics, mask: RegionMask | None
    ) -> None:
        self.frames, self.config, self._mask = frames, config, mask
        self.protocols = tuple(METRICS) if config.consistency == "all" else (config.consistency,)
        flows = (Path(config.flow).expanduser(), frames, config.flow_digest)
        self.flows = FileFlows(*flows) if config.flow else FieldFlows()
        gaps = {"short": 1, "long": config.gap}
        self._ranges = {label: pairs_of(len(frames), gap, config.pairs) for label, gap in gaps.items()}
        size = frames.render(0).alpha.shape
        self._pixel_distance, self._image_distance = perceptual.pixel_distance(size), perceptual.image_distance(size)
        self.rows: list[Row] = []

    def measure(self, progress) -> None:
        """Measure all pairs into `rows`."""
        pairs = [pair for pairs in self._ranges.values() for pair in pairs]
        if isinstance(self.flows, FileFlows):
            self.flows.require([*pairs, *((second, first) for first, second in pairs)])
        progress.start("measuring consistency", len(pairs), "pair")
        for row in self.measure_ranges(self._ranges):
            self.rows.append(row)
            progress.update(len(self.rows))
        progress.finish()

    def measure_ranges(self, ranges: dict[str, list[tuple[int, int]]]) -> Iterator[Row]:
        """Measure one row per pair: its range, names, and values under `<range>_<metric>` by METRICS of each protocol.

        Perceptual distances, by far the slowest, are measured on at most `perceptual_pairs` (0: all) pairs per range.
        """
        last: dict[int, Render] = {}
        for label, pairs in ranges.items():
            subset = self._perceptual_subset(pairs) if self._pixel_distance is not None else []
            for index, (source, target) in enumerate(pairs):
                last = {i: last[i] if i in last else self.frames.render(i) for i in (source, target)}
                row = self._pair(label, (last[source], last[target]), (source, target), index in subset)
                yield {**row.row(), "range": label, "frame": target}

    def _perceptual_subset(self, pairs: list[tuple[int, int]]) -> list[int]:
        """Indices of the pairs whose perceptual distance is measured."""
        return spread(len(pairs), self.config.perceptual_pairs)

    def facts(self) -> dict:
        """What fills in the protocols."""
        counts = {}
        for label, pairs in self._ranges.items():
            counts[f"{label}_pairs"] = len(pairs)
            counts[f"{label}_perceptual_pairs"] = len(self._perceptual_subset(pairs))
        by_depth = (
            "by the field's depth and poses; visible where both alphas are above 0.5 and the depths agree to "
            f"{self.config.depth_tolerance * 100:g} % at all four source pixels, eroded by 1 pixel"
        )
        by_flow = (
            f"along {self.flows.description}; visible where the target's alpha is above 0.5 and forward and backward "
            "flow cancel, away from motion boundaries (Ruder et al. 2016)"
        )
        return {
            **counts,
            "path": f"the path {self._path()} of {len(self.frames)} frames",
            "warp_protocol": by_flow if self.config.flow else by_depth,
            "flow": self.flows.description[0].upper() + self.flows.description[1:],
        }

    def _path(self) -> str:
        """The name of the path; a camera file also by its digest, since its name does not identify it."""
        path, digest = self.frames.frames.path, self.frames.artifact.manifest.config.get("path_digest")
        return f"{Path(path).name} ({digest[:8]})" if digest else path

    def _pair(self, label: str, views: tuple[Render, Render], indices: tuple[int, int], perceptual: bool) -> ViewRow:
        row = ViewRow(f"{views[0].name} > {views[1].name}")
        count = 3 if perceptual else 2
        keys = {protocol: tuple(f"{label}_{name}" for name in METRICS[protocol][:count]) for protocol in self.protocols}
        bad = next((view for view in views if view.nonfinite), None)
        if bad is not None:
            row.skip(sum(keys.values(), ()), f"{bad.name}: {nonfinite_message(bad)}")
            return row
        flows = self._flows(views, indices)
        for protocol, names in keys.items():
            row.measure(names, partial(self._values, protocol, views, flows, perceptual, count))
        if self._mask is not None and "correct" in self.protocols:
            within = self._mask(views[1])
            row.measure((f"edit_{label}_rmse",), lambda: self._values("correct", views, flows, False, 1, within))
        return row

    def _flows(self, views: tuple[Render, Render], indices: tuple[int, int]) -> tuple[np.ndarray, np.ndarray] | None:
        """Flow from the first view to the second, and back; None if no protocol needs it."""
        if self.protocols == ("correct",) and not self.config.flow:
            return None
        first, second = views
        return self.flows.between(first, second, indices), self.flows.between(second, first, indices[::-1])

    def _values(
        self,
        protocol: str,
        views: tuple[Render, Render],
        flows: tuple[np.ndarray, np.ndarray] | None,
        perceptual: bool,
        count: int,
        within: np.ndarray | None = None,
    ) -> tuple:
        """The first `count` of error, fraction of pixels and perceptual distance of one pair by one protocol."""
        first, second = views
        pixels, image = (self._pixel_distance, self._image_distance) if perceptual else (None, None)
        if flows is None or (protocol == "correct" and not self.config.flow):
            one, other = first.posed(), second.posed()
            pair = pair_consistency(one, other, pixels, self.config.depth_tolerance, within=within)
            return (pair.rmse, pair.share, pair.perceptual)[:count]
        forward, backward = flows
        if protocol == "correct":
            opaque = second.alpha > 0.5
            counted = opaque if within is None else opaque & within
            found = flow_consistency(first.image, second.image, forward, backward, pixels, counted)
        elif protocol == "laenerf-script":
            found = laenerf_script(first.image, second.image, forward, backward, image)
        else:
            found = stylerf_family(first.image, second.image, forward, pixels)
        return (found.error, found.share, found.perceptual)[:count]
