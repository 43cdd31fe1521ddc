"""Lens distortion against OpenCV's formulas written as a slow loop, and against COLMAP's cameras."""

import math
import tracemalloc

import numpy as np
import pycolmap
import pytest

from stylerf.errors import InvalidValue
from stylerf.geometry import distortion
from stylerf.geometry.distortion import Distortion

MODELS = {
    "SIMPLE_PINHOLE": [90.0, 61, 45],
    "PINHOLE": [90.0, 95, 61, 45],
    "SIMPLE_RADIAL": [90.0, 61, 45, -0.12],
    "RADIAL": [90.0, 61, 45, 0.08, -0.05],
    "OPENCV": [90.0, 95, 61, 45, -0.15, 0.04, 0.004, -0.003],
    "FULL_OPENCV": [90.0, 95, 61, 45, -0.15, 0.04, 0.004, -0.003, 0.01, 0.02, -0.01, 0.005],
    "OPENCV_FISHEYE": [60.0, 62, 61, 45, 0.05, -0.02, 0.01, -0.003],
    "SIMPLE_RADIAL_FISHEYE": [60.0, 61, 45, 0.04],
    "RADIAL_FISHEYE": [60.0, 61, 45, 0.04, -0.01],
    "SIMPLE_FISHEYE": [60.0, 61, 45],
    "FISHEYE": [60.0, 64, 61, 45],
    "FOV": [90.0, 95, 61, 45, 0.9],
    "THIN_PRISM_FISHEYE": [60.0, 62, 61, 45, 0.05, -0.02, 0.01, -0.008, 0.01, -0.003, 0.02, -0.01],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        60.0, 62, 61, 45, 0.05, -0.02, 0.01, -0.003, 0.002, -0.001, 0.01, -0.008, 0.02, 0.01, -0.015, 0.004,
    ],
    "SIMPLE_DIVISION": [90.0, 61, 45, -0.2],
    "DIVISION": [90.0, 95, 61, 45, 0.25],
    "EUCM": [60.0, 62, 61, 45, 0.6, 1.2],
}
SIZE = (120, 90)
PLANE = np.random.default_rng(0).uniform(-0.6, 0.6, size=(200, 2))


@pytest.mark.parametrize("model", MODELS)
def test_every_model_falls_where_colmap_puts_it(model):
    camera = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=MODELS[model])
    expected = camera.img_from_cam(np.column_stack([PLANE, np.ones(len(PLANE))]))
    (fx, fy, cx, cy), warp = distortion.from_colmap(model, MODELS[model])
    np.testing.assert_allclose(warp.distort(PLANE) * [fx, fy] + [cx, cy], expected, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_undistort_inverts_distort(model):
    _, warp = distortion.from_colmap(model, MODELS[model])
    np.testing.assert_allclose(warp.undistort(warp.distort(PLANE)), PLANE, atol=1e-9)


# Of formulas that divide by the radius or the parameter: the values in the limit.
@pytest.mark.parametrize("model", [name for name in MODELS if name not in ("SIMPLE_PINHOLE", "PINHOLE")])
def test_the_axis_is_the_principal_point(model):
    _, warp = distortion.from_colmap(model, MODELS[model])
    assert (warp.distort(np.zeros((1, 2))) == 0).all() and np.abs(warp.undistort(np.zeros((1, 2)))).max() < 1e-12
    assert np.abs(Distortion("fov", others=(0.0,)).distort(PLANE) - PLANE).max() == 0


def test_rays_beyond_the_models_have_no_image():
    assert np.isnan(Distortion("division", others=(0.5,)).distort(np.array([[0.9, 0.0]]))).all()  # 4 k r^2 > 1
    assert np.isnan(Distortion("fov", others=(0.9,)).undistort(np.array([[1.8, 0.0]]))).all()
    assert np.isnan(Distortion("eucm", others=(0.6, 1.2)).undistort(np.array([[2.0, 0.0]]))).all()


def opencv(x, y, k1, k2, p1, p2, k3, k4, k5, k6):
    """The formula of OpenCV's documentation of calib3d, one point."""
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
    )


