"""The size of the views that a stylization learns from.

A large view has no more strokes to learn than a small one, but costs more. In a short budget, looking at every view
several times counts for more than pixels (decision 0076).
"""

import math

from stages.configs.fit import budget_of
from stages.configs.stylize import StylizeConfig
from stylerf.geometry.cameras import Camera

PIXELS_PER_SECOND = 2000  # of the budget, that views have on a CPU
MIN_PIXELS = 200_000


def resized_cameras(cameras: list[Camera], config: StylizeConfig, device: str | None) -> list[Camera]:
    """Return the cameras with views that are no larger than --max-side allows.

    Args:
        cameras: Of the photos.
        config: With max_side -1 on a CPU, the time in the budget limits the number of pixels; steps limit nothing.
        device: A GPU, or None for the CPU.
    """
    seconds, _ = budget_of(config.budget)
    if config.max_side > 0:
        return [_shrunk(camera, config.max_side / max(camera.width, camera.height)) for camera in cameras]
    if config.max_side == 0 or device is not None or not seconds:
        return cameras
    most = max(MIN_PIXELS, PIXELS_PER_SECOND * seconds)
    return [_shrunk(camera, math.sqrt(most / (camera.width * camera.height))) for camera in cameras]


def _shrunk(camera: Camera, factor: float) -> Camera:
    return camera.scaled(factor) if factor < 1 else camera
