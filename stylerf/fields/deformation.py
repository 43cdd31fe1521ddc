"""Space deformation x' = x + D(x): a small MLP over encoded positions (DeSRF, section 3.2), baked to a grid.

Gradients reach the displacement grid from densities and colors; only vertices near visible surfaces matter.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from stylerf import validation
from stylerf.errors import InvalidValue
from stylerf.fields.marching import SAMPLES_PER_RAY, displacement_arrays, occupancy_arrays, space_arrays
from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.protocol import ColorPart, DensityPart
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.compositing import visible_weights
from stylerf.kernels.cpu.deformation import displaced_cells, displacement_backward, mark_cells
from stylerf.kernels.cpu.ray_samples import Rays, Samples

if TYPE_CHECKING:  # torch takes more than a second to import, and a field is rendered without its network
    from torch import Tensor

# Adam moves every weight by about the learning rate, so a sum over 256 weights moves by up to 256 times that. Without
# this factor, a rate of 1e-3 would move a scene by a twentieth of its size per step.
SCALE = 0.05
# Largest displacement per axis, cube units. Without a bound, any rate that bends an object eventually tears it: nothing
# in a style loss holds its parts together (decision 0015).
FARTHEST = 0.04


class Deformation:
    """D = MLP(gamma(p)), p = 2 x - 1 for cube positions x in 0..1; values: weights and biases, layer by layer.

    gamma(p) = (p, sin 2^l pi p, cos 2^l pi p for l < frequencies), then three linear layers with ReLU in between. D is
    in cube units: SCALE / 2 times the network's output (the cube spans two units of p), with each component bounded
    by `reach` through a tanh.
    """

    def __init__(self, frequencies: int, width: int, values: np.ndarray, reach: float = FARTHEST) -> None:
        self.frequencies, self.width, self.values, self.reach = int(frequencies), int(width), values, float(reach)
        if len(values) != sum((inside + 1) * outside for inside, outside in self._layers()):
            raise InvalidValue(f"deformation: {len(values)} values do not make a network of width {width}")

    @classmethod
    def create(cls, generator: np.random.Generator, frequencies: int = 5, width: int = 256) -> "Deformation":
        """Create the identity deformation: the last layer is zero."""
        parts = []
        for inside, outside in _layers(frequencies, width)[:-1]:
            bound = math.sqrt(6.0 / inside)  # He et al. 2015, for ReLU
            parts += [generator.uniform(-bound, bound, inside * outside), np.zeros(outside)]
        parts.append(np.zeros((width + 1) * 3))
        return cls(frequencies, width, np.concatenate(parts).astype(np.float32))

    def _layers(self) -> list[tuple[int, int]]:
        return _layers(self.frequencies, self.width)

    def encode(self, positions: "Tensor") -> "Tensor":
        """Return gamma(p) [n, 3 + 6 frequencies] for cube positions [n, 3]."""
        import torch

        p = 2 * positions - 1
        scaled = p[:, None] * (math.pi * 2.0 ** torch.arange(self.frequencies, dtype=p.dtype))[:, None]
        return torch.cat([p, torch.cat([scaled.sin(), scaled.cos()], -1).flatten(1)], 1)

    @property
    def last(self) -> int:
        """Number of values in the last layer: weights [3, width], then biases [3]."""
        return 3 * (self.width + 1)

    def network(self, encoded: "Tensor", values: "Tensor") -> "Tensor":
        """Return D [n, 3], cube units, for encoded positions [n, 3 + 6 frequencies] and the weights `values`."""
        return self.moved(self.hidden(encoded, values), values[-self.last :])

    def hidden(self, encoded: "Tensor", values: "Tensor") -> "Tensor":
        """Return the outputs of the second-to-last layer, [n, width]."""
        out, at = encoded, 0
        for inside, outside in self._layers()[:-1]:
            end = at + (inside + 1) * outside
            out = _linear(out, values[at:end], outside).relu()
            at = end
        return out

    def moved(self, hidden: "Tensor", last: "Tensor") -> "Tensor":
        """Return D [n, 3], cube units, from the outputs of hidden() and the last layer's values `last`."""
        import torch

        return self.reach * torch.tanh((0.5 * SCALE / self.reach) * _linear(hidden, last, 3))

    def describe(self) -> dict:
        return {"kind": "mlp", "frequencies": self.frequencies, "width": self.width, "reach": self.reach}

    @classmethod
    def restore(cls, data: dict, values: np.ndarray) -> "Deformation":
        frequencies, width = validation.integer(data, "frequencies", 0, 16), validation.integer(data, "width", 1, 1024)
        validation.one_of(data, "kind", ("mlp",))
        # Older files have no "reach".
        reach = validation.number(data, "reach", 1e-3, 1.0) if "reach" in data else FARTHEST
        return cls(frequencies, width, values, reach)


