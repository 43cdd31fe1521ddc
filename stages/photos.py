"""A scene's photos as training wants them."""

import numpy as np

from stages.scenes import SceneData
from stylerf.training.rays import RayBank


def bank_of(scene: SceneData, views: list[int]) -> RayBank:
    """Rays of the views, in this order. With and without alpha together: those without are opaque."""
    images = [(scene.images(i) * 255 + 0.5).astype(np.uint8) for i in views]
    if len({image.shape[2] for image in images}) > 1:
        images = [i if i.shape[2] == 4 else np.dstack([i, np.full(i.shape[:2], 255, np.uint8)]) for i in images]
    return RayBank([scene.cameras[i] for i in views], images)


def photo_over(scene: SceneData, index: int, level: float) -> np.ndarray:
    """[h, w, 3] float32, sRGB 0..1, over a background of one grey level."""
    pixels = scene.images(index)
    if pixels.shape[2] == 4:
        pixels = pixels[..., :3] * pixels[..., 3:] + (1 - pixels[..., 3:]) * np.float32(level)
    return np.ascontiguousarray(pixels, dtype=np.float32)


def level_of(background: str) -> float:
    """Grey level of what stands behind a field in pictures."""
    return 1.0 if background == "white" else 0.0
