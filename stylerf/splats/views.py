"""Views to train splats on: the training cameras and others between them, ordered so that any prefix is well spread."""

from stylerf.geometry.camera_paths import path_camera
from stylerf.geometry.cameras import Camera, from_far_apart


def views_to_learn(cameras: list[Camera]) -> list[Camera]:
    """Return the cameras, alternating with one between each two neighbors on a tour of them, far-apart ones first.

    Any prefix covers the cameras' hull as well as its length allows.
    """
    count = len(cameras)
    between = [path_camera("interpolate", cameras, 2 * i + 1, 2 * count - 1, 1.0) for i in range(count - 1)]
    own = [cameras[i] for i in from_far_apart(cameras)]
    others = [between[i] for i in from_far_apart(between)]
    views = [camera for pair in zip(own, others) for camera in pair]
    return views + own[len(others) :]
