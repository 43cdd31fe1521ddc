"""Fit a radiance field to posed images, no larger than held-out views require.

The field starts coarse and grows through capacity levels. Each level is a trial: unless held-out views have gained
`min_gain` dB over the previous level when its part of the budget is used up, the field returns to the previous level
and stays there. Then, whatever the views do not need is pruned (capacity_search.py decides). Held-out views are taken
from the training views, never from the test views; once everything is decided, or in the last part of the budget, they
are trained on as well.
"""

import itertools
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import Capacity
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.fit.capacity_search import ROUNDING_PSNR, CapacitySearch
from stylerf.training.fit.engine import Batch, CpuEngine
from stylerf.training.fit.exposure import FEWEST_PHOTOS, PLAINLY, UNEXPLAINED, Exposures
from stylerf.training.fit.held_out import HeldOutRays
from stylerf.training.fit.schedule import EXPOSURE_FROM, EXPOSURE_KNOWN, USABLE_FROM, batch_at, rays_for, refresh_every
from stylerf.training.fit.settings import (
    CapacityLevel,
    FitSettings,
    FitState,
    capacities_at,
    first_parts,
    grown_parts,
)
from stylerf.training.fit.visual_hull import clear_cells

if TYPE_CHECKING:
    from stylerf.training.fit.engine_gpu import GpuEngine

