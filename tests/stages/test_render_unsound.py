"""A field of sound numbers that shows what is not finite writes no picture."""

import numpy as np
import pytest

from schemas.errors import ArtifactDamaged
from schemas.frames import Frame
from schemas.scene import Bounds
from stages import render
from stages.configs.render import RenderConfig
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import RenderedView

LOOK = Camera("a", 4, 3, 5.0, 5.0, 2.0, 1.5, np.eye(4))


@pytest.mark.parametrize("plane", ["rgb", "alpha", "z"])
def test_what_is_not_finite_is_no_picture(tmp_path, plane):
    planes = {"rgb": np.full((3, 4, 3), 0.5), **{name: np.ones((3, 4)) for name in ("alpha", "ray_distance", "z")}}
    frame = Frame("a", "", "png/a.png", render._camera_entry(LOOK))
    given = "white", Bounds(((0, 0, 0), (1, 1, 1)), 1, 2), LOOK, RenderConfig(exr=False), tmp_path
    render._render(frame, None, *given, lambda camera, regions: RenderedView(**planes), {"field": "fit"}, {})
    assert (tmp_path / "png/a.png").is_file()
    (tmp_path / "png/a.png").unlink()
    planes[plane].reshape(-1)[5] = np.nan
    with pytest.raises(ArtifactDamaged, match=r"field fit .*not finite in frame a"):
        render._render(frame, None, *given, lambda camera, regions: RenderedView(**planes), {"field": "fit"}, {})
    assert not (tmp_path / "png/a.png").exists()
