"""Tiny captures in closed form: a colored box in nothing, a wall of one color; and fitters for them."""

import numpy as np

from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.fit.fitter import Fitter
from stylerf.training.fit.settings import CapacityLevel, FitSettings

SIDE = 0.6
LEVELS = (CapacityLevel(8, 16, 24, 8), CapacityLevel(12, 16, 24, 8), CapacityLevel(16, 16, 24, 16))
AROUND = SpaceWarp.box([-0.8] * 3, [0.8] * 3)


def dome(count: int, seed: int, size: int = 24) -> list[Camera]:
    """Cameras on a sphere about the origin, none straight above or below."""
    generator = np.random.default_rng(seed)
    heights = generator.permutation(np.linspace(-0.6, 0.8, count))
    angles = 2.4 * np.arange(count) + generator.random()
    eyes = 2.2 * np.stack([*(np.sqrt(1 - heights**2) * f(angles) for f in (np.cos, np.sin)), heights], 1)
    poses = [look_at(eye, np.zeros(3), np.array([0, 0, 1.0])) for eye in eyes]
    return [Camera(f"v{i}", size, size, 1.1 * size, 1.1 * size, size / 2, size / 2, p) for i, p in enumerate(poses)]


def box_photo(camera: Camera) -> np.ndarray:
    """[h, w, 4] uint8: a box whose color waves over its surface, nothing around it."""
    origins, directions = (a.astype(np.float64) for a in camera.rays())
    sides = np.stack([(s * SIDE - origins) / directions for s in (-1, 1)])
    near, far = sides.min(0).max(1), sides.max(0).min(1)
    hit = (near < far) & (far > 0)
    points = origins + np.where(hit, near, 0)[:, None] * directions
    rgb = 0.5 + 0.4 * np.sin(points @ np.array([[5.0, 2.0, 1.0], [1.0, 5.0, 3.0], [2.0, 1.0, 6.0]]) + [0, 1, 2])
    rgba = np.concatenate([rgb, hit[:, None]], 1) * hit[:, None]
    return np.rint(rgba * 255).astype(np.uint8).reshape(camera.height, camera.width, 4)


def box_bank(views: int = 10, size: int = 24) -> RayDataset:
    cameras = dome(views, 1, size)
    return RayDataset(cameras, [box_photo(c) for c in cameras])


def wall_bank(views: int = 8, size: int = 24) -> tuple[SpaceWarp, RayDataset]:
    """A wall of one color that fills every picture, seen from a row of places, the outermost first; a frustum."""
    cameras = []
    for x in sorted(np.linspace(-0.4, 0.4, views), key=lambda x: -abs(x)):
        pose = np.eye(4)
        pose[:2, 3] = x, 0.2 * np.sin(7 * x)
        cameras.append(Camera(f"w{x:.2f}", size, size, float(size), float(size), size / 2, size / 2, pose))
    photo = np.broadcast_to(np.uint8([180, 120, 60]), (size, size, 3))
    return SpaceWarp.frustum(1.0, 1.0, 1.0, 1e4), RayDataset(cameras, [photo.copy() for _ in cameras])


def masked_wall(hidden: int, size: int = 24) -> tuple[SpaceWarp, RayDataset]:
    """The wall, all of whose photos have a mask that hides their `hidden` left columns, which are blue."""
    space, bank = wall_bank(size=size)
    photo = np.full((size, size, 4), [180, 120, 60, 255], np.uint8)
    photo[:, :hidden] = [0, 0, 255, 0]
    return space, RayDataset(bank.cameras, [photo.copy() for _ in bank.cameras])


def settings(steps: int, **more) -> FitSettings:
    return FitSettings(**{"steps": steps, "samples": 4000, "levels": LEVELS, "prunings": (), **more})


def box_fitter(steps: int, seed: int = 0, held_out: int = 2, bank: RayDataset | None = None, **more) -> Fitter:
    said: list[str] = []
    made = Fitter(AROUND, bank or box_bank(), held_out, settings(steps, **more), seed, 1, said.append)
    made.said = said
    return made
