"""Fit a radiance field to posed images, no larger than held-out views ask for.

The field starts coarse and climbs a ladder of capacities. Each rung is a trial: if, when its share of the budget is
used up, held-out views have not gained `min_gain` dB over the rung before, the field goes back to that rung and stays
there. When the ladder has ended, what the views do not miss is given up again (capacity_search.py decides). Held-out
views are taken from the training views, never from the test views, and are trained on as well as soon as nothing is
left to decide, in the last part of the budget at the latest.
"""

import itertools
import math
import time
from collections.abc import Callable, Iterable

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.capacity import Capacity
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.training.common.adam import SMOOTH_EVERY
from stylerf.training.common.pixels import psnr_from_mse
from stylerf.training.common.process_group import ALONE, ProcessGroup
from stylerf.training.common.ray_dataset import RayDataset, shown_rays
from stylerf.training.fit.capacity_levels import CapacityLevel, capacity_at, first_parts
from stylerf.training.fit.capacity_search import GROW, TELLING_PSNR, CapacitySearch
from stylerf.training.fit.engine import Batch, CpuEngine, Engine, background_of, over, target
from stylerf.training.fit.exposure import FEWEST_PHOTOS, PLAINLY, Exposures
from stylerf.training.fit.settings import FitSettings, FitState
from stylerf.training.fit.visual_hull import clear_cells

EXPOSED_FROM = 0.1  # of the budget: before, a field is brighter or darker than its photos for other reasons
MOST_ROLLBACKS = 4
SOUND_FROM = 0.5  # of the budget: from here on the best field so far is worth more than none


