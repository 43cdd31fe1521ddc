"""Learn what palette a whole scene is mixed of (PaletteNeRF, Kuang et al. 2023): shapes held fast, photos as they are.

The refit teaches the direct color, diffuse and specular; then the palette's branch learns with it. All of a sample's
quantities are composited along rays with the field's weights, and are means over rays.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from stylerf.editing.palette_hull import extracted
from stylerf.editing.palette_losses import sparsity
from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.palette_head import Parts
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.spherical_harmonics import harmonics
from stylerf.training.stylize.settings import StyleSettings
from stylerf.training.stylize.trainer import MEMORY, StylizationTrainer

SAMPLED_COLORS = 200_000  # pixels of the photos that the palette is taken from
ASKED_VIEWS = 10  # that figures are taken of, as those of local edits
PIXELS_AT_ONCE = 16384
SHOWN = 0.5  # alpha from which a pixel shows the scene
# PaletteNeRF: epochs 100 and 30 of 300 (30 000 steps, a hundred views).
RELEASE, SMOOTH_FROM = 1 / 3, 0.1
# PaletteNeRF's scene is two bounds wide, the cube one: 0.03 bounds, and distances by bounds squared over 0.005.
SMOOTH_REACH, SMOOTH_NEAR, SMOOTH_LIKE = 0.015, 4 / 0.005, 1 / 0.2


@dataclass(frozen=True)
class DecompositionWeights:
    """Weights of the parts beside the two images' squared errors, as published but for sparsity (2e-4 there).

    sparsity: sum w / sum w^2 - 1. offset: sum_i |delta_i|^2. view: |s|^2. smooth: of weights between near places of
    like color. guide: towards the weights that the palette's hull tells, falling to 0 at RELEASE. drift: of the
    palette from what was extracted, once it is released.
    """

    sparsity: float = 2e-3
    offset: float = 0.03
    view: float = 0.1
    smooth: float = 4e-3
    guide: float = 0.05
    drift: float = 1e-3


class PaletteNerfTrainer(StylizationTrainer):
    """new_color: as of Repainting, from the extracted palette [bases, 3] too. bases: see editing/hull.extracted."""

    field: RadianceField

    def __init__(
        self,
        scene: RadianceField,
        cameras: list[Camera],
        photos: Sequence[np.ndarray],
        background: float,
        settings: StyleSettings,
        weights: DecompositionWeights,
        bases: int,
        seed: int,
        chunks: int,
        new_color: Callable[[np.random.Generator, float, np.ndarray], PaletteColor],
        memory: float = MEMORY,
    ) -> None:
        self.weights = weights

        def with_palette(generator: np.random.Generator, pixel_cells: float) -> PaletteColor:
            self.extracted = extracted(self._seen_colors(photos, generator), bases, generator)
            return new_color(generator, pixel_cells, self.extracted.palette)

        given = (settings, seed, chunks, with_palette, memory)
        super().__init__(scene, cameras, photos, background, None, None, *given)

    @property
    def stride(self) -> int:
        """No features are looked at."""
        return 1

    def _seen_colors(self, photos: Sequence[np.ndarray], generator: np.random.Generator) -> np.ndarray:
        """[n, 3] what the photos show where the field is."""
        found, each = [], -(-SAMPLED_COLORS // len(self.cameras))
        for view in range(len(self.cameras)):
            shown = np.flatnonzero(self.still.alpha(view).ravel() > SHOWN)
            if len(shown) > each:
                shown = shown[generator.integers(0, len(shown), each)]
            found.append(photos[view].reshape(-1, 3)[shown])
        colors = np.concatenate(found)
        if len(colors) == 0:
            raise InvalidValue("no training view shows anything of the field: there are no colors to decompose")
        return np.clip(colors, 0, 1)

    # -- steps ------------------------------------------------------------------------------------------------------

    def refit_step(self) -> float:
        """One step of the direct color towards a photo; its mean squared error."""
        parts = self._taught(2, False)
        if parts:
            self.adam.step(self.settings.refit_rate * 0.1**self.progress)
        return parts.get("direct", 0.0)

    def _step(self) -> dict[str, float]:
        """One step of everything on one view; the parts of its loss, `mse` that of the palette's image."""
        s, parts = self.settings, self._taught(3, True)
        if parts:
            self.adam.step(s.rate * s.final_rate**self.progress)
        return parts or {"mse": 0.0}

    def _taught(self, stream: int, whole: bool) -> dict[str, float]:
        """Adds the gradient of one view's random pixels; empty where the view shows nothing.

        whole: with the palette's branch.
        """
        generator = np.random.default_rng([self.seed, stream, self.state.step])
        view = int(generator.integers(len(self.cameras)))
        lit = np.flatnonzero(self.still.alpha(view).ravel() > 1e-3)
        if len(lit) == 0:
            return {}
        pixels = lit[generator.integers(0, len(lit), self.settings.refit_pixels)]
        seen = _Seen(self, view, pixels)
        losses = self._image_losses(seen, self.photos[view].reshape(-1, 3)[pixels], whole)
        if whole:
            losses |= self._palette_losses(seen, generator)
        scales = self._scales()
        loss = sum(scales[name] * value for name, value in losses.items() if scales[name])
        loss.backward()
        self._collect_gradients(seen)
        return {name: float(value.detach()) for name, value in losses.items() if scales[name]}

    def _scales(self) -> dict[str, float]:
        """What each part of the loss counts at this step."""
        w, done = self.weights, self.progress
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

    def _image_losses(self, seen: "_Seen", photo: np.ndarray, whole: bool) -> dict[str, Tensor]:
        wanted = torch.from_numpy(photo) - (1 - seen.alpha) * float(self.background)
        parts = seen.parts
        direct = seen.composited(parts.diffuse + parts.specular) - wanted
        losses = {
            "direct": direct.square().mean(),
            "view": seen.composited(parts.specular.square().sum(1, keepdim=True)).mean(),
        }
        if whole:
            mixed = seen.composited(parts.mixed(seen.palette) + parts.specular.detach()) - wanted
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
        if self.progress >= SMOOTH_FROM:
            losses["smooth"] = seen.composited(roughness(parts, *seen.beside(generator))[:, None]).mean()
        return losses

    def _collect_gradients(self, seen: "_Seen") -> None:
        color, to = self.field.color, self.adam.gradients
        for x, phi in seen.encoded:
            if phi.grad is not None:
                gradients = phi.grad.contiguous().numpy()
                color.features.backward(color.table, x, np.arange(len(x)), gradients, to)
        own = seen.rest.grad.numpy()
        if self.progress < RELEASE or self.state.phase == "refit":
            own[: 3 * color.bases] = 0
        to[0, color.features.length :] += own

    # -- figures ----------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def figures(self) -> dict:
        """JSON: palette, shares, sparsity L_sp and palette TV as local edits have them, and PSNR in dB against the
        photos, of the pixels that show the scene, on up to ASKED_VIEWS views."""
        count = len(self.cameras)
        errors, sparse, varied, shares, pixels = 0.0, [], [], [], 0
        for view in np.unique(np.linspace(0, count - 1, min(count, ASKED_VIEWS)).round().astype(int)):
            alpha = self.still.alpha(view)
            weights, rgb = self._looked_at(int(view))
            shown = alpha > SHOWN
            if not shown.any():
                continue
            over = rgb + (1 - alpha[..., None]) * self.background
            errors += float(np.square(over - self.photos[view], dtype=np.float64)[shown].sum())
            pixels += int(shown.sum())
            weights = weights / np.maximum(weights.sum(2, keepdims=True), 1e-6)
            sparse.append(sparsity(weights[shown]))
            varied.append(picture_variation(weights, alpha, shown))
            shares.append(weights[shown].mean(0))
        return {
            "colors": self.field.color.bases,
            "palette": [[round(float(v), 4) for v in color] for color in self.field.color.palette],
            "shares": [round(float(share), 4) for share in np.mean(shares, 0)],
            "sparsity": round(float(np.mean(sparse)), 4),
            "palette_variation": round(float(np.mean(varied)), 5),
            "psnr": round(-10 * np.log10(max(errors / (3 * max(pixels, 1)), 1e-10)), 2),
            "extraction_error": round(self.extracted.error, 5),
        }

    def _looked_at(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """(weights [h, w, bases], premultiplied rgb [h, w, 3]) of a view, both composited."""
        alpha, kept = self.still.alpha(view), []
        for at in range(0, alpha.size, PIXELS_AT_ONCE):
            seen = _Seen(self, view, np.arange(at, min(at + PIXELS_AT_ONCE, alpha.size)))
            colors = (seen.parts.mixed(seen.palette) + seen.parts.specular).clamp(0, 1)
            kept.append(seen.composited(torch.cat([seen.parts.weights, colors], 1)).detach().numpy())
        found = np.concatenate(kept).reshape(*alpha.shape, -1)
        return found[..., :-3], found[..., -3:]


class _Seen:
    """What pixels of a view show of the color part, as a graph whose leaves are `rest` and the features."""

    def __init__(self, owner: PaletteNerfTrainer, view: int, pixels: np.ndarray) -> None:
        self._color, self._chunks, self._pixels = owner.field.color, owner.chunks, len(pixels)
        starts, ends, self.x, weights = owner.still.surface(view).samples(pixels)
        self._rays = torch.from_numpy(np.repeat(np.arange(len(pixels)), ends - starts))
        self._weights = torch.from_numpy(weights)[:, None]
        self.alpha = torch.from_numpy(owner.still.alpha(view).ravel()[pixels])[:, None]
        basis = harmonics(owner.cameras[view].rays(pixels)[1], self._color.degree)
        self._basis = torch.from_numpy(basis).index_select(0, self._rays)
        self.rest = torch.from_numpy(self._color.rest.copy()).requires_grad_()
        self.encoded: list[tuple[np.ndarray, Tensor]] = []
        self.parts, self.palette = self._parts(self.x)

    def _parts(self, x: np.ndarray) -> tuple[Parts, Tensor]:
        color = self._color
        phi = torch.from_numpy(color.features.encode(color.table, x, np.arange(len(x)), self._chunks))
        self.encoded.append((x, phi.requires_grad_()))
        return color.parts(self.rest, phi, self._basis, apart=True)

    def beside(self, generator: np.random.Generator) -> tuple[Parts, Tensor]:
        """(parts of places up to SMOOTH_REACH further along each axis, their squared distances in the cube [n])."""
        moved = np.minimum(self.x + generator.random(self.x.shape, np.float32) * np.float32(SMOOTH_REACH), 1)
        return self._parts(moved)[0], torch.from_numpy(np.square(moved - self.x).sum(1))

    def composited(self, values: Tensor) -> Tensor:
        """[pixels, k]: sum over each ray's samples of weight times values [n, k]."""
        out = torch.zeros(self._pixels, values.shape[1])
        return out.index_add(0, self._rays, self._weights * values)


def roughness(parts: Parts, beside: Parts, away: Tensor) -> Tensor:
    """[n]: sum_i (w_i - w'_i)^2 exp(-|dx|^2 / 0.005 bound^2 - |d diffuse|^2 / 0.2); away [n] is |dx|^2 in the cube."""
    unlike = (parts.diffuse - beside.diffuse).detach().square().sum(1)
    near = torch.exp(-SMOOTH_NEAR * away - SMOOTH_LIKE * unlike)
    return (parts.weights - beside.weights).square().sum(1) * near


def picture_variation(weights: np.ndarray, alpha: np.ndarray, shown: np.ndarray) -> float:
    """Palette TV of a picture, as editing/losses.weight_variation has it: squared differences of weights [h, w, M] of
    neighbors that are both shown, times both alphas squared, summed, over the number of shown pixels."""
    total, weights, alpha = 0.0, weights.astype(np.float64), alpha.astype(np.float64)
    for axis in (0, 1):
        first, second = (
            tuple(slice(*ends) if a == axis else slice(None) for a in (0, 1)) for ends in ((-1,), (1, None))
        )
        both = shown[first] & shown[second]
        squares = np.square(weights[first] - weights[second]).sum(2)
        total += float((squares * (alpha[first] * alpha[second]) ** 2)[both].sum())
    return total / max(int(shown.sum()), 1)
