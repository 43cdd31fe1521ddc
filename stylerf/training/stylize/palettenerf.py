"""Decompose a scene's colors into a palette (PaletteNeRF, Kuang et al. 2023), with fixed shapes.

The refit trains the direct color, diffuse and specular; then the palette branch is trained along with it. All
quantities of samples are composited along rays with the field's weights; losses are means over rays.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.palette_hull import ExtractedPalette, extracted
from stylerf.editing.palette_losses import figures_json, sparsity
from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import PaletteColor, Parts
from stylerf.fields.protocol import ColorPart
from stylerf.geometry.cameras import evenly_spaced
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.training.common.even_draws import drawn_evenly
from stylerf.training.stylize.scene import StyledScene, StyleProblem
from stylerf.training.stylize.settings import REFIT, StyleSettings
from stylerf.training.stylize.trainer import StyleMethod

SAMPLED_COLORS = 200_000  # pixels of the photos that the palette is extracted from
FIGURE_VIEWS = 10  # used for figures, as for local edits
PIXELS_AT_ONCE = 16384
SHOWN = 0.5  # minimum alpha for a pixel to show the scene
# PaletteNeRF: epochs 100 and 30 of 300 (30 000 steps, a hundred views).
RELEASE, SMOOTH_FROM = 1 / 3, 0.1
# PaletteNeRF's scene is two bounds wide, the cube one: 0.03 bounds, and distances by bounds squared over 0.005.
SMOOTH_REACH, SMOOTH_NEAR, SMOOTH_LIKE = 0.015, 4 / 0.005, 1 / 0.2


@dataclass(frozen=True)
class DecompositionWeights:
    """Weights of the losses other than the two images' squared errors, as published except for sparsity (2e-4 there).

    Attributes:
        sparsity: sum w / sum w^2 - 1.
        offset: sum_i |delta_i|^2.
        view: |s|^2 of the specular part.
        smooth: Weight differences between nearby points of similar color.
        guide: Distance to the weights given by the palette's hull; falls to 0 at RELEASE.
        drift: Distance of the palette from the extracted one, after RELEASE.
    """

    sparsity: float = 2e-3
    offset: float = 0.03
    view: float = 0.1
    smooth: float = 4e-3
    guide: float = 0.05
    drift: float = 1e-3


def seen_colors(scene: StyledScene, generator: np.random.Generator) -> np.ndarray:
    """Return a sample [n, 3] of the photos' colors where the field is visible.

    Raises:
        InvalidValue: No view shows any part of the field.
    """
    found, each = [], -(-SAMPLED_COLORS // len(scene.cameras))
    for view in range(len(scene.cameras)):
        shown = np.flatnonzero(scene.fixed.alpha(view).ravel() > SHOWN)
        if len(shown) > each:
            shown = shown[generator.integers(0, len(shown), each)]
        found.append(scene.problem.photos[view].reshape(-1, 3)[shown])
    colors = np.concatenate(found)
    if len(colors) == 0:
        raise InvalidValue("no training view shows any part of the field: there are no colors to decompose")
    return np.clip(colors, 0, 1)


class PaletteNerf(StyleMethod[StyleSettings]):
    """PaletteNeRF. color: the scene's color, initialized with the extracted palette."""

    def __init__(
        self,
        scene: StyledScene[StyleSettings],
        color: PaletteColor,
        weights: DecompositionWeights,
        palette: ExtractedPalette,
    ) -> None:
        super().__init__(scene)
        self.color, self.weights, self.extracted = color, weights, palette

    @staticmethod
    def create(
        problem: StyleProblem[StyleSettings],
        weights: DecompositionWeights,
        bases: int,
        new_color: Callable[[np.random.Generator, float, np.ndarray], PaletteColor],
    ) -> "PaletteNerf":
        """Extract a palette of `bases` colors (see palette_hull.extracted) and start from it.

        new_color: Creates the color from a generator, the number of pixel-sized cells per cube side, and the palette
        [bases, 3].
        """
        made: list[tuple[PaletteColor, ExtractedPalette]] = []

        def with_palette(generator: np.random.Generator, scene: StyledScene[StyleSettings]) -> ColorPart:
            pixel_cells = scene.pixel_cells()
            palette = extracted(seen_colors(scene, generator), bases, generator)
            made.append((new_color(generator, pixel_cells, palette.palette), palette))
            return made[0][0]

        scene = StyledScene(problem, with_palette)
        color, palette = made[0]
        return PaletteNerf(scene, color, weights, palette)

    # -- steps ------------------------------------------------------------------------------------------------------

    def refit_step(self) -> dict[str, float]:
        """Take one step of the direct color on a photo; return its mean squared error."""
        parts = self._learn(2, False)
        if parts:
            self.scene.adam.step(self.scene.settings.refit_rate * 0.1**self.scene.budget.progress)
        return {"mse": parts.get("direct", 0.0)}

    def step(self) -> dict[str, float]:
        """Take one step of all parts on one view; return the parts of its loss (`mse`: of the palette's image)."""
        s, parts = self.scene.settings, self._learn(3, True)
        if parts:
            self.scene.adam.step(s.rate * s.final_rate**self.scene.budget.progress)
        return parts or {"mse": 0.0}

    def _learn(self, stream: int, with_palette: bool) -> dict[str, float]:
        """Add the gradient of random pixels of one view; return the parts of the loss, none if the view is empty."""
        scene = self.scene
        generator = np.random.default_rng([scene.problem.seed, stream, scene.state.step])
        view = int(generator.integers(len(scene.cameras)))
        lit = np.flatnonzero(scene.fixed.alpha(view).ravel() > 1e-3)
        if len(lit) == 0:
            return {}
        pixels = lit[drawn_evenly(scene.settings.refit_pixels, len(lit), generator)]
        seen = _Seen(scene, self.color, view, pixels)
        losses = self._image_losses(seen, scene.photos[view].reshape(-1, 3)[pixels], with_palette)
        if with_palette:
            losses |= self._palette_losses(seen, generator)
        scales = self._scales()
        first, *rest = (scales[name] * value for name, value in losses.items() if scales[name])
        self._add_gradients(seen, sum(rest, first))
        return {name: float(value.detach()) for name, value in losses.items() if scales[name]}

    def _scales(self) -> dict[str, float]:
        """Return the weight of each part of the loss at this step."""
        w, done = self.weights, self.scene.budget.progress
        return {
            "direct": 1.0,
            "mse": 1.0,
            "sparsity": w.sparsity,
            "offset": w.offset,
            "view": w.view,
            "smooth": w.smooth if done >= SMOOTH_FROM else 0.0,
            "guide": w.guide * max(0.0, 1 - done / RELEASE),
            "drift": w.drift if done >= RELEASE else 0.0,
        }

    def _image_losses(self, seen: "_Seen", photo: np.ndarray, with_palette: bool) -> dict[str, Tensor]:
        # Composited colors are premultiplied, so the background is subtracted from the photo.
        target = torch.from_numpy(photo) - (1 - seen.alpha) * float(self.scene.background)
        parts = seen.parts
        direct = seen.composited(parts.diffuse + parts.specular) - target
        losses = {
            "direct": direct.square().mean(),
            "view": seen.composited(parts.specular.square().sum(1, keepdim=True)).mean(),
        }
        if with_palette:
            # Detached: only the direct image trains the specular part, or it would explain what the palette cannot.
            mixed = seen.composited(parts.mixed(seen.palette) + parts.specular.detach()) - target
            images = seen.composited(parts.weights)
            guide = torch.from_numpy(self.extracted.weights_of(photo))
            losses |= {
                "mse": mixed.square().mean(),
                "guide": (images - seen.alpha * guide).square().mean(),
            }
        return losses

    def _palette_losses(self, seen: "_Seen", generator: np.random.Generator) -> dict[str, Tensor]:
        parts, first = seen.parts, torch.from_numpy(self.extracted.palette)
        losses = {
            "sparsity": seen.composited(1 / parts.weights.square().sum(1, keepdim=True) - 1).mean(),
            "offset": seen.composited(parts.offsets.square().sum((1, 2))[:, None]).mean(),
            "drift": (seen.palette - first).square().sum(1).mean(),
        }
        if self.scene.budget.progress >= SMOOTH_FROM:
            losses["smooth"] = seen.composited(roughness(parts, *seen.beside(generator))[:, None]).mean()
        return losses

    def _add_gradients(self, seen: "_Seen", loss: Tensor) -> None:
        color, to = self.color, np.asarray(self.scene.adam.gradients)
        loss.backward()
        for x, phi in seen.encoded:
            if phi.grad is not None:
                gradients = phi.grad.contiguous().numpy()
                # Twice if smoothness is on: for the samples and for their neighbor points.
                color.features.backward(color.table, x, np.arange(len(x)), gradients, to)
        assert seen.rest.grad is not None
        own = seen.rest.grad.numpy()
        if self.scene.budget.progress < RELEASE or self.scene.state.phase == REFIT:
            # The palette stays fixed until the mixing weights fit it (PaletteNeRF).
            own[: 3 * color.bases] = 0
        to[0, color.features.length :] += own

    # -- figures ----------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def figures(self) -> dict:
        """Return figures of the result as JSON, on up to FIGURE_VIEWS views.

        Palette, shares, sparsity L_sp and palette TV as for local edits, and the PSNR in dB against the photos over the
        pixels that show the scene.
        """
        scene = self.scene
        errors, sparse, varied, shares, pixels = 0.0, [], [], [], 0
        for view in evenly_spaced(len(scene.cameras), FIGURE_VIEWS):
            alpha = scene.fixed.alpha(view)
            weights, rgb = self._render(view)
            shown = alpha > SHOWN
            if not shown.any():
                continue
            over = rgb + (1 - alpha[..., None]) * scene.background
            errors += float(np.square(over - scene.photos[view], dtype=np.float64)[shown].sum())
            pixels += int(shown.sum())
            weights = weights / np.maximum(weights.sum(2, keepdims=True), 1e-6)
            sparse.append(sparsity(weights[shown]))
            varied.append(picture_variation(weights, alpha, shown))
            shares.append(weights[shown].mean(0))
        error = errors / (3 * max(pixels, 1))
        figures = figures_json(self.color.palette, shares, sparse, varied, error)
        return figures | {"extraction_error": round(self.extracted.error, 5)}

    def _render(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a view's (weights [h, w, bases], premultiplied rgb [h, w, 3]), both composited."""
        alpha, parts = self.scene.fixed.alpha(view), []
        for at in range(0, alpha.size, PIXELS_AT_ONCE):
            seen = _Seen(self.scene, self.color, view, np.arange(at, min(at + PIXELS_AT_ONCE, alpha.size)))
            colors = (seen.parts.mixed(seen.palette) + seen.parts.specular).clamp(0, 1)
            parts.append(seen.composited(torch.cat([seen.parts.weights, colors], 1)).detach().numpy())
        found = np.concatenate(parts).reshape(*alpha.shape, -1)
        return found[..., :-3], found[..., -3:]


class _Seen:
    """The color part's quantities at pixels of a view, as an autograd graph with leaves `rest` and the features."""

    def __init__(self, scene: StyledScene[StyleSettings], color: PaletteColor, view: int, pixels: np.ndarray) -> None:
        self._color, self._threads, self._pixels = color, scene.problem.threads, len(pixels)
        starts, ends, self.x, weights = scene.fixed.surface(view).samples(pixels)
        self._rays = torch.from_numpy(np.repeat(np.arange(len(pixels)), ends - starts))
        self._weights = torch.from_numpy(weights)[:, None]
        self.alpha = torch.from_numpy(scene.fixed.alpha(view).ravel()[pixels])[:, None]
        basis = harmonics(scene.cameras[view].rays(pixels)[1], self._color.degree)
        self._basis = torch.from_numpy(basis).index_select(0, self._rays)
        self.rest = torch.from_numpy(self._color.rest.copy()).requires_grad_()
        self.encoded: list[tuple[np.ndarray, Tensor]] = []
        self.parts, self.palette = self._parts(self.x)

    def _parts(self, x: np.ndarray) -> tuple[Parts, Tensor]:
        color = self._color
        phi = torch.from_numpy(color.features.encode(color.table, x, np.arange(len(x)), self._threads))
        self.encoded.append((x, phi.requires_grad_()))
        return color.parts(self.rest, phi, self._basis, apart=True)

    def beside(self, generator: np.random.Generator) -> tuple[Parts, Tensor]:
        """Return (parts at points randomly shifted by up to SMOOTH_REACH per axis, squared shifts [n] in the cube)."""
        moved = np.minimum(self.x + generator.random(self.x.shape, np.float32) * np.float32(SMOOTH_REACH), 1)
        return self._parts(moved)[0], torch.from_numpy(np.square(moved - self.x).sum(1))

    def composited(self, values: Tensor) -> Tensor:
        """Return [pixels, k]: the sum over each ray's samples of weight times values [n, k]."""
        out = torch.zeros(self._pixels, values.shape[1])
        return out.index_add(0, self._rays, self._weights * values)


def roughness(parts: Parts, beside: Parts, away: Tensor) -> Tensor:
    """Return sum_i (w_i - w'_i)^2 exp(-|dx|^2 / 0.005 bound^2 - |d diffuse|^2 / 0.2), [n]; away: |dx|^2 [n], cube."""
    # Detached: the diffuse color must not diverge from its neighbor's to escape the smoothness.
    unlike = (parts.diffuse - beside.diffuse).detach().square().sum(1)
    near = torch.exp(-SMOOTH_NEAR * away - SMOOTH_LIKE * unlike)
    return (parts.weights - beside.weights).square().sum(1) * near


def picture_variation(weights: np.ndarray, alpha: np.ndarray, shown: np.ndarray) -> float:
    """Return the palette TV of an image, as editing/palette_losses.weight_variation does.

    The sum of squared differences of weights [h, w, M] between neighbors that are both shown, times both alphas
    squared, divided by the number of shown pixels.
    """
    total, weights, alpha = 0.0, weights.astype(np.float64), alpha.astype(np.float64)
    for axis in (0, 1):
        first, second = (
            tuple(slice(*ends) if a == axis else slice(None) for a in (0, 1)) for ends in ((-1,), (1, None))
        )
        both = shown[first] & shown[second]
        squares = np.square(weights[first] - weights[second]).sum(2)
        total += float((squares * (alpha[first] * alpha[second]) ** 2)[both].sum())
    return total / max(int(shown.sum()), 1)