class Fitter:
    """The loop: `run()` trains until the budget is spent, calling `on_step` after every step.

    bank: training rays, the `held_out` last views kept for decisions. on_say: told of choices in words. ranks: the
    processes that train this field together; settings.samples are of all of them. engine: from (bank, seed, chunks, the
    first field, ranks); None: the CPU's.
    """

    def __init__(
        self,
        space: SpaceWarp,
        bank: RayDataset,
        held_out: int,
        settings: FitSettings,
        seed: int,
        chunks: int,
        on_say: Callable[[str], None] = lambda text: None,
        ranks: ProcessGroup = ALONE,
        engine: Callable[[RayDataset, int, int, RadianceField, ProcessGroup], Engine] | None = None,
    ) -> None:
        self.space, self.bank, self.held_out, self.settings = space, bank, held_out, settings
        self.seed, self.chunks, self.on_say, self.ranks = seed, chunks, on_say, ranks
        self.state = FitState()
        self.climb = CapacitySearch(settings, self.state, self._judges)
        self._warm: set[tuple[int, int, int]] = set()
        rung, generator = settings.ladder[0], np.random.default_rng([seed, 1])
        self._clear: dict[int, np.ndarray | None] = {}
        first = RadianceField(
            space,
            *first_parts(settings.kinds, self._capacity(rung), generator),
            OccupancyGrid(rung.cells, clear=self._clear_cells(rung.cells)),
            1.0 / rung.resolution,
        )
        self.engine = (engine or CpuEngine)(bank, seed, chunks, first, ranks)
        self._held_out_rays = self._choose_held_out()
        enough = settings.exposure == "on" or (settings.exposure == "auto" and len(bank.cameras) >= FEWEST_PHOTOS)
        self.exposures = Exposures(bank, seed) if enough else None
        self._anchor: dict | None = None
        self._refreshed_at = -1
        self.between_steps = True

    def _clear_cells(self, cells: int) -> np.ndarray | None:
        """Cells that the training views show to be empty, where they are cut out by transparency."""
        if self.settings.hull <= 0 or self.space.kind != "box" or self.bank.channels != 4:
            return None
        if cells not in self._clear:
            cameras = self.bank.cameras[: len(self.bank.cameras) - self.held_out]
            alphas = itertools.islice(self.bank.alphas(), len(cameras))
            self._clear[cells] = clear_cells(cameras, alphas, self.space, cells, self.settings.hull, self.chunks)
        return self._clear[cells]

    # -- capacity ---------------------------------------------------------------------------------------------------

    @property
    def field(self) -> RadianceField:
        """The field as it now stands."""
        return self.engine.field

    @property
    def parameters(self) -> int:
        """Learnable numbers of the field; asks nothing of a device."""
        return self.engine.parameters

    def _capacity(self, rung: CapacityLevel, occupancy: OccupancyGrid | None = None) -> Capacity:
        settings = self.settings
        finest, levels = settings.ladder[-1].resolution, settings.kinds.levels
        return capacity_at(rung, finest, levels, self.space, occupancy, settings.degree)

    def _resize(self, rung: CapacityLevel) -> None:
        generator = np.random.default_rng([self.seed, 2, rung.resolution])
        old = self.field
        capacity = self._capacity(rung, old.occupancy)
        grown = RadianceField(
            self.space,
            old.density.grown(capacity, generator),
            old.color.grown(self._capacity(rung.color, old.occupancy), generator),
            old.occupancy.resized(rung.cells) if rung.cells != old.occupancy.cells else old.occupancy,
            1.0 / rung.resolution,
        )
        grown.occupancy.clear = self._clear_cells(rung.cells)
        grown.occupancy.decide(grown.step)
        self.engine.adopt(grown)

    def _choose_held_out(self):
        """At most 16,384 rays of the held-out views, or of all views where none is held out."""
        generator = np.random.default_rng([self.seed, 3])
        first = len(self.bank.cameras) - self.held_out if self.held_out else 0
        views = generator.integers(first, len(self.bank.cameras), 16384)
        pixels = (generator.random(len(views)) * self.bank.sizes[views]).astype(np.int64)
        chosen = self.bank.at(views, pixels)
        return chosen if self.space.kind == "box" else shown_rays(*chosen)

    @property
    def _judges(self) -> str:
        return "held-out views" if self.held_out else "training views"

    @property
    def _judging(self) -> bool:
        """Whether views are kept aside now."""
        until = self.settings.held_out_until
        return self.held_out > 0 and self.progress < until and (until >= 1 or not self.state.decided)

    def held_out_psnr(self) -> float:
        """PSNR over the held-out rays (training rays where no view is held out), dB.

        An object cut out by transparency is judged before colors drawn at random: a white one that is missing before
        white would pass for found.
        """
        kind = "random" if self.bank.channels == 4 else self.settings.background
        origins, directions, colors = self._held_out_rays
        background = background_of(kind, len(origins), np.random.default_rng([self.seed, 4]))
        out = self.engine.rendered(origins, directions)
        error = np.clip(over(out[:, :3], out[:, 3:4], background) - target(colors, background), -1, 1)
        return psnr_from_mse(self.ranks.of_first(float(np.square(error).mean(dtype=np.float64))))

    def _balance(self, quality: float) -> float:
        """Judge anew by how many stops photos differ, and take them for what they then show.

        From the held-out quality to that on the photos as they then are. What was measured on other photos is brought
        to these: else a new look would pass for a fall, or a gain.
        """
        first = self.state.stops is None
        before = np.zeros(len(self.bank.cameras)) if first else np.array(self.state.stops)
        stops = self.exposures.judged(self.engine.rendered, before)
        self.ranks.take_first(stops)
        if first:
            differ = f"photos differ in exposure by {stops.std():.2f} stops (standard deviation)"
            if self.settings.exposure == "auto" and stops.std() < PLAINLY:
                self.state.stops = []
                return quality
            self.on_say(f"{differ}: they are brought to one; --exposure off takes them as they are")
            self.state.decisions.append(f"{differ}: brought to one")
        self._expose(stops.tolist())
        shift = self.held_out_psnr() - quality
        self.state.best += shift
        for known in (self.state.stands, self.state.anchored):
            known.update({views: round(value + shift, 3) for views, value in known.items()})
        if self.state.whole is not None:
            self.state.whole += shift
        if self.state.trial is not None:
            self.state.trial["before"] += shift
        return quality + shift

    def _expose(self, stops: list[float]) -> None:
        self.state.stops = stops
        self.bank.expose(np.array(stops))
        self.engine.follow_exposure()
        self._held_out_rays = self._choose_held_out()

    # -- one step ---------------------------------------------------------------------------------------------------

    @property
    def progress(self) -> float:
        """Used share of the budget, 0..1."""
        s = self.settings
        return min(1.0, self.state.step / s.steps if s.steps else self.state.seconds / s.seconds)

    def step(self) -> float:
        """One optimization step; its mean squared error."""
        settings, state = self.settings, self.state
        # Once a step, however often lack of memory has it begun anew: processes must not differ in it.
        if state.step >= 16 and state.step % _refresh_every(state.step) == 0 and self._refreshed_at != state.step:
            self._refreshed_at = state.step
            self.engine.refresh(self.seed + state.step, 1 if state.step < 300 else 4)
        among = len(self.bank.cameras)
        if self._judging:
            among -= self.held_out
        smoothing = SMOOTH_EVERY if state.step % SMOOTH_EVERY == 0 else 0
        learned = self.engine.learn(
            Batch(
                step=state.step,
                rays=state.rays,
                parts=state.parts,
                among=among,
                lit_share=settings.lit_share,
                background=settings.background,
                rate=settings.rate * settings.final_rate**self.progress * state.rate_scale * self.climb.rate,
                smoothness=tuple(smoothing * weight for weight in settings.smoothness),
                even_from=settings.even_from,
                coverage=settings.coverage if self.bank.channels == 4 else 0.0,
                opacity=settings.opacity * max(0.0, (self.progress - 0.25) / 0.75),
            )
        )
        state.step += 1
        if learned.live > 0:  # else no step has been told of yet
            state.rays = _rays_for(settings.samples, learned.live, state.rays, self.engine.most_rays)
        return learned.error

    # -- the loop ---------------------------------------------------------------------------------------------------

    def run(self, on_step: Callable[["Fitter"], None] = lambda fitter: None, check_every: float = 0.04) -> None:
        """Train until the budget is spent. check_every: share of the budget between looks at the held-out views."""
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
            state.seconds += self.ranks.of_first(time.perf_counter() - begun)
            if not math.isfinite(error):
                self._roll_back("the loss left the finite numbers")
            elif self.progress >= next_check or self.climb.rung_due(self.progress) or self.climb.over(self.progress):
                self._check()
                next_check = (math.floor(self.progress / check_every) + 1) * check_every
            self.between_steps = True
            on_step(self)

    def warm_up(self) -> None:
        """Compile every kernel that a step uses, for every rank of the ladder, without learning anything."""
        self._warm_up([*self.settings.ladder, self.climb.rung])

    def _warm_up(self, rungs: Iterable[CapacityLevel]) -> None:
        """Kernels differ by ranks and, on a GPU, by the color's degree."""
        settings, generator, scratch = self.settings, np.random.default_rng(0), []
        kinds = {(rung.density_rank, rung.color_rank, min(rung.degree, settings.degree)) for rung in rungs}
        if kinds <= self._warm:
            return
        for density_rank, color_rank, degree in kinds - self._warm:
            capacity = self._capacity(CapacityLevel(8, density_rank, color_rank, 8, 8, degree))
            parts = first_parts(settings.kinds, capacity, generator)
            scratch.append(RadianceField(self.space, *parts, OccupancyGrid(8), 1 / 8))
        self._warm |= kinds
        self.engine.warm_up(scratch, settings.smoothness, settings.even_from)

    def _halve_parts(self) -> None:
        self.state.parts *= 2
        if self.state.parts > 64:
            raise MemoryError("not even a sixty-fourth of a batch fits in memory")
        self.engine.discard()
        self.on_say(f"out of memory: batches are now worked off in {self.state.parts} parts")

    def _check(self) -> None:
        state, climb = self.state, self.climb
        begun = time.perf_counter()
        self.engine.settle()
        state.seconds += self.ranks.of_first(time.perf_counter() - begun)
        self.engine.agree()
        quality = self.held_out_psnr()
        recovering = state.trial is not None and state.trial["what"] != GROW
        # A fall this deep is no noise: the fit is on its way to a collapse, and more training would only deepen it.
        fallen = not min(state.best, TELLING_PSNR) - quality <= 2.0 and not recovering  # so written, NaN is a fall too
        judging = self.exposures is not None and state.stops != [] and not fallen and math.isfinite(quality)
        if judging and EXPOSED_FROM <= self.progress <= self.settings.held_out_until:
            quality = self._balance(quality)
        state.curve.append(
            {
                "step": state.step,
                "seconds": round(state.seconds, 2),
                "psnr": round(quality, 3),
                "parameters": self.parameters,
                "held_out": self._judging,
            }
        )
        if fallen:
            self._roll_back(f"{self._judges} fell from {state.best:.1f} to {quality:.1f} dB")
            return
        self._stands(quality)
        if climb.over(self.progress) and not climb.prolonged(quality, self.parameters, self.progress):
            quality = self._judge(quality)
        if state.trial is None and quality >= state.best:
            state.best = quality
            self._keep()
        if climb.rung_due(self.progress):
            if quality >= TELLING_PSNR and not self.settings.always_climb:
                self._stay(quality)
            else:
                self._try(GROW, quality)
        while (reduction := climb.reduction_due(self.progress)) is not None:
            self._try(reduction, quality)
            reduced = self.held_out_psnr()
            # What is refused at once is never taught, and what teaches it need not be compiled.
            if climb.enough(reduced) or not climb.hopeless(reduced):
                self._warm_up([climb.rung])
                if not climb.enough(reduced):
                    break  # a while of teaching decides
            quality = self._judge(reduced)
        state.decided |= climb.settled

    def _stay(self, quality: float) -> None:
        """Leave the ladder: the field is as exact as its photos."""
        self.state.fixed = True
        self.state.decisions.append(
            f"staying at {self.climb.name(self.climb.rung)}: "
            f"{self._judges} are met within the photos' rounding, {quality:.1f} dB"
        )

    def _try(self, what: str, quality: float) -> None:
        self._keep()
        self.state.best = max(self.state.best, quality)
        self._resize(self.climb.begin(what, quality, self.parameters, self.progress))

    def _judge(self, quality: float) -> float:
        """Keep or drop what is on trial; the held-out quality of the field that stands."""
        state, before = self.state, self.state.trial["before"]
        reduced = state.trial["what"] != GROW
        kept, text = self.climb.judge(quality, self.parameters)
        state.decisions.append(text)
        if kept:
            state.best = quality if reduced else max(state.best, quality)
            self._stands(quality)
            self._keep()
            return quality
        self._go_back()
        self.on_say(text)
        return before

    def _roll_back(self, reason: str) -> None:
        state = self.state
        state.rollbacks += 1
        last = state.rollbacks > MOST_ROLLBACKS
        if self._anchor is None or (last and self.progress < SOUND_FROM):
            raise Diverged(f"{reason}, {state.rollbacks} times; try another seed, a smaller rate or check the poses")
        if state.trial is not None:
            self.climb.end(kept=False)
        self._go_back()
        if last:
            state.ended_at = round(self.progress, 3)
            text = f"{reason}, {state.rollbacks} times: ended with the best field, {state.ended_at:.0%} into the budget"
        else:
            state.rate_scale *= 0.5
            text = f"{reason}: back to the best field so far, with half the learning rate"
        state.decisions.append(text)
        self.on_say(text)

    # -- snapshots --------------------------------------------------------------------------------------------------

    def _now(self) -> dict:
        """As it stands: the next step writes to these very arrays."""
        return {"field": self.field.describe(), "arrays": self.field.arrays() | self.engine.moments()}

    def _stands(self, quality: float) -> None:
        """Note the quality, dB, of the field that stands: of views that are kept aside, or of those it is taught."""
        if math.isfinite(quality):
            self.state.stands["held out" if self._judging else "trained on"] = round(quality, 3)

    def _go_back(self) -> None:
        """To the anchor, and to its quality."""
        self.state.stands = dict(self.state.anchored)
        self._restore(self._anchor)

    def _keep(self) -> None:
        """Make what stands the anchor; what was goes first, so that there is never memory for both."""
        self.state.anchored = dict(self.state.stands)
        self._anchor, now = None, self._now()
        self._anchor = now | {"arrays": {k: v.copy() for k, v in now["arrays"].items()}}

    def _restore(self, snapshot: dict) -> None:
        arrays = {k: v.copy() for k, v in snapshot["arrays"].items()}
        field = RadianceField.restore(snapshot["field"], arrays)
        field.occupancy.clear = self._clear_cells(field.occupancy.cells)
        self.engine.adopt(field)
        self.engine.restore_moments(arrays)

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) from which `resume` goes on as if nothing had happened; the next step changes the arrays."""
        now = self._now()
        data = {"state": vars(self.state) | {"best": _finite(self.state.best)}, "field": now["field"]}
        arrays = {f"now.{k}": v for k, v in now["arrays"].items()}
        if self._anchor is not None:
            data["anchor"] = self._anchor["field"]
            arrays |= {f"anchor.{k}": v for k, v in self._anchor["arrays"].items()}
        return data, arrays

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """From checkpoint()."""
        state = dict(data["state"])
        state["best"] = -math.inf if state["best"] is None else state["best"]
        self.state = FitState(**state)
        self.climb.state = self.state
        if self.state.stops:
            self._expose(self.state.stops)
        now = {k.removeprefix("now."): v for k, v in arrays.items() if k.startswith("now.")}
        self._restore({"field": data["field"], "arrays": now})
        if "anchor" in data:
            kept = {k.removeprefix("anchor."): v for k, v in arrays.items() if k.startswith("anchor.")}
            self._anchor = {"field": data["anchor"], "arrays": kept}


def _rays_for(samples: int, live: float, before: int, most: int) -> int:
    """Rays of the next step: as many as bring `samples` samples at `live` a ray, moving slowly, 256 to `most`."""
    wanted = samples / max(live, 1.0)
    return int(np.clip(0.8 * before + 0.2 * wanted, 256, most))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _refresh_every(step: int) -> int:
    return 8 if step < 64 else 16 if step < 300 else 64