def _linear(x: "Tensor", values: "Tensor", outside: int) -> "Tensor":
    """x W^T + b; values: W [outside, inside], then b [outside]."""
    import torch

    return torch.nn.functional.linear(x, values[:-outside].view(outside, -1), values[-outside:])


def _layers(frequencies: int, width: int) -> list[tuple[int, int]]:
    return [(3 + 6 * frequencies, width), (width, width), (width, 3)]


# -- the grid ----------------------------------------------------------------------------------------------------------


def position_gradients(
    density: DensityPart | None, color: ColorPart | None, samples: Samples, basis, sigma_gradients, colors,
    color_gradients, threads: int,
) -> np.ndarray:  # fmt: skip
    """Return dL/dx' [n, 3], set only in samples.starts:ends. A part that is None is fixed in space."""
    out = np.zeros(samples.x.shape, np.float32)  # zeros_like would touch the padding pages between threads
    if density is not None:
        density.add_position_gradients(samples, sigma_gradients, out, threads)
    if color is not None:
        points = samples.shading_points()
        color.add_position_gradients(points, basis, colors, color_gradients, out, threads)
    return out


def displacement_gradient(
    space: SpaceWarp, rays: Rays, samples: Samples, gradients: np.ndarray, vertices: int, to: np.ndarray
) -> None:
    """Add dL/dD to the per-thread buffers `to` [threads, 3 vertices^3], from dL/dx' [n, 3]; D: [vertices]^3 x 3."""
    displacement_backward(space_arrays(space), rays, samples, gradients, vertices, to)


def displaced_occupancy(occupancy: OccupancyGrid, displacement: np.ndarray) -> OccupancyGrid:
    """Return the occupancy of all x whose x + D(x) is in an occupied cell; displacement: [m, m, m, 3], cube units."""
    reach = int(np.ceil(np.abs(displacement).max() * occupancy.cells)) + 1
    occupied = np.zeros(occupancy.cells**3, np.bool_)
    displaced_cells(occupancy_arrays(occupancy), displacement_arrays(displacement), reach, occupied)
    moved = OccupancyGrid(occupancy.cells, occupancy.highest)
    moved.set_occupied(occupied)
    return moved


def at_rest(field: RadianceField) -> None:
    """Remove a field's deformation and recompute its occupancy from its own densities.

    The occupancy of a deformed field marks the cells that displacement maps to matter, not those that hold it.
    """
    if field.displacement is None:
        return
    field.displacement = None
    field.occupancy = OccupancyGrid(field.occupancy.cells, field.occupancy.highest)
    field.occupancy.decide(field.step)


def seen_cells(field: RadianceField, rays: Rays, cells: int, weight_threshold: float, threads: int) -> np.ndarray:
    """Return [cells, cells, cells] bool: the cells of a regular grid over the cube in which rays see the field.

    weight_threshold: fraction of its ray's largest weight above which a sample counts as seen.
    """
    seen = np.zeros((cells,) * 3, np.bool_)
    for at in range(0, len(rays.origins), 8192):
        samples = field.march(Rays(*(array[at : at + 8192] for array in rays)), SAMPLES_PER_RAY, 1e-3, threads)
        visible = np.empty_like(samples.weights)
        visible_weights(samples, np.float32(weight_threshold), threads, visible)
        mark_cells(samples.shading_points(visible), cells + 1, seen)
    return seen


def vertices_of(seen: np.ndarray) -> np.ndarray:
    """Return ascending flat indices of the vertices of seen cells, on a grid with one more vertex per side."""
    vertices = np.zeros([side + 1 for side in seen.shape], np.bool_)
    for corner in np.ndindex(2, 2, 2):
        vertices[tuple(slice(low, low + side) for low, side in zip(corner, seen.shape))] |= seen
    return np.flatnonzero(vertices)


def occupancy_of_seen(field: RadianceField, rays: Rays, threads: int) -> OccupancyGrid:
    """Return the field's occupancy without the cells that no ray sees (fern: 28 % of all cells instead of 40 %).

    Keeps cells with a sample of at least 2 % of its ray's largest weight, and their neighbors.
    """
    from scipy.ndimage import binary_dilation

    rest = field.occupancy
    seen = binary_dilation(seen_cells(field, rays, rest.cells, 0.02, threads), np.ones((3, 3, 3)))
    found = OccupancyGrid(rest.cells, rest.highest)
    found.set_occupied(seen.ravel() & (rest.distances == 0))
    return found
