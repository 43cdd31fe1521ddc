"""Train a deformation network through the displacement grid that it is baked to (DeSRF, section 3.2).

Rays read the displacement grid; gradients flow to its vertices and from there through the network. Only vertices near
visible surfaces matter, so the network is evaluated tens of thousands of times per step instead of once per sample.
"""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.color_map import before_map
from stylerf.fields.deformation import (
    Deformation,
    at_rest,
    displaced_occupancy,
    occupancy_of_seen,
    seen_cells,
    vertices_of,
)
from stylerf.fields.marching import ScratchArena
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import Rendered, backward, render_rays
from stylerf.training.common.adam import Adam, Optimizer, moments_of, restore_moments
from stylerf.training.common.ray_dataset import over, target, unhidden
from stylerf.training.deform.bending import Extension, folding

REFRESH_EVERY = 16  # steps between updates of the deformed occupancy
SIGHT_RAYS = 1 << 17  # rays that find the visible vertices
FOLDING = 10.0  # weight of the folding penalty (bending.folding), relative to the loss's gradient
HIDDEN_RATE = 0.1  # relative to the last layer's
Buffer = TypeVar("Buffer", np.ndarray, Tensor)


class GridDeformer(ABC, Generic[Buffer]):
    """Trains `deformation` through a displacement grid of `vertices`^3, which it adds to `field`.

    The network is evaluated at the vertices around what the cameras see of the undeformed field; every other vertex
    moves with those nearby (bending.Extension).

    Attributes:
        gradient_clip: For the network; see Adam.
        anchored: Train only the last layer, without drift: its biases follow its weights so that the mean of D, apart
            from the bound, is unchanged. A loss that hardly depends on shapes, such as a style loss on a capture, would
            otherwise drive hidden units below zero one by one, and the whole scene would drift (decision 0053).
        gradients: Buffer to which backward() adds dL/dD.
    """

    device = torch.device("cpu")  # of the network
    gradients: Buffer
    adam: Optimizer
    _grid: Tensor  # [vertices^3, 3], read by rays

    def __init__(
        self,
        field: RadianceField,
        deformation: Deformation,
        cameras: list[Camera],
        vertices: int,
        seed: int,
        threads: int,
        gradient_clip: float = 0.0,
        anchored: bool = False,
    ) -> None:
        self.field, self.deformation, self.vertices = field, deformation, vertices
        self.gradient_clip, self.anchored = gradient_clip, anchored
        self._learning = deformation.last if anchored else len(deformation.values)  # of the network's last values
        self._hidden: Tensor | None = None  # [active, width], output of the fixed hidden layers
        self.taken = 0
        at_rest(field)
        rays = random_rays(cameras, SIGHT_RAYS, field.space.near, np.random.default_rng([seed, 7]))
        self.rest = occupancy_of_seen(field, rays, threads)  # of the undeformed field
        active = vertices_of(seen_cells(field, rays, vertices - 1, 0.1, threads))
        if not len(active):
            raise InvalidValue("no camera sees anything of the field: there is nothing to deform")
        places = np.stack(np.unravel_index(active, (vertices,) * 3), -1) / (vertices - 1)
        self._encoded = deformation.encode(torch.from_numpy(places.astype(np.float32))).to(self.device)
        self._extension = Extension(active, vertices, self.device)
        self._pairs = [pairs.to(self.device) for pairs in _pairs(active, vertices)]
        # One shared array: the field's kernels read what bake() (on a GPU, collect()) writes.
        self.grid = field.displacement = np.zeros((vertices,) * 3 + (3,), np.float32)
        self._prepare(threads)
        self.bake()
        self.look()

    # -- where it trains --------------------------------------------------------------------------------------------

    @abstractmethod
    def _prepare(self, threads: int) -> None:
        """Create `gradients`, `adam` and `_grid`; the field already has its grid."""

    @abstractmethod
    def _gathered(self) -> Tensor:
        """Return dL/dD [vertices^3, 3] from `gradients`."""

    @abstractmethod
    def look(self) -> None:
        """Update the occupancy of the deformed field."""

    @abstractmethod
    def _place(self, distances: np.ndarray) -> None:
        """Restore the deformed field's occupancy from a checkpoint."""

    @abstractmethod
    def _number(self, size: Tensor) -> float:
        """Return a number of this step; on a GPU, of a few steps before."""

    @abstractmethod
    def collect(self) -> None:
        """Copy what was learned into `deformation` and `field`."""

    # -- training -----------------------------------------------------------------------------------------

    def bake(self) -> None:
        """Evaluate the network and write the grid that rays read."""
        values = torch.as_tensor(self.adam.values).detach()
        if self.anchored:
            self._hidden = self.deformation.hidden(self._encoded, values) if self._hidden is None else self._hidden
            self._values = values[-self._learning :].clone().requires_grad_()
            self._moved = self.deformation.moved(self._hidden, self._values)
        else:
            self._values = values.requires_grad_()
            self._moved = self.deformation.network(self._encoded, self._values)
        self._grid.copy_(self._extension.spread(self._moved.detach()))

    def step(self, rate: float, weight: float, smoothness: float = 0.0, max_slope: float = 0.0) -> float:
        """Take one step on dL/dD plus the gradient of weight |D| + smoothness TV(D); return |D|.

        max_slope: penalize displacements that change faster than this per distance (0: never).
        |D|: root mean square displacement of the active vertices, for a cube two units wide (L_dx of eq. 7).
        TV: mean squared difference of neighboring vertices, in the same units.
        """
        gradient = self._extension.gathered(self._gathered())
        self.gradients[:] = 0
        # Factor 2: the cube is two units wide. Without 1e-12, the root's gradient would be 0/0 where training begins.
        size = (2 * self._moved).square().sum(1).mean().add(1e-12).sqrt()
        # <D, dL/dD> with constant dL/dD has the gradient J^T dL/dD with respect to the network's weights.
        loss = (self._moved * gradient).sum() + weight * size
        if smoothness > 0:
            loss = loss + smoothness * self._variation()
        (found,) = torch.autograd.grad(loss, self._values, retain_graph=max_slope > 0)
        if max_slope > 0:
            # As a part of the loss, this would need a weight per scene and style image.
            (whole,) = torch.autograd.grad(self._moved, self._values, self._whole_gradient(max_slope))
            found = found + found.norm() * whole
        torch.as_tensor(self.adam.gradients).view(-1)[-self._learning :].add_(found)
        self._learn(rate)
        self.taken += 1
        self.bake()
        if self.taken % REFRESH_EVERY == 0:
            self.look()
        return self._number(size.detach())

    def _learn(self, rate: float) -> None:
        """Take the optimizer's step; if anchored, preserve the mean of D."""
        if self._hidden is None:
            return self.adam.step(rate)
        last = self.deformation.last
        values, mean = torch.as_tensor(self.adam.values)[-last:], self._hidden.mean(0)
        weights, biases = values[:-3].view(3, -1), values[-3:]
        gradients = torch.as_tensor(self.adam.gradients).view(-1)[-last:]
        # With b = -W mean(h), dL/dW is the gradient of W (h - mean(h)).
        gradients[:-3].view(3, -1).sub_(torch.outer(gradients[-3:], mean))
        gradients[-3:] = 0
        before = weights.clone()
        self.adam.step(rate)
        biases.sub_((weights - before) @ mean)

    def _whole_gradient(self, max_slope: float) -> Tensor:
        """Return d/dD of the penalty on slopes beyond `max_slope`."""
        m = self.vertices
        grid = self._extension.spread(self._moved.detach()).requires_grad_()
        penalty = FOLDING * folding(grid.view(m, m, m, 3), self._extension.close, max_slope)
        # Differentiate the extension by hand: autograd adds gathered rows one by one, which takes half a second.
        return self._extension.gathered(torch.autograd.grad(penalty, grid)[0])

    def _variation(self) -> Tensor:
        m, moved = self.vertices, 2 * self._moved
        grid, total = self._extension.spread(moved).view(m, m, m, 3), moved.new_zeros(())
        for axis, both in enumerate(self._pairs):
            total = total + (grid.diff(dim=axis).square().sum(-1) * both).sum()
        return total / len(moved)

    def values(self) -> np.ndarray:
        """Return a copy of the network's current weights."""
        self.collect()
        return self.deformation.values.copy()

    def take(self, values: np.ndarray) -> None:
        """Set the network's weights; the optimizer's moments are kept."""
        self._set(values)
        self.look()
        self.collect()

    def _set(self, values: np.ndarray) -> None:
        torch.as_tensor(self.adam.values).copy_(torch.from_numpy(np.array(values, np.float32)))
        self._hidden = None
        self.bake()

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays for a checkpoint."""
        values, taken = self.values(), np.asarray([self.taken])
        own = {"values": values, "taken": taken, "distances": self.field.occupancy.distances}
        return own | moments_of({"adam": self.adam})

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the state from arrays()."""
        restore_moments({"adam": self.adam}, arrays)
        self.taken = int(arrays["taken"][0])
        self._set(arrays["values"])
        self._place(arrays["distances"])


