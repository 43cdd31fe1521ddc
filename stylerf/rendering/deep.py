"""Deep views: for each pixel, the segments along its ray, each with its own color and alpha."""

from dataclasses import dataclass

import numpy as np

from stylerf.fields.marching import SAMPLES_PER_RAY, space_arrays
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.deep import segments
from stylerf.rendering.rays import Rendered


@dataclass(frozen=True, eq=False)
class DeepView:
    """The segments of a view, pixel by pixel in row-major order, front to back within a pixel.

    Attributes:
        counts: [h, w], number of segments per pixel.
        z, z_back: [n], planar depth of a segment's front and back, scene units.
        rgb: [n, 3], sRGB-encoded, premultiplied by the weight.
        weights: [n], the segment's contribution to its pixel's alpha; a pixel's weights add up to its alpha.
    """

    counts: np.ndarray
    z: np.ndarray
    z_back: np.ndarray
    rgb: np.ndarray
    weights: np.ndarray


class DeepCollector:
    """Collects the segments of a view, batch by batch, while render_view() renders it."""

    def __init__(self, field: RadianceField, camera: Camera, most: int, threads: int) -> None:
        """most: maximum number of segments per pixel, at least 1."""
        self._field, self._camera, self._most, self._threads = field, camera, most, threads
        self._cosines, self._seen = camera.ray_cosines().reshape(-1), camera.has_ray().reshape(-1)
        self._counts = np.zeros(camera.width * camera.height, np.int64)
        self._parts: list[np.ndarray] = []

    def add(self, pixels: np.ndarray, rendered: Rendered) -> None:
        """Add rendered pixels [n]; batches must be in row order, pixels within a batch may be in any order."""
        counts = np.zeros(len(pixels), np.int64)
        found = np.empty((len(pixels), self._most, 6), np.float32)
        segments(
            rendered.samples, rendered.colors, rendered.rays, space_arrays(self._field.space),
            np.float32(self._field.step), self._most, SAMPLES_PER_RAY, self._threads, counts, found,
        )  # fmt: skip
        counts[~self._seen[pixels]] = 0
        order = np.argsort(pixels)
        counts, pixels = counts[order], pixels[order]
        kept = found[order][np.arange(self._most) < counts[:, None]]
        kept[:, :2] *= np.repeat(self._cosines[pixels], counts)[:, None]
        self._counts[pixels] = counts
        self._parts.append(kept)

    def view(self) -> DeepView:
        """Return all segments added so far, with the field's color map applied."""
        found = np.concatenate(self._parts)
        rgb, weights = found[:, 2:5], found[:, 5]
        if self._field.color_map is not None:
            import torch

            rgb = self._field.color_map.premultiplied(torch.from_numpy(rgb), torch.from_numpy(weights)).numpy()
        rgb = np.clip(rgb, 0, weights[:, None])
        return DeepView(self._counts.reshape(self._camera.height, -1), found[:, 0], found[:, 1], rgb, weights)
