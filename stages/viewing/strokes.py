"""Freehand strokes on the page: the path of a drag, drawn live, and seeds along it.

viser reports the path of a drag only on an object of its scene, and elsewhere only two corners. So a sphere around
everything receives the drags, beyond the drawing distance: it, and viser's arrow on it, are never visible.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from stages.viewing.cameras import Pose

SPHERE_FACTOR = 4.0  # of the farthest distance that the page draws
SPACING = 0.015  # of the picture's height, between seeds
MOST_SEEDS = 40  # of one stroke
PINK = (255, 26, 204)

Place = tuple[float, float]  # across and down, 0..1 from the top left


def seeds_along(way: list[Place], aspect: float) -> list[Place]:
    """Return positions along a stroke, equally spaced in the picture: every SPACING, at most MOST_SEEDS.

    Args:
        aspect: Width of the picture over its height.
    """
    points = np.clip(np.array(way, float).reshape(-1, 2), 0, 1)
    lengths = np.linalg.norm(np.diff(points * [aspect, 1.0], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = int(np.clip(along[-1] / SPACING, 1, MOST_SEEDS - 1)) + 1
    at = np.linspace(0, along[-1], count) if along[-1] > 0 else np.zeros(1)
    return [(float(np.interp(s, along, points[:, 0])), float(np.interp(s, along, points[:, 1]))) for s in at]


def drawn_at(pose: Pose, way: list[Place], away: float) -> np.ndarray:
    """Return the points [n, 3] of a stroke in the scene, `away` ahead of the camera."""
    tangent = np.tan(pose.fov / 2)
    across, down = np.array(way, float).reshape(-1, 2).T
    ahead = np.stack([(2 * across - 1) * tangent * pose.aspect, (2 * down - 1) * tangent, np.ones(len(way))], 1)
    return np.asarray(pose.matrix[:3, 3] + away * ahead @ pose.matrix[:3, :3].T)


class Strokes:
    """Receives drags with Shift while enabled.

    Args:
        page: of the viewer.
        drawn: receives the page's client and the path of each finished stroke, in a separate thread.
    """

    def __init__(self, page: Any, drawn: Callable[[Any, list[Place]], None]) -> None:
        self._page, self._drawn = page, drawn
        self._ways: dict[int, list[Place]] = {}
        self._lines: dict[int, Any] = {}
        self._sphere = page.server.scene.add_icosphere(
            "/strokes", SPHERE_FACTOR * page.server.initial_camera.far, subdivisions=2, opacity=0.0, side="back",
            cast_shadow=False, receive_shadow=False, visible=False,
        )  # fmt: skip
        self._sphere.on_drag("left", modifier="shift")(self._moved)

    def take(self, on: bool) -> None:
        """Enable or disable drags."""
        self._sphere.visible = on

    async def _moved(self, event: Any) -> None:  # async: viser then keeps the order of events
        one, place = event.client_id, (float(event.end_screen_pos[0]), float(event.end_screen_pos[1]))
        if event.phase == "start":
            self._ways[one] = [(float(event.start_screen_pos[0]), float(event.start_screen_pos[1]))]
        way = self._ways.setdefault(one, [])
        way.append(place)
        if event.phase == "end":
            self._erase(one)
            del self._ways[one]
            threading.Thread(target=self._drawn, args=(event.client, way), name="stroke", daemon=True).start()
        else:
            self._draw(event.client, way)

    def _draw(self, client: Any, way: list[Place]) -> None:
        points = drawn_at(self._page.pose_of(client), way, self._page.away).astype(np.float32)
        segments = np.stack([points[:-1], points[1:]], 1)
        self._lines[client.client_id] = client.scene.add_line_segments(
            "/stroke", segments, PINK, thickness=4.0, thickness_units="screen"
        )

    def _erase(self, one: int) -> None:
        line = self._lines.pop(one, None)
        if line is not None:
            line.remove()
