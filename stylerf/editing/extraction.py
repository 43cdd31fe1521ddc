"""Extract a region's training data from the views: ray ends, photo colors and geometry edges.

LAENeRF, section 3.3 and supplement 1; deviations are noted where they occur.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stylerf.editing.edit_grid import Region, march_view
from stylerf.errors import InvalidValue
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.regions import ends_inside


@dataclass(frozen=True, eq=False)
class EditView:
    """The n pixels of one view that show the region; all arrays but `pixels` are float32.

    Attributes:
        view: Index of the scene's view.
        width, height: Of the view, pixels.
        pixels: [n] int64, row-major indices, ascending.
        x: [n, 3] ends of the rays, in the cube.
        along: [n, 3] change of x if the ray ends one jitter farther.
        directions: [n, 3] unit vectors from the camera.
        target: [n, 3] the photo, sRGB 0..1.
        weight: [n] alpha of the field.
        inside: [n] alpha_E, the part of alpha inside the region.
        depth: [n] mean distance along the ray within the region, scene units; 0 if the ray ends in the background.
        through: [n] sum(w t) over the whole ray, without its opaque background.
        transition: [n] lambda, 1 at the region's border with its surroundings, 0 far from it.
        edges: [n, 2] geometry edges zeta >= 0 to the pixel below and to the pixel on the right.

    Where a ray ends in the opaque background of a capture, `along`, `depth` and `edges` are 0.
    """

    view: int
    width: int
    height: int
    pixels: np.ndarray
    x: np.ndarray
    along: np.ndarray
    directions: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    inside: np.ndarray
    depth: np.ndarray
    through: np.ndarray
    transition: np.ndarray
    edges: np.ndarray

    def __len__(self) -> int:
        return len(self.pixels)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the pixels' bounding box, both ends included (LAENeRF's code drops the last)."""
        rows, columns = np.divmod(self.pixels, self.width)
        return slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)

    def pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return (upper, lower, left, right): indices into `pixels` of all vertical and horizontal neighbors."""
        # Padded by a row and a pixel, so that indices below the last row and right of the last pixel are valid.
        place = np.full(self.width * (self.height + 1) + 1, -1, np.int64)
        place[self.pixels] = np.arange(len(self.pixels))
        below = place[self.pixels + self.width]
        # The pixel after a row's last one is the next row's first, not a neighbor.
        beside = np.where(self.pixels % self.width < self.width - 1, place[self.pixels + 1], -1)
        upper, left = np.flatnonzero(below >= 0), np.flatnonzero(beside >= 0)
        return upper, below[upper], left, beside[left]


def check_pixels(pixels: np.ndarray, what: str, width: int, height: int) -> None:
    """Raise InvalidValue if row-major pixel indices [n] int64 are outside an image of this size."""
    if len(pixels) and not (0 <= pixels.min() and pixels.max() < width * height):
        raise InvalidValue(f"the array {what} holds pixels outside {width}x{height}")


JITTERS = 512  # a jitter is this fraction of a view's depth range
OPAQUE = 0.5  # minimum alpha of an edited pixel, both of the field and of the photo
SURE = 0.98  # minimum weight of a pixel whose depth counts for edges
EVERYWHERE = np.ones((1, 1, 1), bool)  # the whole cube, as one marked cell
MOSTLY = 0.5  # a ray ends in the background if no more than this fraction of its alpha inside is in front of it
TOUCHING = 0.5  # minimum fraction of a ray's opacity inside the growing grid for the ray to end there


@dataclass(frozen=True)
class Extraction:
    """tolerance: maximum opacity of a ray outside the region. reach: width of the transition, scene units."""

    tolerance: float = 0.5
    reach: float = 0.0


@dataclass(frozen=True)
class Seen:
    """A view of the region and, for all pixels, [h, w]: alpha of the field, alpha of the region, depth (0: none).

    There is no depth where the region is not visible or where the ray ends in the background.
    """

    edit: EditView | None
    alpha: np.ndarray
    alpha_edit: np.ndarray
    depth: np.ndarray


def ends_of_view(field: RadianceField, camera: Camera, grids: list[np.ndarray], threads: int) -> list[np.ndarray]:
    """Return, for each grid of marked cells, [pixels, 6]: alpha, alpha inside, depth along the ray (scene units), x.

    Depth and x are weighted means over the samples inside. LAENeRF uses sums over all samples of the ray, not divided
    by alpha, which end before the surface if the ray is not fully opaque. The depth excludes the opaque background, and
    is 0 if that contributes at least half of the alpha inside.
    """
    flat = [np.ascontiguousarray(marked).reshape(-1) for marked in grids]
    outs = [np.empty((camera.height * camera.width, 6), np.float32) for _ in grids]
    for part, s in march_view(field, camera, threads):
        # The opaque background has no distance: its t is only the end of the marching range.
        foreground = np.where(s.deltas > 0, s.weights, np.float32(0))
        for marked, own, out in zip(grids, flat, outs):
            weights = foreground if marked is EVERYWHERE else s.weights
            ends_inside(own, marked.shape[0], s.shading_points(weights), s.t, threads, out[part])
            _to_means(out[part])
            if field.opaque_background and marked is not EVERYWHERE:
                before = np.empty_like(out[part])
                ends_inside(own, marked.shape[0], s.shading_points(foreground), s.t, threads, before)
                _to_means(before)
                out[part, 2] = np.where(before[:, 1] > MOSTLY * out[part, 1], before[:, 2], 0)
    return outs


def _to_means(ends: np.ndarray) -> None:
    """Divide sums over the samples inside by their weight, in place; sums stay 0 where nothing is inside."""
    ends[:, 2:] /= np.maximum(ends[:, 1:2], 1e-8)


def seen_of_view(
    field: RadianceField,
    camera: Camera,
    photo: np.ndarray,
    region: Region,
    settings: Extraction,
    view: int,
    threads: int,
    ends_of: Callable[[Camera, list[np.ndarray]], list[np.ndarray]] | None = None,
) -> Seen:
    """Extract what a view shows of the region; `edit` is None if it shows nothing.

    A pixel is used if at most `tolerance` of its opacity is outside the region, which excludes floaters and occluders.
    Unlike in LAENeRF, where silhouettes add black to the palette, colors are not premultiplied.

    Args:
        photo: [h, w, 3 or 4] sRGB 0..1.
        settings: Tolerance and width of the transition.
        ends_of: Replaces ends_of_view(), to run on another device.
    """
    fading = settings.reach > 0 and bool(region.grow.any())
    grids = [region.edit, region.grow, EVERYWHERE] if fading else [region.edit, EVERYWHERE]
    ends, *around, rays = ends_of(camera, grids) if ends_of else ends_of_view(field, camera, grids, threads)
    alpha, inside = np.clip(ends[:, 0], 0, 1), np.clip(ends[:, 1], 0, 1)
    shape = (camera.height, camera.width)
    shown = (alpha > OPAQUE) & (alpha - inside <= settings.tolerance) & (inside > 1e-3)
    if photo.shape[2] == 4:
        shown &= photo[..., 3].ravel() > OPAQUE
    depth = np.where(shown, ends[:, 2], 0).astype(np.float32)
    whole = Seen(None, alpha.reshape(shape), inside.reshape(shape), depth.reshape(shape))
    pixels = np.flatnonzero(shown)
    if not len(pixels):
        return whole
    colors = photo[..., :3]
    weight = np.where(shown, alpha, 0).reshape(shape).astype(np.float32)
    origins, directions = camera.rays(pixels)
    x = np.ascontiguousarray(np.clip(ends[pixels, 3:], 0, 1))
    edit = EditView(
        view=view,
        width=camera.width,
        height=camera.height,
        pixels=pixels,
        x=x,
        along=_along(field, origins, directions, depth[pixels]),
        directions=np.ascontiguousarray(directions, np.float32),
        target=np.ascontiguousarray(colors.reshape(-1, 3)[pixels], np.float32),
        weight=weight.ravel()[pixels],
        inside=inside[pixels].astype(np.float32),
        depth=depth[pixels],
        through=(rays[pixels, 1] * rays[pixels, 2]).astype(np.float32),
        transition=_transition(field, x, around[0], settings.reach) if fading else np.zeros(len(x), np.float32),
        edges=_edges(whole.depth, np.where(whole.depth > 0, weight, 0), colors)[pixels],
    )
    return Seen(edit, whole.alpha, whole.alpha_edit, whole.depth)


def _along(field: RadianceField, origins: np.ndarray, directions: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the change of x [n, 3], in the cube, over one jitter: the view's depth range divided by JITTERS.

    0 where the depth is 0, that is, where the ray ends in the background.
    """
    # Central difference: the warp is nonlinear, so the step in the cube depends on the depth.
    half = _range(depth) / (2 * JITTERS)
    ends = [field.space.warp(origins + directions * (depth + side)[:, None]) for side in (-half, half)]
    return np.where(depth[:, None] > 0, ends[1] - ends[0], 0).astype(np.float32)


