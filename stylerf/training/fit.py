"""Fit a radiance field to posed images, no larger than held-out views ask for.

The field starts coarse and climbs a ladder of capacities. Each rung is a trial: if, when its share of the budget is
used up, held-out views have not gained `min_gain` dB over the rung before, the field goes back to that rung and spends
the rest of the budget there. Held-out views are taken from the training views, never from the test views, and are
trained on in the last part of the budget, when nothing is left to decide.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.capacity import Capacity
from stylerf.fields.field import RadianceField
from stylerf.fields.occupancy import Occupancy
from stylerf.geometry.space import Space
from stylerf.training.engine import Batch, CpuEngine, Engine, background_of
from stylerf.training.ladders import LADDER, Kinds, Rung, capacity_at, first_parts
from stylerf.training.ranks import ALONE, Ranks
from stylerf.training.rays import RayBank

LEAST_STEPS_PER_RUNG = 100
SMOOTH_EVERY = 8  # steps; the planes' total variation costs a third of a step, and is felt over hundreds of them
# An error of one step of an eight-bit photo. What lies beyond is rounding: no reason to grow, and no collapse to lose.
TELLING_PSNR = 20 * math.log10(255)


@dataclass(frozen=True)
class FitSettings:
    """How a field is fitted. kinds: what it is made of. Budget: seconds of training, or steps if `steps` > 0.

    samples: density samples a step; the number of rays follows, so that fog early on does not slow the steps down;
    rates in value units per step; smoothness: weights of the planes' total variation (density, colour); even_from:
    distance, scene units, below which samples learn by the square of their distance, against floaters (0: all alike);
    shares: parts of the budget at which the next rung is tried, at the latest after so many steps in all (`longest`,
    of every rung: what a coarse field is taught for longer is wrong); held_out_until: part of the budget from which the
    held-out views are trained on as well.
    """

    seconds: float = 300.0
    steps: int = 0
    samples: int = 90_000
    rate: float = 2e-2
    final_rate: float = 0.05
    degree: int = 1
    smoothness: tuple[float, float] = (0.0, 0.0)
    even_from: float = 0.0
    kinds: Kinds = field(default_factory=Kinds)
    ladder: tuple[Rung, ...] = LADDER
    shares: tuple[float, ...] = (0.12, 0.3, 0.55)
    longest: tuple[int, ...] = (350, 850, 1350, 2100)
    held_out_until: float = 0.75
    min_gain: float = 0.1
    background: str = "white"  # white, black, random or none
    lit_share: float = 0.9
    always_climb: bool = False  # take every rung whatever it gains


@dataclass
class FitState:
    """Everything a checkpoint holds beside the arrays."""

    step: int = 0
    seconds: float = 0.0
    rung: int = 0
    fixed: bool = False  # the ladder has been left: no more growth
    trial: float | None = None  # held-out dB before the rung on trial
    rate_scale: float = 1.0
    rollbacks: int = 0
    parts: int = 1
    rays: int = 1024
    best: float = -math.inf
    curve: list[dict] = field(default_factory=list)
    decisions: list[str] = field(default_factory=list)


def psnr_from_mse(mse: float) -> float:
    """-10 log10(mse), dB, for values in 0..1."""
    return -10.0 * math.log10(max(mse, 1e-12))


class Fitter:
    """The loop: `run()` trains until the budget is spent, calling `on_step` after every step.

    bank: training rays, the `held_out` last views kept for decisions. on_say: told of choices in words. ranks: the
    processes that train this field together; settings.samples are of all of them. engine: from (bank, seed, chunks, the
    first field, ranks); None: the CPU's.
    """

    def __init__(
        self,
        space: Space,
        bank: RayBank,
        held_out: int,
        settings: FitSettings,
        seed: int,
        chunks: int,
        on_say: Callable[[str], None] = lambda text: None,
        ranks: Ranks = ALONE,
        engine: Callable[[RayBank, int, int, RadianceField, Ranks], Engine] | None = None,
    ) -> None:
        self.space, self.bank, self.held_out, self.settings = space, bank, held_out, settings
        self.seed, self.chunks, self.on_say, self.ranks = seed, chunks, on_say, ranks
        self.state = FitState()
        rung, generator = settings.ladder[0], np.random.default_rng([seed, 1])
        first = RadianceField(
            space,
            *first_parts(settings.kinds, self._capacity(rung), settings.degree, generator),
            Occupancy(rung.cells),
            1.0 / rung.resolution,
        )
        self.engine = (engine or CpuEngine)(bank, seed, chunks, first, ranks)
        self._held_out_rays = self._choose_held_out()
        self._anchor: dict | None = None
        self._refreshed_at = -1
        self.between_steps = True

    # -- capacity ---------------------------------------------------------------------------------------------------

    @property
    def field(self) -> RadianceField:
        """The field as it now stands."""
        return self.engine.field

    @property
    def parameters(self) -> int:
        """Learnable numbers of the field; asks nothing of a device."""
        return self.engine.parameters

    def _capacity(self, rung: Rung, occupancy: Occupancy | None = None) -> Capacity:
        settings = self.settings
        return capacity_at(rung, settings.ladder[-1].resolution, settings.kinds.levels, self.space, occupancy)

    def _grow(self, rung: Rung) -> None:
        generator = np.random.default_rng([self.seed, 2, rung.resolution])
        old = self.field
        capacity = self._capacity(rung, old.occupancy)
        grown = RadianceField(
            self.space,
            old.density.grown(capacity, generator),
            old.colour.grown(capacity, generator),
            old.occupancy.resized(rung.cells) if rung.cells != old.occupancy.cells else old.occupancy,
            1.0 / rung.resolution,
        )
        grown.occupancy.decide(grown.step)
        self.engine.adopt(grown)

    def _choose_held_out(self):
        """At most 16,384 rays of the held-out views, or of all views where none is held out."""
        generator = np.random.default_rng([self.seed, 3])
        first = len(self.bank.cameras) - self.held_out if self.held_out else 0
        views = generator.integers(first, len(self.bank.cameras), 16384)
        pixels = (generator.random(len(views)) * self.bank.sizes[views]).astype(np.int64)
        return self.bank.at(views, pixels)

    @property
    def _judges(self) -> str:
        return "held-out views" if self.held_out else "training views"

    def held_out_psnr(self) -> float:
        """PSNR over the held-out rays (training rays where no view is held out), on the evaluation background, dB."""
        background = background_of(self.settings.background, len(self._held_out_rays[0]), None)
        total = self.engine.squared_error(*self._held_out_rays, background)
        return psnr_from_mse(total / (3 * len(background)))

    # -- one step ---------------------------------------------------------------------------------------------------

    @property
    def progress(self) -> float:
        """Used share of the budget, 0..1."""
        s = self.settings
        return min(1.0, self.state.step / s.steps if s.steps else self.state.seconds / s.seconds)

    def step(self) -> float:
        """One optimisation step; its mean squared error."""
        settings, state = self.settings, self.state
        # Once a step, however often lack of memory has it begun anew: processes must not differ in it.
        if state.step >= 16 and state.step % _refresh_every(state.step) == 0 and self._refreshed_at != state.step:
            self._refreshed_at = state.step
            self.engine.refresh(self.seed + state.step, 1 if state.step < 300 else 4)
        among = len(self.bank.cameras)
        if self.held_out and self.progress < settings.held_out_until:
            among -= self.held_out
        smoothing = SMOOTH_EVERY if state.step % SMOOTH_EVERY == 0 else 0
        learnt = self.engine.learn(
            Batch(
                step=state.step,
                rays=state.rays,
                parts=state.parts,
                among=among,
                lit_share=settings.lit_share,
                background=settings.background,
                rate=settings.rate * settings.final_rate**self.progress * state.rate_scale,
                smoothness=tuple(smoothing * weight for weight in settings.smoothness),
                even_from=settings.even_from,
            )
        )
        state.step += 1
        state.rays = _rays_for(settings.samples, learnt.live, state.rays, self.engine.most_rays)
        return learnt.error

    # -- the loop ---------------------------------------------------------------------------------------------------

    def run(self, on_step: Callable[["Fitter"], None] = lambda fitter: None, check_every: float = 0.04) -> None:
        """Train until the budget is spent. check_every: share of the budget between looks at the held-out views."""
        self.warm_up()
        state = self.state
        next_check = (math.floor(self.progress / check_every) + 1) * check_every
        while self.progress < 1.0:
            begun, self.between_steps = time.perf_counter(), False
            try:
                error = self.step()
            except MemoryError:
                self._halve_parts()
                continue
            state.seconds += self.ranks.of_first(time.perf_counter() - begun)
            if not math.isfinite(error):
                self._roll_back("the loss left the finite numbers")
            elif self.progress >= next_check or self._rung_due():
                self._check()
                next_check = (math.floor(self.progress / check_every) + 1) * check_every
            self.between_steps = True
            on_step(self)

    def warm_up(self) -> None:
        """Compile every kernel that a step uses, for every rank of the ladder, without learning anything."""
        settings, generator, scratch = self.settings, np.random.default_rng(0), []
        for density_rank, colour_rank in {(r.density_rank, r.colour_rank) for r in settings.ladder}:
            capacity = self._capacity(Rung(8, density_rank, colour_rank, 8, 8))
            parts = first_parts(settings.kinds, capacity, settings.degree, generator)
            scratch.append(RadianceField(self.space, *parts, Occupancy(8), 1 / 8))
        self.engine.warm_up(scratch, settings.smoothness, settings.even_from)

    def _halve_parts(self) -> None:
        self.state.parts *= 2
        if self.state.parts > 64:
            raise MemoryError("not even a sixty-fourth of a batch fits in memory")
        self.engine.discard()
        self.on_say(f"out of memory: batches are now worked off in {self.state.parts} parts")

    @property
    def _ripe(self) -> bool:
        """Whether the present rung has had its least steps."""
        return self.state.step >= LEAST_STEPS_PER_RUNG * (self.state.rung + 1)

    @property
    def _used_up(self) -> bool:
        """Whether the present rung has had its share of the budget, or as many steps as do it good."""
        rung, settings = self.state.rung, self.settings
        end = settings.shares[rung] if rung < len(settings.shares) else settings.held_out_until
        return self.progress >= end or (rung < len(settings.longest) and self.state.step >= settings.longest[rung])

    def _rung_due(self) -> bool:
        s, settings = self.state, self.settings
        last = min(len(settings.ladder) - 1, len(settings.shares))
        due = not s.fixed and self._ripe and s.rung < last and self._used_up
        # Views that are trained on decide nothing: a trial needs its least steps before that, unless it is none.
        left = (settings.held_out_until / max(self.progress, 1e-9) - 1) * s.step
        return due and (settings.always_climb or left >= LEAST_STEPS_PER_RUNG)

    def _check(self) -> None:
        state = self.state
        self.engine.agree()
        quality = self.held_out_psnr()
        state.curve.append(
            {
                "step": state.step,
                "seconds": round(state.seconds, 2),
                "psnr": round(quality, 3),
                "parameters": self.parameters,
                "held_out": self.held_out > 0 and self.progress < self.settings.held_out_until,
            }
        )
        # A fall this deep is no noise: the fit is on its way to a collapse, and more training would only deepen it.
        if not min(state.best, TELLING_PSNR) - quality <= 2.0:  # so written, NaN is a fall too
            self._roll_back(f"{self._judges} fell from {state.best:.1f} to {quality:.1f} dB")
            return
        if self._trial_over():
            quality = self._judge(quality)
        if state.trial is None and quality >= state.best:
            state.best = quality
            self._anchor = self._snapshot()
        if self._rung_due():
            if quality >= TELLING_PSNR and not self.settings.always_climb:
                self._stay(quality)
            else:
                self._try_next(quality)

    def _trial_over(self) -> bool:
        if self.state.trial is None:
            return False
        return (self._ripe and self._used_up) or self.progress >= self.settings.held_out_until

    def _stay(self, quality: float) -> None:
        """Leave the ladder: the field is as exact as its photos."""
        self.state.fixed = True
        here = self.settings.ladder[self.state.rung].resolution
        self.state.decisions.append(
            f"staying at {here}^3: held-out views are met within the photos' rounding, {quality:.1f} dB"
        )

    def _try_next(self, quality: float) -> None:
        state = self.state
        self._anchor = self._snapshot()
        state.best = max(state.best, quality)
        state.trial, state.rung = quality, state.rung + 1
        self._grow(self.settings.ladder[state.rung])

    def _judge(self, quality: float) -> float:
        """Keep or drop the rung on trial; the held-out quality of the field that stands."""
        state, before = self.state, self.state.trial
        gain = quality - before
        new, old = (self.settings.ladder[state.rung - i] for i in (0, 1))
        state.trial = None
        if gain >= self.settings.min_gain or self.settings.always_climb:
            state.decisions.append(
                f"{new.resolution}^3 kept: {self._judges} gained {gain:.2f} dB over {old.resolution}^3"
            )
            state.best = max(state.best, quality)
            self._anchor = self._snapshot()
            return quality
        parameters = self.parameters
        self._restore(self._anchor)
        state.rung, state.fixed = state.rung - 1, True
        text = (
            f"{new.resolution}^3 dropped: {gain:+.2f} dB for {parameters / self.parameters:.1f} times the size; "
            f"staying at {old.resolution}^3"
        )
        state.decisions.append(text)
        self.on_say(text)
        return before

    def _roll_back(self, reason: str) -> None:
        state = self.state
        state.rollbacks += 1
        if self._anchor is None or state.rollbacks > 4:
            raise Diverged(f"{reason}, {state.rollbacks} times; try another seed, a smaller rate or check the poses")
        if state.trial is not None:
            state.trial, state.rung, state.fixed = None, state.rung - 1, True
        self._restore(self._anchor)
        state.rate_scale *= 0.5
        text = f"{reason}: back to the best field so far, with half the learning rate"
        state.decisions.append(text)
        self.on_say(text)

    # -- snapshots --------------------------------------------------------------------------------------------------

    def _snapshot(self) -> dict:
        field = self.field
        arrays = {k: v.copy() for k, v in (field.arrays() | self.engine.moments()).items()}
        return {"field": field.describe(), "arrays": arrays}

    def _restore(self, snapshot: dict) -> None:
        arrays = {k: v.copy() for k, v in snapshot["arrays"].items()}
        self.engine.adopt(RadianceField.restore(snapshot["field"], arrays))
        self.engine.restore_moments(arrays)

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) from which `resume` goes on exactly as if nothing had happened."""
        now = self._snapshot()
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
