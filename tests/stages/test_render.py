"""A field whose numbers are in range but that renders NaN or infinite values is damaged."""

import numpy as np
import pytest

from schemas.errors import ArtifactDamaged
from schemas.frames import Frame, FrameCamera
from schemas.scene import as_matrix
from stages.render import render_frame
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import RenderedView

CAMERA = Camera("a", 4, 3, 5.0, 5.0, 2.0, 1.5, np.eye(4))
FRAME = Frame("a", "", "png/a.png", FrameCamera(4, 3, 5.0, 5.0, 2.0, 1.5, as_matrix(np.eye(4))))


@pytest.mark.parametrize("plane", ["rgb", "alpha", "z"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_frame_with_nan_or_infinity_is_refused(plane, value):
    planes = {"rgb": np.full((3, 4, 3), 0.5), **{name: np.ones((3, 4)) for name in ("alpha", "ray_distance", "z")}}
    view = RenderedView(**planes)
    assert render_frame(lambda camera, regions: (view, None), FRAME, CAMERA, {}, "fit") == (view, None)
    planes[plane].reshape(-1)[5] = value
    with pytest.raises(ArtifactDamaged, match=r"field fit .* frame a"):
        render_frame(lambda camera, regions: (view, None), FRAME, CAMERA, {}, "fit")
