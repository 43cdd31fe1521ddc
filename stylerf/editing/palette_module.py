"""The palette module: colors of a region as mixes of a few palette colors plus a small offset (LAENeRF, section 3.4).

    c = clamp(w P + o, 0, 1),  w = softmax of W(phi(x)) over the active colors,  o = tanh O(phi(x), SH(d))

with x a point of the region, d the view direction, phi a hash encoding, W and O small MLPs. The preview in the released
code omits the tanh; here o is always the same.

P: palette [colors, 3], sRGB, not clamped to 0..1. A: number of active colors. n: points.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.hash_encoding import HashEncoding
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.geometry.spherical_harmonics import BANDS, harmonics

WIDTH = 64  # of the hidden layers
DEGREE = 2  # nine spherical harmonics; LAENeRF counts from one and calls it degree 3
MOST_COLORS = 32
POINTS_AT_ONCE = 1 << 16
MARGIN = 0.05  # of the encoded box, as a fraction of the region's size, for jitter and other views


@dataclass(frozen=True)
class Mixture:
    """weights: [n, A], rows add up to 1. offsets: [n, 3] in -1..1. colors: [n, 3] in 0..1."""

    weights: Tensor
    offsets: Tensor
    colors: Tensor


class PaletteEvaluator(ABC):
    """Evaluates a palette module: PaletteModule or GpuPaletteModule."""

    @property
    @abstractmethod
    def palette(self) -> np.ndarray:
        """The active colors [A, 3], sRGB 0..1."""

    @abstractmethod
    def mixture(self, x: np.ndarray, directions: np.ndarray, threads: int = 1) -> Mixture:
        """Evaluate the module at cube points and unit directions [n, 3]; the result is on the CPU."""

    @abstractmethod
    def edited(
        self, found: Mixture, edits: PaletteEdits | None = None, transition: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the same as colors(), given a mixture on the CPU."""

    def weights(self, x: np.ndarray, threads: int = 1) -> np.ndarray:
        """Return the weights [n, A] float32 at cube points [n, 3]."""
        return self.mixture(x, np.tile(np.array([0, 0, 1], np.float32), (len(x), 1)), threads).weights.numpy()

    def colors(
        self,
        x: np.ndarray,
        directions: np.ndarray,
        edits: PaletteEdits | None = None,
        transition: np.ndarray | None = None,
        threads: int = 1,
    ) -> np.ndarray:
        """Return colors [n, 3] float32 in 0..1, after `edits` if given.

        Args:
            x: Cube points [n, 3].
            directions: Unit vectors [n, 3].
            edits: Changes of palette and weights.
            transition: lambda [n] in 0..1, which interpolates palette and weights rather than colors:
                P' = lambda P + (1 - lambda) P_edited, w' = lambda w + (1 - lambda) w_edited.
        """
        return self.edited(self.mixture(x, directions, threads), edits, transition)


