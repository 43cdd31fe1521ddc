"""What the views show of a region: where rays end in it, what the photos have there, and where its geometry has edges.

LAENeRF, section 3.3 and supplementary 1; what differs is told at each place.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from stylerf.editing.edit_grid import Region, march_view
from stylerf.editing.edit_views import EditView
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.regions import ends_inside

JITTERS = 512  # the depths of a view are that many jitters apart
OPAQUE = 0.5  # alpha, of the field and of the photo, under which a pixel is too little of anything to be edited
SURE = 0.98  # weight of a pixel from which its depth counts for an edge
EVERYWHERE = np.ones((1, 1, 1), bool)  # the whole cube, as one marked cell
TOUCHING = 0.5  # share of a ray's opacity inside the growing grid from which the ray ends there


@dataclass(frozen=True)
class Extraction:
    """tolerance: opacity of a ray that may lie outside the region. reach: width of the transition, scene units."""

    tolerance: float = 0.5
    reach: float = 0.0


@dataclass(frozen=True)
class Seen:
    """A view of the region and, for all its pixels, [h, w]: alpha of the field, of the region, and depth (0: none)."""

    edit: EditView | None
    alpha: np.ndarray
    alpha_edit: np.ndarray
    depth: np.ndarray


def ends_of_view(field: RadianceField, camera: Camera, grids: list[np.ndarray], chunks: int) -> list[np.ndarray]:
    """By grid of marked cells [pixels, 6]: alpha, alpha inside, depth (scene units, along the ray) and x there.

    Depth and x are means over the samples inside, by weight. LAENeRF takes sums over all samples of the ray, not
    divided by alpha, which puts ends short of their surface wherever the ray is not quite opaque.
    """
    flat = [np.ascontiguousarray(marked).reshape(-1) for marked in grids]
    outs = [np.empty((camera.height * camera.width, 6), np.float32) for _ in grids]
    for part, s in march_view(field, camera, chunks):
        # Of whole rays what meets the backdrop has no distance, as in the depth that they are compared with.
        of_things = np.where(s.deltas > 0, s.weights, np.float32(0))
        for marked, own, out in zip(grids, flat, outs):
            weights = of_things if marked is EVERYWHERE else s.weights
            ends_inside(own, marked.shape[0], s.shading_points(weights), s.t, chunks, out[part])
    for out in outs:
        out[:, 2:] /= np.maximum(out[:, 1:2], 1e-8)
    return outs


def seen_of_view(
    field: RadianceField,
    camera: Camera,
    photo: np.ndarray,
    region: Region,
    settings: Extraction,
    view: int,
    chunks: int,
    ends_of: Callable[[Camera, list[np.ndarray]], list[np.ndarray]] | None = None,
) -> Seen:
    """What view number `view` shows of the region; edit is None where it shows nothing.

    photo: [h, w, 3 or 4] sRGB 0..1. A pixel counts where at most `tolerance` of its opacity lies outside the region,
    which leaves out what floats before it or hides it. Colors are the photo's own, not times its alpha as in LAENeRF:
    silhouettes would teach the palette a black that is not there. ends_of: ends_of_view on another device; None: here.
    """
    fading = settings.reach > 0 and bool(region.grow.any())
    grids = [region.edit, region.grow, EVERYWHERE] if fading else [region.edit, EVERYWHERE]
    ends, *around, rays = ends_of(camera, grids) if ends_of else ends_of_view(field, camera, grids, chunks)
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
        edges=_edges(depth.reshape(shape), weight, colors)[pixels],
    )
    return Seen(edit, whole.alpha, whole.alpha_edit, whole.depth)


def _along(field: RadianceField, origins: np.ndarray, directions: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """[n, 3] what x moves by, in the cube, over one jitter: a JITTERS-th of the depths that the view spans."""
    half = (depth.max() - depth.min()) / (2 * JITTERS)
    ends = [field.space.warp(origins + directions * (depth + side)[:, None]) for side in (-half, half)]
    return (ends[1] - ends[0]).astype(np.float32)


def _transition(field: RadianceField, x: np.ndarray, ends: np.ndarray, reach: float) -> np.ndarray:
    """lambda [n]: 1 where the region touches the growing grid, falling to 0 at `reach` from it, scene units.

    ends: of all rays of the view, in the growing grid.

    Distances are to the ends of this view's rays in the growing grid. LAENeRF divides by the largest distance in the
    view; a fixed width makes one place the same in every view.
    """
    touching = ends[:, 1] > TOUCHING * np.maximum(ends[:, 0], 1e-3)
    if not touching.any():
        return np.zeros(len(x), np.float32)
    unwarp = field.space.unwarp
    there, here = (unwarp(np.clip(p, 1e-6, 1 - 1e-6)) for p in (ends[touching, 3:], x))
    away, _ = cKDTree(there).query(here, distance_upper_bound=reach)
    return (1 - np.minimum(away, reach) / reach).astype(np.float32)


def _edges(depth: np.ndarray, weight: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """zeta [h*w, 2] in 0..1: geometry edges between a pixel and the one below it, and the one right of it.

    |D_i - D_{i+1}| (in shares of the view's depths) times the weights of four pixels in a row, times the difference of
    the photo's colors (supplementary eq. 1 has no colors, the released code does). The share makes it free of the
    scene's unit.
    """
    sure = np.where(weight < SURE, 0, weight)
    shown = depth > 0
    spread = max(float(depth[shown].max() - depth[shown].min()), 1e-6) if shown.any() else 1.0
    zeta = np.zeros((*depth.shape, 2), np.float32)
    for axis in (0, 1):
        first, last = (slice(None, -1), slice(1, None))
        a = (first, slice(None)) if axis == 0 else (slice(None), first)
        b = (last, slice(None)) if axis == 0 else (slice(None), last)
        before, after = np.roll(sure, 1, axis), np.roll(sure, -1, axis)
        if axis == 0:
            before[0], after[-1] = 0, 0
        else:
            before[:, 0], after[:, -1] = 0, 0
        run = before[a] * sure[a] * sure[b] * after[b]
        step = np.abs(depth[a] - depth[b]) / spread * np.abs(colors[a] - colors[b]).sum(-1)
        zeta[a][..., axis] = np.clip(run * step, 0, 1)
    return zeta.reshape(-1, 2)
