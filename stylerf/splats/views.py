"""Views that splats learn from: the training cameras and others between them, any first few well spread."""

import numpy as np

from stylerf.geometry.camera_paths import path_camera
from stylerf.geometry.cameras import Camera

AXIS_WEIGHT = 0.3  # of a difference of viewing directions, against one of positions as far apart as the cameras


def views_to_learn(cameras: list[Camera]) -> list[Camera]:
    """Return the cameras and one between each two neighbors on a tour of them, by turns and from far apart.

    A prefix of any length covers the cameras' hull as well as its length allows.
    """
    count = len(cameras)
    between = [path_camera("interpolate", cameras, 2 * i + 1, 2 * count - 1, 1.0) for i in range(count - 1)]
    own = [cameras[i] for i in _from_far_apart(cameras)]
    others = [between[i] for i in _from_far_apart(between)]
    views = [camera for pair in zip(own, others) for camera in pair]
    return views + own[len(others) :]


def _from_far_apart(cameras: list[Camera]) -> list[int]:
    """Order cameras so that each is the one farthest from all before it (farthest-point sampling)."""
    if not cameras:
        return []
    centers = np.array([camera.center for camera in cameras])
    size = max(float(np.linalg.norm(np.ptp(centers, axis=0))), 1e-9)
    places = np.concatenate([centers / size, AXIS_WEIGHT * np.array([camera.forward for camera in cameras])], 1)
    order = [int(np.argmin(np.linalg.norm(places - places.mean(0), axis=1)))]
    distances = np.linalg.norm(places - places[order[0]], axis=1)
    while len(order) < len(cameras):
        distances[order[-1]] = -1
        order.append(int(np.argmax(distances)))
        distances = np.minimum(distances, np.linalg.norm(places - places[order[-1]], axis=1))
    return order
