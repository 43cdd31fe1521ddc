"""Which warp of space a scene is fitted in."""

import numpy as np

from schemas.errors import BadInput
from stages.artifacts.scene import SceneData
from stylerf.errors import InvalidValue
from stylerf.geometry.space_warp import SpaceWarp

KIND_OF_LAYOUT = {"object": "box", "forward": "frustum", "unbounded": "contraction"}
_MARGIN = 1.02
# Half a side of a contraction's uncontracted box, in distances of the cameras from what they look at. What is between
# the two is seldom the subject, and half of every axis goes to the box (decision 0042).
FOCUS = 0.6


def space_of(scene: SceneData, wanted: str) -> tuple[SpaceWarp, str]:
    """Return the warp and the reason as text. wanted: a kind, or auto for the one of the scene's layout.

    BadInput where the scene's bounds and cameras, sound one by one, span no space.
    """
    try:
        return _space_of(scene, wanted)
    except InvalidValue as error:
        raise BadInput(
            f"{scene.folder}: its bounds and cameras span no space to fit in ({error}); import it again"
        ) from error


def _space_of(scene: SceneData, wanted: str) -> tuple[SpaceWarp, str]:
    bounds = scene.bounds
    kind = KIND_OF_LAYOUT[scene.layout] if wanted == "auto" else wanted
    reason = f"{scene.layout} layout ({scene.scene.layout_reason})" if wanted == "auto" else "asked for"
    if kind == "box":
        return SpaceWarp.box(*bounds.aabb), reason
    if kind == "contraction":
        low, high = np.asarray(bounds.aabb)
        # An unbounded scene's box reaches as far as its cameras; others know what is in theirs.
        middle, half = (low + high) / 2, (FOCUS if scene.layout == "unbounded" else 1.0) * (high - low) / 2
        far = max(bounds.far, 1e3)
        return SpaceWarp.box(middle - half, middle + half, near=bounds.near, far=far, kind="contraction"), reason
    half_width, half_height = _frustum_sides(scene, bounds.near)
    centers = np.array([camera.world_from_camera[:3, 3] for camera in scene.cameras])
    parallax = np.ptp(centers, axis=0)[:2].max() / bounds.near
    return SpaceWarp.frustum(half_width, half_height, bounds.near, max(bounds.far, 1e4), parallax), reason


def _frustum_sides(scene: SceneData, near: float) -> tuple[float, float]:
    """Largest |x/z| and |y/z| that any view's corner sees beyond `near`, in the frame of the average camera."""
    slopes = []
    for camera in scene.cameras:
        corners = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]], float)
        for depth in (near, 4 * near, 1000 * near):
            points = camera.unproject(corners, np.full(4, depth))
            slopes.append(np.abs(points[:, :2]) / np.maximum(points[:, 2:], near / 2))
    widest = np.concatenate(slopes).max(0) * _MARGIN
    return float(widest[0]), float(widest[1])
