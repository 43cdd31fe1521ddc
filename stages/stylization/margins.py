"""Views beyond the photos' borders, as the fit shows them: a camera path sees places that no photo does.

They are stylized like photos; else the new colors would stay gray there (decision 0056).
"""

from collections.abc import Sequence

import numpy as np

from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera, spread_out
from stylerf.rendering.view import render_view

VIEWS, WIDER = 4, 1.3


def margin_cameras(cameras: Sequence[Camera]) -> list[Camera]:
    """Return VIEWS of the cameras, far from each other, that see WIDER times as far to each side."""
    return [cameras[i].zoomed_out(WIDER) for i in spread_out(cameras, VIEWS)]


def picture(field: RadianceField, camera: Camera, level: float, threads: int) -> np.ndarray:
    """Return a view of the fit over a gray level, [h, w, 3] sRGB 0..1."""
    seen = render_view(field, camera, threads=threads)
    return (seen.rgb + (1 - seen.alpha[..., None]) * np.float32(level)).clip(0, 1)
