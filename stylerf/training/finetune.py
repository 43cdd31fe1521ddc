"""Fine-tune a field on photos that carry an edit (LAENeRF, section 3.5): colours follow, density where it has to.

LAENeRF adds a depth term whose gradient its compositing discards; ours acts. The occupancy stays as it is: looked at
anew, it lost thin cells all over the scene (fox: background error 1.14 times that before the edit, else 1.05).
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stylerf.errors import Diverged
from stylerf.fields.field import RadianceField
from stylerf.fields.patch import PatchColour
from stylerf.fields.samples import Rays
from stylerf.rendering.rays import backward, render_rays
from stylerf.training.fit import SMOOTH_EVERY
from stylerf.training.optimiser import Adam
from stylerf.training.ranks import ALONE, Ranks
from stylerf.training.rays import RayBank


@dataclass(frozen=True)
class FineTuneSettings:
    """seconds: budget, or steps if > 0. rays: of a step. inside: share of them through edited pixels.

    rate: per step, of the colours and (times density_factor) of the density, falling to final_rate of itself;
    density_factor 0 keeps the shapes. depth_weight: of the squared difference of sum(w t) from the depth before the
    edit, in units of that depth, at edited pixels. background: level of grey behind the field. smoothness, even_from:
    as in FitSettings.
    """

    seconds: float = 60.0
    steps: int = 0
    rays: int = 6144
    inside: float = 0.4
    beside: float = 0.3
    rate: float = 5e-3
    density_factor: float = 0.3
    final_rate: float = 0.05
    depth_weight: float = 1e-3
    background: float = 1.0
    smoothness: float = 0.0
    even_from: float = 0.0


@dataclass
class FineTuneState:
    """Where the fine-tuning stands."""

    step: int = 0
    seconds: float = 0.0
    curve: list[dict] | None = None

    def __post_init__(self) -> None:
        self.curve = [] if self.curve is None else self.curve


@dataclass(frozen=True, eq=False)
class EditedPixels:
    """views, pixels [n]: edited pixels of the bank, by place of the view and row-major number. depth [n]: sum(w t) of

    their rays before the edit, scene units. beside: (views, pixels) of pixels around them that must stay.
    """

    views: np.ndarray
    pixels: np.ndarray
    depth: np.ndarray
    beside: tuple[np.ndarray, np.ndarray]


class FineTuner:
    """bank: all training views, edited. The field is changed in place.

    ranks: the processes that train it together; settings.rays are of all of them.
    """

    def __init__(
        self,
        field: RadianceField,
        bank: RayBank,
        edited: EditedPixels,
        settings: FineTuneSettings,
        seed: int,
        chunks: int,
        ranks: Ranks = ALONE,
    ) -> None:
        self.ranks = ranks
        self.field, self.bank, self.edited, self.settings = field, bank, edited, settings
        self.seed, self.chunks = seed, chunks
        self.state = FineTuneState()
        self.colour_adam = Adam(field.colour.values, field.colour.groups(), chunks)
        self.density_adam = Adam(field.density.values, field.density.groups(), chunks)
        self.between_steps = True

    @property
    def progress(self) -> float:
        """Used share of the budget, 0..1."""
        s = self.settings
        return min(1.0, self.state.step / s.steps if s.steps else self.state.seconds / s.seconds)

    @property
    def local(self) -> bool:
        """Whether all that learns is near the edit: rays far from it would tell nothing."""
        return isinstance(self.field.colour, PatchColour) and self.settings.density_factor == 0

    def _drawn(self) -> tuple[Rays, np.ndarray, np.ndarray, int]:
        """(this process's rays, their photos' colours [n, 4], which edited pixels come first, how many do in all).

        Edited pixels come first in a step, then those beside them, then any; a process takes its part of all.
        """
        s, generator = self.settings, np.random.default_rng([self.seed, 9, self.state.step])
        inside = min(round(s.rays * s.inside), s.rays) if len(self.edited.pixels) else 0
        chosen = generator.integers(0, max(1, len(self.edited.pixels)), inside)
        views, pixels = self.edited.beside
        beside = s.rays - inside if self.local else min(round(s.rays * s.beside), s.rays - inside)
        beside = beside if len(pixels) else 0
        around = generator.integers(0, max(1, len(pixels)), beside)
        own, others = self.ranks.own(s.rays), s.rays - inside - beside
        chosen, around = chosen[_overlap(own, 0, inside)], around[_overlap(own, inside, beside)]
        drawn = (
            self.bank.at(self.edited.views[chosen], self.edited.pixels[chosen]),
            self.bank.at(views[around], pixels[around]),
            self.bank.draw(others, generator, part=_overlap(own, s.rays - others, others))[:3],
        )
        origins, directions, colours = (np.concatenate(three) for three in zip(*drawn))
        jitter = generator.random(s.rays, dtype=np.float32)[own]
        return Rays.of(origins, directions, self.field.space.near, jitter), colours, chosen, inside

    def step(self) -> dict[str, float]:
        """One step; mean squared errors of colours outside and inside the edit, and of depths."""
        s, state = self.settings, self.state
        moving = s.density_factor > 0
        rays, colours, chosen, inside = self._drawn()
        rendered = render_rays(self.field, rays, chunks=self.chunks)
        out, level = rendered.out, np.float32(s.background)
        wanted = colours[:, :3] * colours[:, 3:] + (1 - colours[:, 3:]) * level
        difference = out[:, :3] + (1 - out[:, 3:4]) * level - wanted
        gradients = np.zeros_like(out)
        gradients[:, :3] = difference * np.float32(2 / (3 * s.rays))
        gradients[:, 3] = -level * gradients[:, :3].sum(1)
        if self.field.colour_map is not None:
            # The map comes after compositing: rgb' = A rgb + alpha b.
            matrix, offset = self.field.colour_map.matrix.numpy(), self.field.colour_map.offset.numpy()
            gradients[:, 3] += gradients[:, :3] @ offset.astype(np.float32)
            gradients[:, :3] = gradients[:, :3] @ matrix.astype(np.float32)
        depth_error, edited = 0.0, len(chosen)
        if edited and moving and s.depth_weight > 0:
            known = np.maximum(self.edited.depth[chosen], np.float32(1e-6))
            off = out[:edited, 4] / known - 1
            gradients[:edited, 4] = (2 * s.depth_weight / inside) * off / known
            depth_error = float(np.square(off).sum())
        density_to = self.density_adam.gradients if moving else None
        within = self.field.colour.marked if isinstance(self.field.colour, PatchColour) else None
        to = density_to, self.colour_adam.gradients
        backward(self.field, rendered, gradients, *to, even_from=s.even_from, density_within=within)
        if s.smoothness > 0 and self.ranks.first and state.step % SMOOTH_EVERY == 0:
            self.field.colour.smooth(SMOOTH_EVERY * s.smoothness, self.colour_adam.gradients[0])
            if moving:
                self.field.density.smooth(SMOOTH_EVERY * s.smoothness, self.density_adam.gradients[0])
        rate = s.rate * s.final_rate**self.progress
        self.ranks.add_gradients(self.colour_adam.gradients)
        if moving:
            self.ranks.add_gradients(self.density_adam.gradients)
        self.colour_adam.step(rate)
        if moving:
            self.density_adam.step(rate * s.density_factor)
        squares = np.square(difference).mean(1)
        sums = np.array([squares[edited:].sum(), squares[:edited].sum(), depth_error], np.float64)
        self.ranks.add(sums)
        of = np.maximum([s.rays - inside, inside, inside], 1)
        return dict(zip(("outside", "inside", "depth"), (sums / of).tolist(), strict=True))

    def run(self, on_step: Callable[["FineTuner"], None] = lambda tuner: None) -> None:
        """Until the budget is spent; on_step is told after every step."""
        state = self.state
        while self.progress < 1.0:
            begun, self.between_steps = time.perf_counter(), False
            parts = self.step()
            if not all(math.isfinite(value) for value in parts.values()):
                raise Diverged(f"step {state.step}: the loss left the finite numbers ({parts})")
            state.seconds += self.ranks.of_first(time.perf_counter() - begun)
            state.step += 1
            if state.step % 10 == 0:
                told = {name: float(f"{value:.4g}") for name, value in parts.items()}
                state.curve.append({"step": state.step, "seconds": round(state.seconds, 2), **told})
            self.between_steps = True
            on_step(self)

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) to go on from."""
        arrays = {f"field.{k}": v.copy() for k, v in self.field.arrays().items()}
        for name, adam in (("density", self.density_adam), ("colour", self.colour_adam)):
            arrays |= {f"{name}.{k}": v.copy() for k, v in adam.arrays().items()}
        return {"state": vars(self.state)}, arrays

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """From checkpoint()."""
        self.state = FineTuneState(**data["state"])
        for name, own in self.field.arrays().items():
            own[:] = arrays[f"field.{name}"]
        for name, adam in (("density", self.density_adam), ("colour", self.colour_adam)):
            adam.restore({k: arrays[f"{name}.{k}"] for k in ("first", "second", "steps")})


def _overlap(own: slice, begin: int, count: int) -> slice:
    """What of `count` rays, the first of which is number `begin` of a step, lies in `own`; counted from that first."""
    return slice(min(max(own.start - begin, 0), count), min(max(own.stop - begin, 0), count))