def opencv_fisheye(x, y, k1, k2, k3, k4):
    r = math.hypot(x, y)
    theta = math.atan(r)
    bent = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    return x * bent / r, y * bent / r


def test_formulas_of_opencv():
    values = MODELS["FULL_OPENCV"][4:]
    _, warp = distortion.from_colmap("FULL_OPENCV", MODELS["FULL_OPENCV"])
    np.testing.assert_allclose(warp.distort(PLANE), [opencv(*point, *values) for point in PLANE], atol=1e-12)
    _, warp = distortion.from_colmap("OPENCV_FISHEYE", MODELS["OPENCV_FISHEYE"])
    expected = [opencv_fisheye(*point, *MODELS["OPENCV_FISHEYE"][4:]) for point in PLANE]
    np.testing.assert_allclose(warp.distort(PLANE), expected, atol=1e-12)
    assert np.isfinite(warp.distort(np.zeros((1, 2)))).all()


@pytest.mark.parametrize("model", [name for name in MODELS if "PINHOLE" not in name])
def test_the_pinhole_shows_no_blank_and_wastes_little(model):
    intrinsics, warp = distortion.from_colmap(model, MODELS[model])
    pinhole = distortion.pinhole_of(SIZE, intrinsics, warp)
    positions = distortion.source_positions(SIZE, pinhole, intrinsics, warp)
    assert positions.shape == (90, 120, 2)
    assert positions.min() > -0.01 and positions[..., 0].max() < 120.01 and positions[..., 1].max() < 90.01
    # Pixels keep their shape, else strokes and films come out squeezed.
    assert pinhole[1] / pinhole[0] == pytest.approx(intrinsics[1] / intrinsics[0])
    # Along one axis both sides touch the picture's border somewhere; of wide lenses the other axis is cut.
    if "FISHEYE" not in model and model not in ("FOV", "EUCM"):
        across = positions[..., 0].min(), 120 - positions[..., 0].max()
        down = positions[..., 1].min(), 90 - positions[..., 1].max()
        assert min(max(across), max(down)) < 1.5 and max(*across, *down) < 3
    # The center of one pixel is where COLMAP puts it.
    x, y = (30.5 - pinhole[2]) / pinhole[0], (70.5 - pinhole[3]) / pinhole[1]
    camera = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=MODELS[model])
    expected = camera.img_from_cam(np.array([[x, y, 1.0]]))[0]
    np.testing.assert_allclose(positions[70, 30], expected, atol=1e-4)


def test_the_map_of_a_lens_takes_little_more_memory_than_itself():
    intrinsics, warp = distortion.from_colmap("FULL_OPENCV", MODELS["FULL_OPENCV"])
    tracemalloc.start()
    positions = distortion.source_positions((600, 2000), intrinsics, intrinsics, warp)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 * positions.nbytes
    # Bands of rows join without a seam.
    rows = np.array([63.5, 64.5])
    ideal = np.stack([np.full(2, 100.5 - intrinsics[2]) / intrinsics[0], (rows - intrinsics[3]) / intrinsics[1]], -1)
    expected = warp.distort(ideal) * intrinsics[:2] + intrinsics[2:]
    np.testing.assert_allclose(positions[63:65, 100], expected, rtol=1e-6)


def test_faults_are_reported():
    with pytest.raises(InvalidValue, match="EQUIRECTANGULAR is unknown"):
        distortion.from_colmap("EQUIRECTANGULAR", [120.0, 90])
    with pytest.raises(InvalidValue, match="DIVISION takes 5 parameters, found 4"):
        distortion.from_colmap("DIVISION", [90.0, 90, 61, 45])
    with pytest.raises(InvalidValue, match="takes 4 parameters, found 3"):
        distortion.from_colmap("SIMPLE_RADIAL", [90.0, 61, 45])
    with pytest.raises(InvalidValue, match="NaN"):
        Distortion("brown", (math.nan,))
    with pytest.raises(InvalidValue, match="fold"):
        distortion.pinhole_of(SIZE, (90, 90, 60, 45), Distortion("brown", (-3.0,)))