class Deformer(GridDeformer[np.ndarray]):
    """The CPU implementation. gradients: [threads, 3 vertices^3]."""

    def _prepare(self, threads: int) -> None:
        self._grid = torch.from_numpy(self.grid).view(-1, 3)
        self.gradients = np.zeros((threads, 3 * self.vertices**3), np.float32)
        self.adam = Adam(self.deformation.values, rates_of(self.deformation, self.anchored), 1, self.gradient_clip)

    def _gathered(self) -> Tensor:
        return torch.from_numpy(self.gradients.sum(0)).view(-1, 3)

    def look(self) -> None:
        # Non-finite values are reported by the next loss.
        if np.isfinite(self.grid).all():
            self.field.occupancy = displaced_occupancy(self.rest, self.grid)

    def _place(self, distances: np.ndarray) -> None:
        self.field.occupancy = OccupancyGrid(self.rest.cells, self.rest.highest)
        self.field.occupancy.distances = distances.copy()

    def _number(self, size: Tensor) -> float:
        return float(size)

    def collect(self) -> None: ...


AnyDeformer = GridDeformer[np.ndarray] | GridDeformer[Tensor]


def rates_of(deformation: Deformation, anchored: bool) -> list[tuple[int, int, float]]:
    """Return (begin, end, learning-rate factor) for the hidden and last layers or, if anchored, the last one's weights.

    Adam moves all weights of a unit by about the learning rate; at the last layer's rate, a few steps in one direction
    would permanently put every hidden unit below zero, and nothing would deform any more.
    """
    end = len(deformation.values)
    begin = end - deformation.last
    return [(begin, end - 3, 1.0)] if anchored else [(0, begin, HIDDEN_RATE), (begin, end, 1.0)]


