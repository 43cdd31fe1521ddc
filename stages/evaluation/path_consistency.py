"""Multi-view consistency of the frames of a camera path, by the field's depth and poses or by optical flow."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from schemas.flow_files import FLOW_SUFFIXES, read_flow
from schemas.safe_names import listed
from stages.configs.evaluate import EvaluateConfig
from stages.evaluation.metrics import Row
from stages.evaluation.perceptual_metrics import PerceptualMetrics
from stages.evaluation.test_views import FrameViews, Render
from stages.evaluation.view_metrics import ViewRow, nonfinite_message, spread
from stylerf.metrics.consistency import pair_consistency
from stylerf.metrics.flow_consistency import flow_consistency, laenerf_script, stylerf_family
from stylerf.metrics.optical_flow import field_flow


class FieldFlows:
    """Flow from the depth of the first frame and the poses of both."""

    description = "flow from the field's depth and poses, none where it is transparent"

    def between(self, first: Render, second: Render, _indices: tuple[int, int]) -> np.ndarray:
        """Flow [h, w, 2] in pixels from the first frame to the second, NaN where the first is transparent."""
        return field_flow(first.posed(), second.camera)


class FileFlows:
    """Flow from a folder of `FROM_to_TO.flo` or `.npy`; FROM and TO are numbers of frames as in png/NNNN.png.

    digest: of the flow files; the protocol shows its first digits beside the folder's name.
    """

    def __init__(self, folder: Path, frames: FrameViews, digest: str) -> None:
        self._folder, self._files = folder, {path.stem: path for path in flow_files(folder)}
        self._numbers = [PurePosixPath(view.png).stem for view in frames.frames.views]
        self.description = f"flow from files ({folder.name} {digest[:8]})"

    def require(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Raise BadInput unless there is a file for each of these pairs of frame indices."""
        wanted = [self._name(first, second) for first, second in pairs]
        missing = [name for name in wanted if name not in self._files]
        if missing:
            raise BadInput(
                f"--flow {self._folder}: {len(missing)} of {len(wanted)} flows are missing ({listed(missing, 3)}); "
                f"expected FROM_to_TO.flo or .npy in both directions for every pair, such as {wanted[0]}.flo, numbered "
                "like the images in png/ (--pairs sets the number of pairs)"
            )

    def between(self, first: Render, second: Render, indices: tuple[int, int]) -> np.ndarray:
        """Flow [h, w, 2] in pixels from the first frame to the second, NaN where it is unknown."""
        path = self._files[self._name(*indices)]
        found = read_flow(path)
        height, width = first.alpha.shape
        if found.shape[:2] != (height, width):
            raise BadInput(
                f"flow {path} is {found.shape[1]}x{found.shape[0]} but frame {first.name} is {width}x{height}; compute "
                "the flow at the size of the frames"
            )
        return found

    def _name(self, first: int, second: int) -> str:
        return f"{self._numbers[first]}_to_{self._numbers[second]}"


def flow_files(folder: Path) -> list[Path]:
    """List the flow files in a folder; BadInput if there are none."""
    found = sorted(one for one in folder.glob("*") if one.suffix.lower() in FLOW_SUFFIXES and one.is_file())
    if not found:
        raise BadInput(f"--flow {folder}: expected .flo or .npy files, found none")
    return found


def flows_digest(folder: Path) -> str:
    """Digest of the names and contents of the flow files in a folder."""
    return digest_of({one.name: file_sha256(one) for one in flow_files(folder)})


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
            row.measure(
                names, partial(self._values, protocol, views, flows, perceptual, count),
                "no pixel of the second frame is visible in the first" if protocol == "correct" else "",
            )  # fmt: skip
        if self._mask is not None and "correct" in self.protocols and (within := self._mask(views[1])).any():
            names = (f"edit_{label}_rmse", f"edit_{label}_share")
            row.measure(names, lambda: self._values("correct", views, flows, False, 2, within))
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
