"""Differentiable rasterization of 3D Gaussians on the CPU (kernels/cpu/splats.py)."""

from dataclasses import dataclass

import numpy as np

from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.simd_splats import PAIR, PIXELS, TILE
from stylerf.kernels.cpu.splats import (
    SCREEN,
    Gaussians,
    SplatCamera,
    blend,
    blend_backward,
    count_pairs,
    fill_pairs,
    project,
    project_backward,
    sort_by_depth,
)


@dataclass(frozen=True)
class Splatted:
    """An image of Gaussians, with everything that its gradients need.

    Attributes:
        image: [h, w, 4] float32: premultiplied rgb, sRGB-encoded, and alpha.
        camera, screen, boxes: in the kernels' format, for all Gaussians.
        order: [seen] int32, the visible Gaussians, nearest first.
        first_pairs, places, members, tile_ends: which Gaussians overlap which tiles.
        tiles: [tiles, 4, PIXELS], the image by tiles: premultiplied rgb and transmittance.
    """

    image: np.ndarray
    camera: SplatCamera
    screen: np.ndarray
    boxes: np.ndarray
    order: np.ndarray
    first_pairs: np.ndarray
    places: np.ndarray
    members: np.ndarray
    tile_ends: np.ndarray
    tiles: np.ndarray


def splat(gaussians: Gaussians, camera: Camera, *, near: float, threads: int) -> Splatted:
    """Render Gaussians; the result does not depend on the number of threads.

    Args:
        gaussians: may be empty.
        near: minimum depth of a center, scene units, positive.
    """
    n, as_read = len(gaussians.centers), splat_camera(camera, near)
    screen, depths = np.empty((n, SCREEN), np.float32), np.empty(n, np.float32)
    boxes = np.empty((n, 4), np.int32)
    project(gaussians, as_read, threads, screen, depths, boxes)
    image, *lists = draw_projected(screen, boxes, depths, camera.width, camera.height, threads)
    return Splatted(image, as_read, screen, boxes, *lists)


def draw_projected(
    screen: np.ndarray, boxes: np.ndarray, depths: np.ndarray, width: int, height: int, threads: int
) -> tuple[np.ndarray, ...]:
    """Render Gaussians projected by project(); return the image, order and lists of a Splatted."""
    n = len(boxes)
    order = np.empty(n, np.int32)
    order = order[: sort_by_depth(depths, boxes, order, np.empty(n, np.int32))]
    across, down = _tiles(width), _tiles(height)
    tile_ends, first_pairs = np.empty(across * down + 1, np.int64), np.empty(len(order) + 1, np.int64)
    pairs = count_pairs(boxes, order, len(order), across, tile_ends, first_pairs)
    members, places = np.empty(pairs, np.int32), np.empty(pairs, np.int32)
    fill_pairs(boxes, order, len(order), across, tile_ends, members, places)
    tiles = np.empty((across * down, 4, PIXELS), np.float32)
    blend(screen, boxes, tile_ends, members, across, threads, tiles)
    image = _image(tiles, width, height)
    image[..., 3] = 1 - image[..., 3]
    return image, order, first_pairs, places, members, tile_ends, tiles


def splat_backward(
    gaussians: Gaussians, splatted: Splatted, image_gradients: np.ndarray, gradients: Gaussians, threads: int
) -> None:
    """Write dL/d(gaussians) of the visible ones to `gradients`, in the same format; other entries are unchanged.

    Args:
        image_gradients: [h, w, 4] float32, dL/d(image).
    """
    across = _tiles(splatted.camera.width)
    sums = np.empty((len(splatted.members), PAIR), np.float32)
    by_tiles = _by_tiles(image_gradients)
    where = splatted.screen, splatted.boxes, splatted.tile_ends, splatted.members, across
    blend_backward(*where, splatted.tiles, by_tiles, threads, sums)
    order, pairs = splatted.order, (splatted.first_pairs, splatted.places)
    project_backward(
        gaussians, splatted.camera, splatted.screen, order, len(order), *pairs, sums, threads, gradients
    )  # fmt: skip


def splat_camera(camera: Camera, near: float) -> SplatCamera:
    """Return a camera in the kernels' format."""
    pose = camera.camera_from_world
    numbers = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.center], np.float32)
    flat = np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]]).astype(np.float32)
    return SplatCamera(flat, numbers, camera.width, camera.height, np.float32(near))


def _tiles(pixels: int) -> int:
    return -(-pixels // TILE)


def _image(tiles: np.ndarray, width: int, height: int) -> np.ndarray:
    """Convert [tiles, 4, PIXELS] to [h, w, 4]."""
    across, down = _tiles(width), _tiles(height)
    full = tiles.reshape(down, across, 4, TILE, TILE).transpose(0, 3, 1, 4, 2).reshape(down * TILE, across * TILE, 4)
    return np.ascontiguousarray(full[:height, :width])


def _by_tiles(image: np.ndarray) -> np.ndarray:
    """Convert [h, w, 4] to [tiles, 4, PIXELS], 0 outside."""
    height, width = image.shape[:2]
    across, down = _tiles(width), _tiles(height)
    full = np.zeros((down * TILE, across * TILE, 4), np.float32)
    full[:height, :width] = image
    by_tiles = full.reshape(down, TILE, across, TILE, 4).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(by_tiles).reshape(across * down, 4, PIXELS)
