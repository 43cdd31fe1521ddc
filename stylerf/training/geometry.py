"""How a stylisation sees its scene: fixed surfaces that are coloured, or rays walked anew through a deforming field."""

import numpy as np

from stylerf.fields.field import RadianceField
from stylerf.fields.surface import Surface, surface_of
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.composite import shade, shade_backward


class FixedGeometry:
    """Colours on surfaces that do not move: every view is marched once and its samples are kept, up to `memory_mb`.

    share: part of a ray's largest weight that a sample needs to take part.
    """

    def __init__(
        self, field: RadianceField, cameras: list[Camera], share: float, chunks: int, memory_mb: float = 2048.0
    ) -> None:
        self.field, self.cameras, self.share, self.chunks = field, cameras, share, chunks
        self.memory_bytes = memory_mb * 1e6
        self._kept: dict[int, Surface] = {}

    def surface(self, view: int) -> Surface:
        """The samples of a view."""
        found = self._kept.get(view)
        if found is None:
            found = surface_of(self.field, self.cameras[view], self.share, self.chunks)
            if sum(s.bytes for s in self._kept.values()) + found.bytes <= self.memory_bytes:
                self._kept[view] = found
        return found

    def alpha(self, view: int) -> np.ndarray:
        """[h, w]."""
        return self.surface(view).alpha

    def paint(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, tuple]:
        """Premultiplied rgb [n, 3] of pixels, and what learn() needs."""
        starts, ends, x, weights = self.surface(view).samples(pixels)
        colours = self.field.colour.colours(x, None, starts, ends, weights, 0.0, self.chunks)
        out = np.empty((len(pixels), 3), np.float32)
        shade(weights, colours, starts, ends, out)
        return out, (starts, ends, x, weights, colours)

    def learn(self, kept: tuple, gradients: np.ndarray, colour_to: np.ndarray) -> None:
        """Add dL/d(colour values), from dL/d(rgb) [n, 3], to the chunks' buffers."""
        starts, ends, x, weights, colours = kept
        colour_gradients = np.empty_like(x)
        shade_backward(weights, gradients, starts, ends, colour_gradients)
        self.field.colour.backward(x, None, starts, ends, colours, colour_gradients, colour_to)