def _pairs(active: np.ndarray, vertices: int) -> list[Tensor]:
    """Return, for each axis, which pairs of neighbors along it are both evaluated by the network."""
    own = torch.zeros(vertices**3, dtype=torch.bool)
    own[torch.from_numpy(active)] = True
    own = own.view((vertices,) * 3)
    return [own.narrow(axis, 1, vertices - 1) & own.narrow(axis, 0, vertices - 1) for axis in range(3)]


def random_rays(cameras: list[Camera], count: int, near: float, generator: np.random.Generator) -> Rays:
    """Return about `count` rays through random pixels, the same number per camera."""
    # Not in proportion to pixels: a single view of a hidden side must also find its vertices.
    origins, directions = [], []
    for camera in cameras:
        pixels = generator.integers(0, camera.width * camera.height, max(1, count // len(cameras)))
        of_camera = camera.rays(pixels)
        origins.append(of_camera[0])
        directions.append(of_camera[1])
    return Rays.of(np.concatenate(origins), np.concatenate(directions), near)


class PhotoError:
    """Mean squared error of a deforming field's rays, and its gradient.

    background: gray level behind the field. weight_threshold: see render_rays().
    """

    def __init__(self, deformer: Deformer, background: float, weight_threshold: float, threads: int) -> None:
        self.deformer, self.background, self.threads = deformer, np.float32(background), threads
        self.weight_threshold = weight_threshold
        self._memory = ScratchArena()

    def _rendered(
        self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray, jitter: np.ndarray | None = None
    ) -> tuple[Rendered, np.ndarray]:
        """Return rendered rays and their difference from the photos, both over the background."""
        field, back = self.deformer.field, self.background
        rays = Rays.of(origins, directions, field.space.near, jitter)
        threshold, arena = self.weight_threshold, self._memory.reset()
        rendered = render_rays(field, rays, threads=self.threads, weight_threshold=threshold, arena=arena)
        found = over(rendered.out[:, :3], rendered.out[:, 3:4], back)
        if field.opaque_background:
            colors = unhidden(colors, found)
        return rendered, found - target(colors, back)

    def of(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray) -> float:
        """Return the rays' mean squared error to straight rgba [n, 4], marched from the middle of their first step."""
        return float(np.square(self._rendered(origins, directions, colors)[1]).mean())

    def learn(self, origins: np.ndarray, directions: np.ndarray, colors: np.ndarray, jitter: np.ndarray) -> float:
        """Add dL/dD of the rays' mean squared error to the deformer's gradients; return the error."""
        rendered, difference = self._rendered(origins, directions, colors, jitter)
        gradients = np.zeros_like(rendered.out)
        gradients[:, :3] = difference * np.float32(2 / difference.size)
        # C = rgb + (1 - alpha) background, the same gray in every channel.
        gradients[:, 3] = -gradients[:, :3].sum(1) * self.background
        field = self.deformer.field
        if field.color_map is not None:
            before_map(gradients, *field.color_map.arrays())
        backward(field, rendered, gradients, None, None, self.deformer.gradients)
        return float(np.square(difference).mean())