class PaletteModule(PaletteEvaluator):
    """Palette, encoding and both networks. Edits number the active colors from 0 to A - 1, in order.

    Args:
        encoding: phi.
        box: [2, 3] float32, the encoded part of the cube; points outside are clamped to it.
        active: [colors] bool.
        values: Palette, then weights and biases of W's three layers, then of O's, as one float32 array for one
            optimizer.
    """

    kind = "palette"

    def __init__(self, encoding: HashEncoding, box: np.ndarray, active: np.ndarray, values: np.ndarray) -> None:
        count = len(active)
        if not 1 <= count <= MOST_COLORS or active.dtype != bool or not active.any():
            raise InvalidValue(f"palette: expected 1 to {MOST_COLORS} colors, at least one of them active")
        if box.shape != (2, 3) or not (box[0] < box[1]).all():
            raise InvalidValue(f"palette: expected a box of lower and upper corner, found {box.tolist()}")
        expected = count * 3 + sum((i + 1) * o for net in self._nets(encoding.width, count) for i, o in net)
        if values.shape != (expected,) or values.dtype != np.float32 or not np.isfinite(values).all():
            raise InvalidValue(f"palette: expected {expected} finite values, found {len(values)}")
        self.encoding, self.box, self.active, self.values = encoding, box.astype(np.float32), active, values

    @classmethod
    def create(
        cls, generator: np.random.Generator, palette: np.ndarray, box: np.ndarray, encoding: HashEncoding | None = None
    ) -> "PaletteModule":
        """Initialize a module with a palette [colors, 3], nearly uniform weights and nearly zero offsets."""
        encoding = encoding or HashEncoding.create(generator)
        parts: list[np.ndarray] = [np.asarray(palette, np.float32).ravel()]
        for net in cls._nets(encoding.width, len(palette)):
            for number, (inside, outside) in enumerate(net):
                # He et al. 2015, for ReLU; a tenth of that for the last layers.
                bound = math.sqrt(6 / inside) * (0.1 if number + 1 == len(net) else 1.0)
                parts += [generator.uniform(-bound, bound, inside * outside), np.zeros(outside)]
        values = np.concatenate(parts).astype(np.float32)
        return cls(encoding, np.asarray(box, np.float32), np.ones(len(palette), bool), values)

    @staticmethod
    def _nets(features: int, count: int) -> list[list[tuple[int, int]]]:
        """Return (inputs, outputs) of every layer of W and of O."""
        return [[(i, WIDTH), (WIDTH, WIDTH), (WIDTH, o)] for i, o in ((features, count), (features + BANDS[DEGREE], 3))]

    # -- training ----------------------------------------------------------------------------------------------------

    def leaf(self) -> Tensor:
        """Return a copy of `values` that requires gradients."""
        return torch.from_numpy(self.values.copy()).requires_grad_()

    def mix(self, values: Tensor, phi: Tensor, basis: Tensor, kept: Tensor | None = None) -> Mixture:
        """Evaluate the module.

        Args:
            phi: Features [n, features].
            basis: Spherical harmonics of the directions [n, 9].
            kept: Indices of the active colors, if already on the device.
        """
        count = len(self.active)
        nets = self._nets(phi.shape[1], count)
        sizes = [size for net in nets for inside, outside in net for size in (inside * outside, outside)]
        # Cloned, because a slice may be unaligned, which can change the last bit of a product.
        parts = iter([part.clone() for part in values[3 * count :].split(sizes)])
        found = []
        for net, hidden in zip(nets, (phi, torch.cat([phi, basis], 1))):
            for number, (inside, outside) in enumerate(net):
                hidden = torch.nn.functional.linear(hidden, next(parts).view(outside, inside), next(parts))
                hidden = hidden.relu() if number + 1 < len(net) else hidden
            found.append(hidden)
        logits, offsets = found
        kept = torch.from_numpy(np.flatnonzero(self.active)) if kept is None else kept
        # Softmax over active colors only, so that pruning renormalizes the rest (LAENeRF, supplement 1.2).
        weights = torch.softmax(logits if len(kept) == count else logits[:, kept], 1)
        offsets = torch.tanh(offsets)
        palette = self.palette_of(values)[kept]
        return Mixture(weights, offsets, (weights @ palette + offsets).clamp(0, 1))

    def palette_of(self, values: Tensor) -> Tensor:
        """Return the palette [colors, 3], including inactive colors."""
        return values[: 3 * len(self.active)].view(-1, 3)

    def local(self, x: np.ndarray) -> np.ndarray:
        """Return cube points [n, 3] relative to the box, 0..1."""
        return np.clip((x - self.box[0]) / (self.box[1] - self.box[0]), 0, 1).astype(np.float32)

    # -- evaluation --------------------------------------------------------------------------------------------------

    @property
    def palette(self) -> np.ndarray:
        return np.clip(self.values[: 3 * len(self.active)].reshape(-1, 3)[self.active], 0, 1)

    @torch.no_grad()
    def mixture(self, x: np.ndarray, directions: np.ndarray, threads: int = 1) -> Mixture:
        return self.mixture_of(x, harmonics(directions, DEGREE), threads)

    @torch.no_grad()
    def mixture_of(self, x: np.ndarray, basis: np.ndarray, threads: int = 1) -> Mixture:
        """Return the same as mixture(), given the directions' spherical harmonics [n, bands] of DEGREE."""
        values, parts = torch.from_numpy(self.values), []
        for at in range(0, len(x), POINTS_AT_ONCE):
            part = slice(at, at + POINTS_AT_ONCE)
            own = torch.from_numpy(np.ascontiguousarray(basis[part]))
            parts.append(self.mix(values, self.encoding.forward(self.local(x[part]), threads), own))
        if not parts:
            return Mixture(torch.zeros(0, len(self.palette)), torch.zeros(0, 3), torch.zeros(0, 3))
        return Mixture(*(torch.cat([getattr(p, n) for p in parts]) for n in ("weights", "offsets", "colors")))

    def mixed(self, weights: Tensor, offsets: Tensor) -> Mixture:
        """Return the mixture of weights [n, A] and offsets [n, 3]."""
        palette = torch.from_numpy(self.values[: 3 * len(self.active)].reshape(-1, 3)[self.active])
        return Mixture(weights, offsets, (weights @ palette + offsets).clamp(0, 1))

    def edited(
        self, found: Mixture, edits: PaletteEdits | None = None, transition: np.ndarray | None = None
    ) -> np.ndarray:
        if edits is None or not edits:
            return found.colors.numpy()
        # Unclamped, as in training.
        palette = self.values[: 3 * len(self.active)].reshape(-1, 3)[self.active]
        weights, offsets = found.weights.numpy(), found.offsets.numpy()
        new_palette, new_weights = edits.palette(palette), edits.weights(weights)
        own = np.zeros((len(weights), 1), np.float32)
        if transition is not None:
            own = np.asarray(transition, np.float32)[:, None]
        mixed = own * weights + (1 - own) * new_weights
        # w' (lambda P + (1 - lambda) P_edited), without a palette per point.
        out = own * (mixed @ palette) + (1 - own) * (mixed @ new_palette) + offsets
        return np.clip(out, 0, 1).astype(np.float32)

    # -- storage -----------------------------------------------------------------------------------------------------

    def describe(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "active": self.active.tolist(),
            "box": self.box.tolist(),
            "encoding": self.encoding.describe(),
        }

    def arrays(self) -> dict[str, np.ndarray]:
        return {"networks": self.values, "table": self.encoding.values}

    @classmethod
    def restore(cls, data: dict[str, Any], arrays: dict[str, np.ndarray]) -> "PaletteModule":
        table, networks = (
            validation.array(arrays, name, np.float32, (None,), validation.LEARNED) for name in ("table", "networks")
        )
        encoding = HashEncoding.restore(validation.entry(data, "encoding"), table.copy())
        active = validation.entry(data, "active", list)
        if not all(isinstance(one, bool) for one in active):
            raise InvalidValue("palette: active must hold only true and false")
        return cls(
            encoding, np.array(validation.rows(data, "box", 2, 3), np.float32), np.array(active, bool), networks.copy()
        )


