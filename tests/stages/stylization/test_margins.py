"""Views beyond the photos' borders."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from stages.configs.stylize import ArfConfig, RefNprConfig
from stages.stylization.margins import VIEWS, margin_cameras
from stages.stylize import _problem
from stylerf.rendering.view import render_view
from tests.stylerf.small import SPACES, field_of
from tests.stylerf.training.scenes import dome


def test_margins_are_seen_by_cameras_far_from_each_other_that_see_farther():
    cameras = dome(9, 0)
    made = margin_cameras(cameras, 0.3)
    assert len({camera.name for camera in made}) == VIEWS
    for camera in made:
        original = next(one for one in cameras if one.name == camera.name)
        assert camera.fx == original.fx / 1.3 and camera.fy == original.fy / 1.3
        assert (camera.width, camera.cx) == (original.width, original.cx)


@pytest.mark.parametrize(
    ("space", "config", "region", "more"),
    [
        ("contraction", ArfConfig(style="x"), None, VIEWS),
        ("frustum", ArfConfig(style="x"), None, VIEWS),
        ("contraction", ArfConfig(style="x", margin=0.0), None, 0),
        ("contraction", RefNprConfig(method="refnpr", style="x", margin=0.2), None, VIEWS),
        ("box", ArfConfig(style="x"), None, 0),
        ("contraction", RefNprConfig(method="refnpr", style="x"), None, 0),
        ("contraction", ArfConfig(style="x"), SimpleNamespace(edit=np.ones((4, 4, 4), bool)), 0),
    ],
)
def test_whole_captures_alone_have_margins(space, config, region, more):
    cameras = dome(6, 0)
    photo = np.full((cameras[0].height, cameras[0].width, 3), 0.25, np.float32)
    scene = SimpleNamespace(cameras=cameras, splits={"train": [0, 1, 2, 3, 5]}, images=lambda index: photo)
    context = SimpleNamespace(seed=0, memory=1e9, device="cpu", progress=SimpleNamespace(say=lambda text: None))
    field = field_of(SPACES[space], 3)
    problem = _problem(config, scene, field, 0.0, torch.zeros(3, 8, 8), None, region, context, None)
    assert len(problem.cameras) == len(problem.photos) == 5 + more
    assert (problem.photos[4] == 0.25).all()
    if more:
        seen = render_view(field, problem.cameras[5], threads=torch.get_num_threads())
        np.testing.assert_array_equal(problem.photos[5], seen.rgb)
