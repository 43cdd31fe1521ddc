"""Train a region's palette module on the views that show it, with or without a style image (LAENeRF).

Phases: palette (colors and their mixing, on the photos); style (with a style image: the same plus the image losses);
pruned (after removing colors that hardly contribute); done.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import torch
from torch import Tensor

from stylerf import validation
from stylerf.editing import palette_losses
from stylerf.editing.extraction import EditView
from stylerf.editing.palette_losses import EditWeights, Neighbors, figures_of, kept_colors, shares_of
from stylerf.editing.palette_module import (
    MOST_COLORS,
    Mixture,
    PaletteEvaluator,
    PaletteModule,
    box_around,
    clustered_palette,
    random_palette,
)
from stylerf.editing.region_style import Canvas, RegionStyle
from stylerf.errors import Diverged, InvalidValue
from stylerf.style.color_matching import in_colors_of
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.training.common.even_draws import drawn_evenly
from stylerf.training.edit.engine import CpuEditEngine

if TYPE_CHECKING:
    from stylerf.training.edit.engine_gpu import GpuEditEngine

EditEngine: TypeAlias = "CpuEditEngine | GpuEditEngine"

SAMPLED_COLORS = 20_000  # pixels of the region from which the initial palette and the mean color are computed
# Fractions of `seconds` for the phases.
TIME = {"recolor": {"palette": 0.75, "pruned": 0.25}, "style": {"palette": 0.2, "style": 0.55, "pruned": 0.25}}


@dataclass(frozen=True)
class EditSettings:
    """Settings of an edit.

    Attributes:
        colors, max_colors: Initial number of palette colors, and maximum after pruning.
        palette: Initial colors: clusters, or random (LAENeRF). For four shaded colors, clusters end up with these four
            and L_sp 0.1, random ones with six and 0.5.
        palette_steps, style_steps, pruned_steps, pruned_style_steps: Steps of each phase.
        seconds: Time limit for all phases, 0 for none; the result depends on the clock only if the limit is reached.
        pixels: Pixels per step without a style image.
        rate, table_rate: Learning rates of networks (palette: twice that) and table; decay by the factor `final_rate`.
        style_side, stroke: See RegionStyle.
        keep_colors: First transfer the region's mean color and covariance to the style image.
    """

    colors: int = 8
    palette: str = "clusters"
    max_colors: int = 8
    palette_steps: int = 300
    style_steps: int = 100
    pruned_steps: int = 100
    pruned_style_steps: int = 40
    seconds: float = 0.0
    pixels: int = 8192
    rate: float = 5e-3
    table_rate: float = 1e-2
    final_rate: float = 0.1
    weights: EditWeights = field(default_factory=EditWeights)
    style_side: int = 128
    stroke: float = 1.0
    keep_colors: bool = False

    def __post_init__(self) -> None:
        if not 1 <= self.max_colors <= self.colors <= MOST_COLORS:
            most = f"at most {self.max_colors} after pruning"
            raise InvalidValue(f"palette: {self.colors} colors (1..{MOST_COLORS}), {most}")
        if self.palette not in ("clusters", "random"):
            raise InvalidValue(f"palette: expected clusters or random, found {self.palette!r}")


@dataclass
class EditState:
    """Progress of an edit. seconds: in the current phase; spent: in earlier phases."""

    phase: str = "palette"
    step: int = 0
    seconds: float = 0.0
    spent: dict[str, float] = field(default_factory=dict)
    curve: list[dict] = field(default_factory=list)


def start_module(views: list[EditView], settings: EditSettings, seed: int) -> PaletteModule:
    """Return a module for the region in the views, with its initial palette."""
    generator = np.random.default_rng([seed, 1])
    box = box_around(np.concatenate([view.x for view in views]))
    if settings.palette == "random":
        palette = random_palette(generator, settings.colors)
    else:
        palette = clustered_palette(generator, sampled_colors(views, generator), settings.colors)
    return PaletteModule.create(generator, palette, box)


def sampled_colors(views: list[EditView], generator: np.random.Generator) -> np.ndarray:
    """Return a sample of the region's colors in the photos, [up to SAMPLED_COLORS, 3]."""
    colors = np.concatenate([view.target for view in views])
    if len(colors) <= SAMPLED_COLORS:
        return colors
    return colors[generator.integers(0, len(colors), SAMPLED_COLORS)]