def box_around(points: np.ndarray) -> np.ndarray:
    """Return the bounding box [2, 3] of cube points [n, 3], with a margin; sides are at least 0.1 of the longest."""
    low, high = points.min(0), points.max(0)
    size = np.maximum(high - low, max(0.1 * float((high - low).max()), 1e-3))
    middle = (low + high) / 2
    return np.stack([middle - size * (0.5 + MARGIN), middle + size * (0.5 + MARGIN)]).astype(np.float32)


def random_palette(generator: np.random.Generator, count: int) -> np.ndarray:
    """Return a palette [count, 3], uniform in 0..1, as LAENeRF does."""
    return generator.random((count, 3)).astype(np.float32)


def clustered_palette(generator: np.random.Generator, colors: np.ndarray, count: int, rounds: int = 12) -> np.ndarray:
    """Return the centers [count, 3] of k-means over colors [n, 3], seeded by k-means++ (Arthur and Vassilvitskii 2007).

    Sorted by cluster size, largest first. Empty clusters keep their centers.
    """
    colors = np.asarray(colors, np.float64)
    centers = colors[generator.integers(len(colors))][None]
    while len(centers) < count:
        apart = np.square(colors[:, None] - centers).sum(-1).min(1)  # [n], squared distance to the nearest center
        total = apart.sum()
        chosen = generator.choice(len(colors), p=apart / total) if total > 0 else generator.integers(len(colors))
        centers = np.concatenate([centers, colors[chosen][None]])
    centers, sizes = weighted_means(colors, np.ones(len(colors)), centers, rounds)
    return centers[np.argsort(-sizes, kind="stable")].astype(np.float32)


def weighted_means(
    colors: np.ndarray, masses: np.ndarray, centers: np.ndarray, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Run k-means of colors [n, 3], weighted by masses [n], from centers [k, 3]; empty clusters keep their centers.

    Returns:
        The centers [k, 3] and the masses [k] of their clusters.
    """
    for _ in range(rounds):
        nearest = np.square(colors[:, None] - centers).sum(-1).argmin(1)
        sizes = np.bincount(nearest, masses, len(centers))
        sums = np.stack([np.bincount(nearest, masses * colors[:, a], len(centers)) for a in range(3)], 1)
        centers = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1e-12)[:, None], centers)
    return centers, sizes
