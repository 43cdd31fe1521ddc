"""The example of the mathematics alone, against the closed form of a Gaussian's integral along a line."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from stylerf.kernels.cpu.march import OPTICAL_SCALE

EXAMPLE = Path(__file__).parents[1] / "examples" / "render_field.py"


@pytest.fixture(scope="module")
def view():
    return runpy.run_path(str(EXAMPLE))["render"](40, 30)


def test_alpha_is_that_of_the_gaussians_line_integral(view):
    x, y = np.meshgrid((np.arange(40) + 0.5 - 20) / 60, (np.arange(30) + 0.5 - 15) / 60)
    # From (0, 0, -3) along (x, y, 1): the squared distance of the ray from the origin.
    squares = 9 * (x**2 + y**2) / (x**2 + y**2 + 1)
    integral = 0.1 * np.exp(-squares / (2 * 0.3**2)) * np.sqrt(2 * np.pi) * 0.3
    # The cube is two world units wide: density counts half per unit (decision 0002).
    alpha = 1 - np.exp(-float(OPTICAL_SCALE) * 0.5 * integral)
    assert alpha.max() > 0.9 and alpha.min() < 0.05
    np.testing.assert_allclose(view.alpha, alpha, atol=0.01)


def test_colors_follow_the_position(view):
    solid = view.alpha > 0.5
    mean = view.rgb / np.maximum(view.alpha[..., None], 1e-6)
    rows, columns = np.nonzero(solid)
    left, right = columns < 20, columns >= 20
    assert mean[rows[left], columns[left], 0].max() < 0.5 < mean[rows[right], columns[right], 0].min()
    upper, lower = rows < 15, rows >= 15
    assert mean[rows[upper], columns[upper], 1].max() < 0.5 < mean[rows[lower], columns[lower], 1].min()
    assert mean[solid][:, 2].max() < 0.5  # the camera sees the near side, z < 0


def test_the_example_writes_a_picture(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["render_field.py", str(tmp_path / "ball.png")])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    from PIL import Image

    picture = np.asarray(Image.open(tmp_path / "ball.png"))
    assert picture.shape == (150, 200, 3) and (picture[0, 0] > 230).all() and (picture[75, 100] < 230).any()