Engine: TypeAlias = "CpuEngine | GpuEngine"
MOST_ROLLBACKS = 4
CHECK_EVERY = 0.04  # of the budget


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A field's describe() and arrays, and the engine's moments."""

    field: dict[str, Any]
    arrays: dict[str, np.ndarray]

    @classmethod
    def of(cls, field: dict[str, Any], arrays: dict[str, np.ndarray], prefix: str) -> "Snapshot":
        """Create a snapshot from the checkpoint arrays whose names begin with `prefix`."""
        return cls(field, {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)})


class Fitter:
    """Trains until the budget is spent.

    Args:
        dataset: Training rays; the last `held_out` views are held out for decisions.
        on_say: Receives messages about decisions.
        group: Processes that train this field together; settings.samples is the total over them.
        engine: Creates the engine from (dataset, seed, threads, first field, group); see training/backends.py.
    """

    def __init__(
        self,
        space: SpaceWarp,
        dataset: RayDataset,
        held_out: int,
        settings: FitSettings,
        seed: int,
        threads: int,
        on_say: Callable[[str], None] = lambda text: None,
        group: ProcessGroup = SINGLE_PROCESS,
        engine: Callable[..., Engine] = CpuEngine,
    ) -> None:
        self.space, self.dataset, self.held_out, self.settings = space, dataset, held_out, settings
        self.seed, self.threads, self.on_say, self.group = seed, threads, on_say, group
        self.state = FitState()
        self.search = CapacitySearch(settings, self.state, self._judges)
        self._warm: set[tuple[int, int, int]] = set()
        self.checks, self.check_seconds = 0, 0.0  # in this process; time of the last one, outside the budget
        level, generator = settings.levels[0], np.random.default_rng([seed, 1])
        self._clear: dict[int, np.ndarray | None] = {}
        first = RadianceField(
            space,
            *first_parts(settings.kinds, *self._capacities(level), generator),
            OccupancyGrid(level.cells, clear=self._clear_cells(level.cells)),
            self.space.marching_step(level.resolution),
        )
        self.engine = engine(dataset, seed, threads, first, group)
        self.held_out_rays = HeldOutRays(dataset, held_out, space.kind != "box", settings.background, seed)
        enough = settings.exposure == "on" or (settings.exposure == "auto" and len(dataset.cameras) >= FEWEST_PHOTOS)
        self.exposures = Exposures(dataset, seed) if enough else None
        self._anchor: Snapshot | None = None
        self._refreshed_at = -1
        self.between_steps = True

    def _clear_cells(self, cells: int) -> np.ndarray | None:
        """Return the cells that cut-out training views show to be empty; None without a visual hull."""
        if self.settings.visual_hull <= 0 or self.space.kind != "box" or self.dataset.channels != 4:
            return None
        if cells not in self._clear:
            cameras = self.dataset.cameras[: len(self.dataset.cameras) - self.held_out]
            alphas = itertools.islice(self.dataset.alphas(), len(cameras))
            share, threads = self.settings.visual_hull, self.threads
            self._clear[cells] = clear_cells(cameras, alphas, self.space, cells, share, threads)
        return self._clear[cells]

    # -- capacity ---------------------------------------------------------------------------------------------------

    @property
    def field(self) -> RadianceField:
        """The current field."""
        return self.engine.field

    @property
    def parameters(self) -> int:
        """Number of learnable parameters; does not synchronize with a GPU."""
        return self.engine.parameters

    def _capacities(
        self, level: CapacityLevel, occupancy: OccupancyGrid | None = None
    ) -> tuple[Capacity, Capacity]:
        settings = self.settings
        finest, levels = settings.levels[-1].resolution, settings.kinds.hash_levels
        return capacities_at(level, finest, levels, self.space, occupancy, settings.degree)

    def resize(self, level: CapacityLevel) -> None:
        """Convert the current field to another capacity level, preserving it as far as that level can represent it."""
        # Seeded by the level, not by earlier draws, so that a resumed run repeats a trial from the same values.
        generator = np.random.default_rng([self.seed, 2, level.resolution])
        old = self.field
        grown = RadianceField(
            self.space,
            *grown_parts(old, *self._capacities(level, old.occupancy), generator),
            old.occupancy.resized(level.cells) if level.cells != old.occupancy.cells else old.occupancy,
            self.space.marching_step(level.resolution),
        )
        grown.occupancy.clear = self._clear_cells(level.cells)
        grown.occupancy.decide(grown.step)
        self.engine.adopt(grown)

    @property
    def _judges(self) -> str:
        return "held-out views" if self.held_out else "training views"

    @property
    def judging(self) -> bool:
        """Whether views are currently held out."""
        until = self.settings.held_out_until
        return self.held_out > 0 and self.progress < until and (until >= 1 or not self.state.decided)

    def held_out_psnr(self) -> float:
        """Return the PSNR over held-out rays (training rays if no view is held out), dB."""
        # Processes may differ in rounding, which could tip a decision, so all use the first one's number.
        return self.group.of_first(self.held_out_rays.psnr(self.engine.rendered))

    def balance(self, exposures: Exposures, quality: float) -> float:
        """Estimate by how many stops the photos differ and correct them; return the quality on the corrected photos.

        Earlier qualities are shifted by the difference, which would otherwise look like a loss or a gain.
        """
        first = self.state.stops is None
        before = np.zeros(len(self.dataset.cameras)) if first else np.array(self.state.stops)
        stops, unexplained = exposures.judged(self.engine.rendered, before)
        self.group.take_first(stops)
        if first:
            differ = f"photos differ in exposure by {stops.std():.2f} stops (standard deviation)"
            equal, clear = stops.std() < PLAINLY, self.group.of_first(unexplained) <= UNEXPLAINED
            if self.settings.exposure == "auto" and (equal or not clear):
                # Depth may become good enough to tell.
                self.state.stops = [] if equal or self.progress >= EXPOSURE_KNOWN else None
                return quality
            self.on_say(f"{differ}; correcting them to one exposure (--exposure off: do not)")
            self.state.decisions.append(f"{differ}: corrected to one")
        self._expose(stops.tolist())
        shift = self.held_out_psnr() - quality
        self.state.shift(shift)
        return quality + shift

    def _expose(self, stops: list[float]) -> None:
        self.state.stops = stops
        self.dataset.expose(np.array(stops))
        self.engine.follow_exposure()
        self.held_out_rays.choose()

    # -- one step ---------------------------------------------------------------------------------------------------

    @property
    def progress(self) -> float:
        """Spent fraction of the budget, 0..1."""
        s = self.settings
        return min(1.0, self.state.step / s.steps if s.steps else self.state.seconds / s.seconds)

    def step(self) -> float:
        """Take one optimization step; return its mean squared error."""
        settings, state = self.settings, self.state
        # Once per step, even if it is retried after running out of memory, so that processes do not differ.
        if state.step >= 16 and state.step % refresh_every(state.step) == 0 and self._refreshed_at != state.step:
            self._refreshed_at = state.step
            # All cells at first; later, with settled densities and many cells, every fourth from a random start.
            elapsed, state.refreshed_at = self.progress - state.refreshed_at, self.progress
            self.engine.refresh(self.seed + state.step, 1 if state.step < 300 else 4, elapsed)
        learned = self.engine.learn(self._batch())
        state.step += 1
        state.drawn += state.rays
        if learned.samples_per_ray > 0:  # else no step has finished yet
            state.rays = rays_for(settings.samples, learned.samples_per_ray, state.rays, self.engine.most_rays)
        return learned.error

    def _batch(self) -> Batch:
        """Return the next step."""
        among = len(self.dataset.cameras) - (self.held_out if self.judging else 0)
        return batch_at(self.progress, self.state, self.settings, among, self.dataset.channels)

    # -- the loop ---------------------------------------------------------------------------------------------------

    def run(self, on_step: Callable[["Fitter"], None] = lambda fitter: None, check_every: float = CHECK_EVERY) -> None:
        """Train until the budget is spent, calling `on_step` after every step.

        check_every: fraction of the budget between evaluations on the held-out views.
        """
        # Compilation takes longer than many steps and must not count as training time.
        self.warm_up()
        state = self.state
        next_check = (math.floor(self.progress / check_every) + 1) * check_every
        while self.progress < 1.0 and state.ended_at is None:
            begun, self.between_steps = time.perf_counter(), False
            try:
                error = self.step()
            except MemoryError:
                self._halve_parts()
                continue
            # One clock for all processes, since each decides by `progress` and all must decide alike.
            state.seconds += self.group.of_first(time.perf_counter() - begun)
            if not math.isfinite(error):
                self._roll_back("the loss is not finite")
            elif self.progress >= next_check or self._decision_due():
                self._check()
                next_check = (math.floor(self.progress / check_every) + 1) * check_every
            self.between_steps = True
            on_step(self)

    def _decision_due(self) -> bool:
        return self.search.growth_due(self.progress) or self.search.over(self.progress)

    def warm_up(self) -> None:
        """Compile all kernels that a step uses, for the ranks of all levels, without training."""
        self.warm_up_levels([*self.settings.levels, self.search.level])

    def warm_up_levels(self, levels: Iterable[CapacityLevel]) -> None:
        """Compile for these levels: kernels differ by ranks and, on a GPU, by the color's degree."""
        settings, generator, scratch = self.settings, np.random.default_rng(0), []
        kinds = {(level.density_rank, level.color_rank, min(level.degree, settings.degree)) for level in levels}
        if kinds <= self._warm:
            return
        for density_rank, color_rank, degree in kinds - self._warm:
            # Ranks are compile-time constants (decision 0001), but the resolution is not, so 8^3 suffices.
            capacities = self._capacities(CapacityLevel(8, density_rank, color_rank, 8, 8, degree))
            parts = first_parts(settings.kinds, *capacities, generator)
            scratch.append(RadianceField(self.space, *parts, OccupancyGrid(8), 1 / 8))
        self._warm |= kinds
        self.engine.warm_up(scratch, settings)

    def _halve_parts(self) -> None:
        self.state.parts *= 2
        if self.state.parts > 64:
            raise MemoryError("not even 1/64 of a batch fits in memory")
        self.engine.discard()
        self.on_say(f"out of memory: batches are now split into {self.state.parts} parts")

    def _check(self) -> None:
        state, search = self.state, self.search
        begun = time.perf_counter()
        # On a GPU, steps still in flight belong to the training before this evaluation, so their time counts here.
        self.engine.settle()
        state.seconds += self.group.of_first(time.perf_counter() - begun)
        self.engine.agree()
        begun = time.perf_counter()
        quality = self.held_out_psnr()
        self.checks, self.check_seconds = self.checks + 1, time.perf_counter() - begun
        # A loss this large is not noise: the fit is collapsing, and more training would make it worse.
        fallen = not min(state.best, ROUNDING_PSNR) - quality <= 2.0  # true for NaN
        judging = EXPOSURE_FROM <= self.progress <= self.settings.held_out_until and state.stops != []
        if self.exposures is not None and judging and not fallen and math.isfinite(quality):
            quality = self.balance(self.exposures, quality)
        state.curve.append(
            {
                "step": state.step,
                "seconds": round(state.seconds, 2),
                "psnr": round(quality, 3),
                "parameters": self.parameters,
                "held_out": self.judging,
            }
        )
        if fallen:
            self._roll_back(f"{self._judges} fell from {state.best:.1f} to {quality:.1f} dB")
            return
        self._note_quality(quality)
        if search.over(self.progress) and not search.extended(quality, self.parameters, self.progress):
            quality = self._judge(quality)
        if state.trial is None and quality >= state.best:
            state.best = quality
            self._keep()
        if search.growth_due(self.progress):
            if quality >= ROUNDING_PSNR and not self.settings.force_growth:
                self._stay(quality)
            else:
                self._grow(quality)
        while (pruning := search.pruning_due(self.progress)) is not None:
            quality = self._prune(pruning, quality)
        state.decided |= search.settled

    def _stay(self, quality: float) -> None:
        """End growth: the field is as precise as its photos."""
        self.state.growth_ended = True
        self.state.decisions.append(
            f"staying at {self.search.name(self.search.level)}: "
            f"{self._judges} match within the photos' rounding, {quality:.1f} dB"
        )

    def _grow(self, quality: float) -> None:
        """Start the trial of the next level."""
        self._keep()
        self.state.best = max(self.state.best, quality)
        self.resize(self.search.grow(quality, self.parameters, self.progress))

    def _judge(self, quality: float) -> float:
        """Keep or drop the level on trial; return the held-out quality of the resulting field."""
        state, before = self.state, self.search.trial.before
        kept, text = self.search.judge(quality, self.parameters)
        state.decisions.append(text)
        if kept:
            state.best = max(state.best, quality)
            self._note_quality(quality)
            self._keep()
            return quality
        self._go_back()
        self.on_say(text)
        return before

    def _prune(self, what: str, quality: float) -> float:
        """Prune a part of the field unless the views need it; return the held-out quality of the resulting field."""
        search, state, before = self.search, self.state, self.parameters
        self._keep()
        self.resize(search.pruned(what))
        reduced = self.held_out_psnr()
        kept, text = search.judge_pruning(what, quality, reduced, (before, self.parameters))
        state.decisions.append(text)
        if not kept:
            self._go_back()
            self.on_say(text)
            return quality
        # A rejected pruning is never trained, so its kernels need not be compiled.
        self.warm_up_levels([search.level])
        state.best = reduced
        self._note_quality(reduced)
        self._keep()
        return reduced

    def _roll_back(self, reason: str) -> None:
        state = self.state
        state.rollbacks += 1
        last = state.rollbacks > MOST_ROLLBACKS
        if self._anchor is None or (last and self.progress < USABLE_FROM):
            raise Diverged(f"{reason}, {state.rollbacks} times; try another seed, a smaller --rate, or check the poses")
        if state.trial is not None:
            self.search.end(kept=False)
        self._go_back()
        if last:
            state.ended_at = round(self.progress, 3)
            at = f"{state.ended_at:.0%} into the budget"
            text = f"{reason}, {state.rollbacks} times: stopping with the best field, {at}"
        else:
            state.rate_scale *= 0.5
            text = f"{reason}: rolling back to the best field, with half the learning rate"
        state.decisions.append(text)
        self.on_say(text)

    # -- snapshots --------------------------------------------------------------------------------------------------

    def _now(self) -> Snapshot:
        """Return a snapshot; the next step overwrites its arrays."""
        return Snapshot(self.field.describe(), self.field.arrays() | self.engine.moments())

    def _note_quality(self, quality: float) -> None:
        """Record the quality, dB, of held-out views or of views that are trained on."""
        if math.isfinite(quality):
            self.state.quality["held out" if self.judging else "trained on"] = round(quality, 3)

    def _go_back(self) -> None:
        """Restore the anchor and its quality."""
        assert self._anchor is not None
        self.state.quality = dict(self.state.anchor_quality)
        self._restore(self._anchor)

    def _keep(self) -> None:
        """Make the current field the anchor. The old anchor is freed first: memory may not suffice for both."""
        self.state.anchor_quality = dict(self.state.quality)
        self._anchor, now = None, self._now()
        self._anchor = Snapshot(now.field, {k: v.copy() for k, v in now.arrays.items()})

    def _restore(self, snapshot: Snapshot) -> None:
        arrays = {k: v.copy() for k, v in snapshot.arrays.items()}
        field = RadianceField.restore(snapshot.field, arrays)
        field.occupancy.clear = self._clear_cells(field.occupancy.cells)
        self.engine.adopt(field)
        self.engine.restore_moments(arrays)

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """Return (JSON, arrays) to resume from; the next step overwrites the arrays."""
        now = self._now()
        data = {"state": self.state.as_json(), "field": now.field}
        arrays = {f"now.{k}": v for k, v in now.arrays.items()}
        if self._anchor is not None:
            data["anchor"] = self._anchor.field
            arrays |= {f"anchor.{k}": v for k, v in self._anchor.arrays.items()}
        return data, arrays

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """Restore a checkpoint()."""
        self.state = FitState.from_json(data["state"])
        # The search holds a reference to the state, which has just been replaced.
        self.search.state = self.state
        if self.state.stops:
            # Checkpoints do not contain photos: correct them again, or the held-out PSNR would jump.
            self._expose(self.state.stops)
        self._restore(Snapshot.of(data["field"], arrays, "now."))
        if "anchor" in data:
            self._anchor = Snapshot.of(data["anchor"], arrays, "anchor.")
