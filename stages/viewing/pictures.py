"""Pictures of what is shown: rendered pixels, and an exact picture that can be recolored without rerendering."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np

from stages.viewing.cameras import Pose
from stages.viewing.shown import WITH_DISTANCE, Shown, picture_of
from stylerf.fields.marching import ScratchArena
from stylerf.fields.protocol import ColorPart
from stylerf.geometry.cameras import Camera
from stylerf.rendering.interlaced import coarsest_within, render_pixels
from stylerf.rendering.pixel_mixtures import Mixing, MixtureRecorder, colors_of
from stylerf.rendering.ray_registration import every

MOST_MIXTURES = 250_000  # pixels of a picture that is recolored in one go: more would take noticeably long
STRIDES = (1, 2, 4, 8, 16, 32)


@dataclass(frozen=True)
class Quality:
    """How rays are marched.

    Attributes:
        min_transmittance: Where they end.
        steps: Length of a step, relative to the field's own. At 2, PSNR to 1 is 38 to 46 dB (126 x 94 pixels).
    """

    min_transmittance: float = 1e-3
    steps: float = 1.0


EXACT = Quality()


@dataclass(eq=False)
class Mixtures:
    """The color mixtures of an exact picture's pixels, for those on the grid of a stride.

    Attributes:
        means: [pixels, mixture_width] mean mixtures.
        shares: [pixels] fraction of the pixel's light that is mixed.
    """

    stride: int
    means: np.ndarray = field(repr=False)
    shares: np.ndarray = field(repr=False)

    @staticmethod
    def room_for(camera: Camera, shown: Shown) -> "Mixtures | None":
        """Return storage for the mixtures of a picture; None if its colors are not mixtures."""
        color = shown.left.field.color
        if not isinstance(color, Mixing) or shown.plane != "color":
            return None
        stride = coarsest_within(camera.width * camera.height, MOST_MIXTURES, STRIDES)
        count = -(-camera.width // stride) * -(-camera.height // stride)
        return Mixtures(stride, np.zeros((count, color.mixture_width), np.float32), np.zeros(count, np.float32))

    def keep(self, camera: Camera, pixels: np.ndarray, recorder: MixtureRecorder) -> None:
        """Store the mixtures of rendered pixels [n], row-major."""
        rows, columns = np.divmod(pixels, camera.width)
        on = (rows % self.stride == 0) & (columns % self.stride == 0)
        at = rows[on] // self.stride * -(-camera.width // self.stride) + columns[on] // self.stride
        self.means[at], self.shares[at] = recorder.means[on], recorder.shares[on]


@dataclass(eq=False)
class Painted:
    """An exact picture.

    Attributes:
        pose, shown: What it shows.
        camera: Of its pixels.
        out: [h, w, 6] as of interlaced.render_pixels.
        mixtures: Of its colors, None if they are not mixtures.
    """

    pose: Pose
    shown: Shown
    camera: Camera
    out: np.ndarray = field(repr=False)
    mixtures: Mixtures | None = None

    def _colors(self, shown: Shown, at: np.ndarray | slice) -> np.ndarray:
        """Return the colors [n, 3] of mixtures under the palette of what is shown."""
        assert self.mixtures is not None
        seen = shown.left.field
        return colors_of(cast(Mixing, seen.color), self.mixtures.means[at], seen.color_map)

    @cached_property
    def _own(self) -> np.ndarray:
        return self._colors(self.shown, slice(None))

    def recolors_to(self, pose: Pose, shown: Shown) -> bool:
        """Return whether something else to show differs from this picture only in its palette."""
        old, now, mixtures = self.shown.left.field, shown.left.field, self.mixtures
        same = self.pose == pose and self.shown.differs_by_colors(shown) and old.color_map is now.color_map
        color = old.color
        return same and mixtures is not None and isinstance(color, Mixing) and color.mixes_as(now.color)

    def recolored(self, shown: Shown, thinned: int = 1) -> np.ndarray:
        """Return the picture [h, w, 3] uint8 under another palette, approximately; see pixel_mixtures.

        Args:
            thinned: stride of the pixels of the mixtures' grid that are used; others are left out.
        """
        assert self.mixtures is not None
        stride = self.mixtures.stride * thinned
        grid = self.out[::stride, ::stride].copy()
        alpha = grid[..., 3:4]
        wide = -(-self.camera.width // self.mixtures.stride)
        at = np.arange(len(self.mixtures.means)).reshape(-1, wide)[::thinned, ::thinned].ravel()
        change = (self._colors(shown, at) - self._own[at]) * self.mixtures.shares[at, None]
        grid[..., :3] = np.clip(grid[..., :3] + alpha * change.reshape(*alpha.shape[:2], 3), 0, alpha)
        return picture_of(shown, every(self.camera, stride), grid)


def render(
    camera: Camera,
    shown: Shown,
    pixels: np.ndarray,
    threads: int,
    arena: ScratchArena,
    quality: Quality = EXACT,
    mixtures: Mixtures | None = None,
) -> np.ndarray:
    """Render pixels [n] of either side of the wipe: [n, 6]. mixtures: receives the mixtures of those on the left."""
    out = np.empty((len(pixels), 6), np.float32)
    right = pixels % camera.width >= shown.boundary(camera.width)
    for source, which in ((shown.left, ~right), (shown.right, right)):
        if source is None or not which.any():
            continue
        seen, recorder = source.field, None
        if quality.steps != 1:
            seen = replace(seen, step=seen.step * quality.steps)
        if mixtures is not None and source is shown.left and isinstance(seen.color, Mixing):
            recorder = MixtureRecorder(seen.color)
            seen = replace(seen, color=cast(ColorPart, recorder))  # all that rendering needs of a color
        out[which] = render_pixels(
            seen,
            camera,
            pixels[which],
            threads=threads,
            min_transmittance=quality.min_transmittance,
            distances=shown.plane in WITH_DISTANCE,
            marked=shown.marked,
            arena=arena,
        )
        if mixtures is not None and recorder is not None:
            mixtures.keep(camera, pixels[which], recorder)
    return out
