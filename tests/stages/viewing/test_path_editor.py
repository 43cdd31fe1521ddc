"""Paths: saved as `stylerf render --path` takes them."""

import numpy as np
import pytest

from schemas.errors import UsageError
from stages.viewing.cameras import Pose
from tests.stages.viewing.command_lines import config_of


def test_a_saved_path_is_one_that_render_takes(desk):
    from stages.artifacts.camera_files import read_cameras

    for x in (0.0, 0.2, 0.3):
        desk.path.add(Pose((1.0, 0.0, 0.0, 0.0), (x, 0.0, 0.0), 0.8, 1.5))
    desk.path.space(between=4)
    path = desk.path.save("walk")
    assert path.is_relative_to(desk.library.work.root)
    cameras = read_cameras(path, desk.library.scene).cameras
    assert len(cameras) == 9
    np.testing.assert_allclose([cameras[i].center[0] for i in (0, 4, 8)], [0.0, 0.2, 0.3], atol=1e-9)
    like = desk.library.scene.cameras[0]
    assert {(one.width, one.height) for one in cameras} == {(like.width, like.height)}
    assert 2 * np.arctan(cameras[3].height / 2 / cameras[3].fy) == pytest.approx(0.8)
    args, config = config_of(desk.path.command(path, "plain"))
    assert (args.of, config.path) == ("plain", str(path))
    with pytest.raises(UsageError, match="valid name"):
        desk.path.save("../../x")
