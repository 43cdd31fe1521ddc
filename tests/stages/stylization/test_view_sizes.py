"""The size of the views that a stylization learns from."""

import numpy as np
import pytest

from stages.configs.stylize import ArfConfig
from stages.stylization.view_sizes import resized_cameras
from stylerf.geometry.cameras import Camera

LARGE = Camera("large", 1600, 1200, 1500.0, 1500.0, 800.0, 600.0, np.eye(4))
SMALL = Camera("small", 400, 300, 375.0, 375.0, 200.0, 150.0, np.eye(4))


def sizes(device: str | None = None, **options) -> list[tuple[int, int]]:
    config = ArfConfig(style="x", **options)
    return [(camera.width, camera.height) for camera in resized_cameras([LARGE, SMALL], config, device)]


def test_a_short_time_takes_smaller_views_and_a_long_one_all_pixels():
    pixels = [sizes(budget=budget)[0] for budget in ("10s", "60s", "4m", "1h")]
    assert pixels == [(516, 387), (516, 387), (800, 600), (1600, 1200)]
    assert {sizes(budget=budget)[1] for budget in ("10s", "1h")} == {(400, 300)}


@pytest.mark.parametrize(
    ("device", "options"),
    [(None, {"budget": "500"}), ("cuda", {"budget": "10s"}), (None, {"budget": "10s", "max_side": 0})],
)
def test_steps_a_gpu_and_zero_keep_the_photos_size(device, options):
    assert sizes(device, **options) == [(1600, 1200), (400, 300)]


@pytest.mark.parametrize("device", [None, "cuda"])
def test_a_limit_holds_for_every_view_whatever_the_budget(device):
    assert sizes(device, budget="1h", max_side=800) == [(800, 600), (400, 300)]
    assert sizes(device, budget="500", max_side=200) == [(200, 150), (200, 150)]


def test_a_smaller_view_shows_the_same():
    (small, _) = resized_cameras([LARGE, SMALL], ArfConfig(style="x", max_side=800), None)
    assert (small.fx, small.fy, small.cx, small.cy) == (750, 750, 400, 300) and small.name == "large"


@pytest.mark.parametrize("side", [-2, 1, 63])
def test_views_too_small_to_learn_from_are_refused(side):
    with pytest.raises(ValueError, match="max_side must be at least 64"):
        ArfConfig(style="x", max_side=side)
