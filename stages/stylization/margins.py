"""Views beyond the photos' borders: a camera path sees places that no photo shows.

As the fit shows them, they are stylized like photos; else the new colors would stay gray there (decision 0056).
"""

from stylerf.geometry.cameras import Camera, from_far_apart

VIEWS, WIDER = 4, 1.3


def margin_cameras(cameras: list[Camera]) -> list[Camera]:
    """Return VIEWS of the cameras, far from each other, that see WIDER times as far to each side."""
    return [cameras[i].zoomed_out(WIDER) for i in from_far_apart(cameras)[:VIEWS]]