def _range(depth: np.ndarray) -> float:
    """Return the range of a view's nonzero depths."""
    there = depth[depth > 0]
    return float(there.max() - there.min()) if len(there) else 0.0


def _transition(field: RadianceField, x: np.ndarray, ends: np.ndarray, reach: float) -> np.ndarray:
    """Return lambda [n]: 1 where the region touches the growing grid, falling to 0 at a distance of `reach`.

    Distances are to the ends of the view's rays in the growing grid. LAENeRF divides by the largest distance in the
    view; a fixed width gives the same lambda in every view.

    Args:
        x: [n, 3] ends of rays in the region.
        ends: From ends_of_view(), for the growing grid and all rays of the view.
        reach: Width, scene units.
    """
    touching = ends[:, 1] > TOUCHING * np.maximum(ends[:, 0], 1e-3)
    if not touching.any():
        return np.zeros(len(x), np.float32)
    from scipy.spatial import cKDTree  # takes half a second to import, and no other verb needs it

    unwarp = field.space.unwarp
    # In unbounded spaces, the border of the cube is infinitely far away.
    there, here = (unwarp(np.clip(p, 1e-6, 1 - 1e-6)) for p in (ends[touching, 3:], x))
    away, _ = cKDTree(there).query(here, distance_upper_bound=reach)
    return (1 - np.minimum(away, reach) / reach).astype(np.float32)


def _edges(depth: np.ndarray, weight: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Return geometry edges zeta [h*w, 2], 0..1, to the pixel below and to the pixel on the right.

    |D_i - D_{i+1}|, relative to the view's depth range and so independent of the scene's unit, times the weights of
    four consecutive pixels, times the difference of the photo's colors (which the released code has, but not
    supplementary eq. 1).
    """
    sure = np.where(weight < SURE, 0, weight)
    spread = max(_range(depth), 1e-6)
    zeta = np.zeros((*depth.shape, 2), np.float32)
    for axis in (0, 1):
        d, c, w = (np.moveaxis(values, axis, 0) for values in (depth, colors, sure))
        # Pixels beyond the border have weight 0: an edge needs two reliable pixels on both sides.
        w = np.pad(w, ((1, 1), (0, 0)))
        step = np.abs(d[:-1] - d[1:]) / spread * np.abs(c[:-1] - c[1:]).sum(-1)
        np.moveaxis(zeta[..., axis], axis, 0)[:-1] = np.clip(w[:-3] * w[1:-2] * w[2:-1] * w[3:] * step, 0, 1)
    return zeta.reshape(-1, 2)
