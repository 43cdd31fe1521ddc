"""Views beyond the photos' borders: a camera path sees places that no photo shows.

They are stylized like photos, as the fit shows them; otherwise the new colors would stay gray there (decision 0056).
"""

from stylerf.geometry.cameras import Camera, from_far_apart

VIEWS = 4


def margin_cameras(cameras: list[Camera], margin: float) -> list[Camera]:
    """Return VIEWS of the cameras, far from each other, widened to see 1 + margin times as far to each side."""
    return [cameras[i].zoomed_out(1 + margin) for i in from_far_apart(cameras)[:VIEWS]]