class EditTrainer:
    """Trains a module in place.

    Args:
        module: From start_module().
        style: Style image [3 or 4, h, w], or a crop of it, sRGB 0..1, with an extractor; None to recolor.
        engine: Where to train, on the extractor's device (training/backends.py). All engines see the same pixels.

    Raises:
        InvalidValue: No view shows any part of the region.
    """

    def __init__(
        self,
        views: list[EditView],
        module: PaletteModule,
        settings: EditSettings,
        style: Tensor | None,
        extractor: FeatureExtractor | None,
        seed: int,
        threads: int,
        engine: Callable[..., EditEngine] = CpuEditEngine,
    ) -> None:
        self.views = [view for view in views if len(view)]
        if not self.views:
            raise InvalidValue("no view shows any part of the region: there is nothing to learn from")
        if (style is None) != (extractor is None):
            raise InvalidValue("a style image needs a feature extractor, and vice versa")
        self._module, self.settings, self.seed, self.threads = module, settings, seed, threads
        self.style: RegionStyle | None = None
        if style is not None and extractor is not None:
            if settings.keep_colors:
                colors = sampled_colors(self.views, np.random.default_rng([seed, 6]))
                style = in_colors_of(style, torch.from_numpy(colors))
            self.style = RegionStyle(extractor, style, settings.style_side, settings.stroke)
        self.engine = engine(self.views, module, threads)
        self.state = EditState()
        self._pictured: dict[int, tuple[Neighbors, Canvas, Tensor]] = {}
        self.between_steps = True

    @property
    def module(self) -> PaletteModule:
        """The current module, with its arrays up to date."""
        self.engine.collect()
        return self._module

    @property
    def evaluator(self) -> PaletteEvaluator:
        """Evaluates the current module on the engine's device."""
        return self.engine.evaluator

    # -- steps ------------------------------------------------------------------------------------------------------

    def _steps(self) -> dict[str, int]:
        """Return the number of steps of each phase, in order."""
        s = self.settings
        if self.style is None:
            return {"palette": s.palette_steps, "pruned": s.pruned_steps}
        return {"palette": s.palette_steps, "style": s.style_steps, "pruned": s.pruned_style_steps}

    @property
    def progress(self) -> float:
        """Completed fraction of the current phase, 0..1."""
        phase, seconds = self.state.phase, self.settings.seconds
        if phase == "done":
            return 1.0
        steps = self._steps()[phase]
        done = self.state.step / steps if steps else 1.0
        if seconds > 0:
            share = TIME["recolor" if self.style is None else "style"][phase]
            done = max(done, self.state.seconds / (seconds * share))
        return min(1.0, done)

    @property
    def whole_progress(self) -> float:
        """Completed fraction of all steps, 0..1."""
        steps, done = self._steps(), 0.0
        for phase, count in steps.items():
            if phase == self.state.phase:
                return (done + self.progress * count) / max(1, sum(steps.values()))
            done += count
        return 1.0

    def step(self) -> dict[str, float]:
        """Take one step on one view; return the parts of the loss."""
        number = list(self._steps()).index(self.state.phase)
        # Seeded by phase and step, so that a resumed run draws the same numbers.
        generator = np.random.default_rng([self.seed, 3, number, self.state.step])
        at = self.view_of_step(number)
        view, style = self.views[at], None if self.state.phase == "palette" else self.style
        rows = np.arange(len(view))
        # Image losses need every pixel of the view; for per-pixel losses, a sample suffices.
        if style is None and len(view) > self.settings.pixels:
            rows = drawn_evenly(self.settings.pixels, len(view), generator)
        # LAENeRF's jitter: each ray ends at a random depth within what it sees.
        jitter = (generator.random((len(rows), 1)) - 0.5).astype(np.float32)
        phi, basis, target = self.engine.pixels(at, rows, jitter)
        values = self.engine.leaf()
        mixture = self._module.mix(values, phi, basis, self.engine.kept)
        parts = self._of_pixels(mixture, target, self._module.palette_of(values))
        if style is not None:
            parts |= self._of_picture(style, at, mixture.colors, target)
        # Parts with weight 0 are left out of the graph.
        weights = {name: getattr(self.settings.weights, name) for name in parts}
        parts = {name: part for name, part in parts.items() if weights[name]}
        sum(weights[name] * part for name, part in parts.items()).backward()
        # A single decay over all phases, so that the rate does not jump when a phase begins.
        decay = self.settings.final_rate**self.whole_progress
        assert values.grad is not None
        self.engine.step(values.grad, self.settings.rate * decay, self.settings.table_rate * decay)
        return self.engine.report(parts)

    def view_of_step(self, number: int) -> int:
        """Return the step's view; each epoch visits every view once, in a new order."""
        epoch, at = divmod(self.state.step, len(self.views))
        return int(np.random.default_rng([self.seed, 2, number, epoch]).permutation(len(self.views))[at])

    def _of_pixels(self, mixture: Mixture, target: Tensor, palette: Tensor) -> dict[str, Tensor]:
        parts = {
            "reconstruction": palette_losses.reconstruction(mixture.colors, target).mean(),
            "certainty": palette_losses.uncertainty(mixture.weights).mean(),
            "offset": palette_losses.offset_size(mixture.offsets).mean(),
            "valid": palette_losses.outside_gamut(palette),
        }
        if self.settings.weights.uniform:
            parts["uniform"] = palette_losses.largest_share(mixture.weights)
        if self.settings.weights.distinct:
            kept = self.engine.kept
            active = torch.from_numpy(np.flatnonzero(self._module.active)) if kept is None else kept
            parts["distinct"] = palette_losses.likeness(palette[active])
        return parts

    def _of_picture(self, style: RegionStyle, at: int, colors: Tensor, target: Tensor) -> dict[str, Tensor]:
        if at not in self._pictured:
            view, device = self.views[at], self.engine.device
            transition = torch.from_numpy(view.transition).to(device)
            self._pictured[at] = Neighbors.of(view, device), style.canvas(view), transition
        neighbors, canvas, transition = self._pictured[at]
        differences = neighbors.differences(colors)
        return {
            "style": style.distance(colors, canvas),
            "variation": palette_losses.variation(differences, neighbors),
            "edges": palette_losses.edge_contrast(differences, neighbors),
            "smooth": palette_losses.transition_error(colors, target, transition).mean(),
        }

    # -- the loop ---------------------------------------------------------------------------------------------------

    def run(self, on_step: Callable[["EditTrainer"], None] = lambda trainer: None) -> None:
        """Run all phases, calling on_step after every step."""
        state = self.state
        while state.phase != "done":
            # A process's first step of a phase compiles kernels; its time would lower the rates of all later steps.
            timed = False
            while self.progress < 1.0:
                begun, self.between_steps = time.perf_counter(), False
                parts = self.step()
                self._refuse_nan(parts)
                state.seconds += (time.perf_counter() - begun) * timed
                state.step, timed = state.step + 1, True
                if state.step % 10 == 0:
                    rounded = {k: round(v, 6) for k, v in parts.items()}
                    seconds = round(state.seconds, 2)
                    state.curve.append({"phase": state.phase, "step": state.step, "seconds": seconds, **rounded})
                self.between_steps = True
                on_step(self)
            # A GPU reports a few steps late, so the phase's last steps are checked here.
            self._refuse_nan(self.engine.settle())
            self._next_phase()

    def _refuse_nan(self, parts: dict[str, float]) -> None:
        if not all(math.isfinite(value) for value in parts.values()):
            state = self.state
            raise Diverged(f"{state.phase} step {state.step}: the loss is not finite ({parts})")

    def _next_phase(self) -> None:
        state, phases = self.state, [*self._steps(), "done"]
        following = phases[phases.index(state.phase) + 1]
        self.between_steps = False  # a checkpoint halfway through this change would match neither phase
        if following == "pruned":
            shares = shares_of(self.evaluator, self.views, self.threads)
            self._module.active = kept_colors(self._module.active, shares, self.settings.max_colors)
        state.spent[state.phase] = round(state.seconds, 3)
        state.phase, state.step, state.seconds = following, 0, 0.0
        self.between_steps = True

    def figures(self) -> dict:
        """Return figures_of() and the seconds of each finished phase."""
        seconds = {phase: round(seconds, 2) for phase, seconds in self.state.spent.items()}
        return {**figures_of(self.evaluator, self.views, self.threads), "seconds": seconds}

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """Return (JSON, arrays) to resume from."""
        arrays = {f"module.{k}": v for k, v in self.module.arrays().items()} | self.engine.moments()
        arrays["active"] = self._module.active
        return {"state": vars(self.state), "module": self._module.describe()}, {k: v.copy() for k, v in arrays.items()}

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """Restore a checkpoint() from any device."""
        self.state = EditState(**data["state"])
        self._module.active = validation.array(arrays, "active", bool, self._module.active.shape).copy()
        for name, values in self._module.arrays().items():
            values[:] = arrays[f"module.{name}"]
        self.engine.resume(arrays)
