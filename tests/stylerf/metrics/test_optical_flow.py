"""Flow by depth and poses, reading along it, splatting along it: closed forms, scipy and slow loops."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from stylerf.errors import InvalidValue
from stylerf.metrics.flow_consistency import photometric_importance, softmax_splat
from stylerf.metrics.optical_flow import field_flow, occluded, sampled, visible
from tests.stylerf.metrics.test_consistency import PLANE, camera_at, see

BOARD = [(3.0, -50.0, 50.0, 1.0), (1.5, -0.2, 0.2, 0.3)]  # a dark board before the wall


def random_flow(seed, size=(9, 11), reach=4.0):
    return np.random.default_rng(seed).uniform(-reach, reach, (*size, 2))


def test_flow_of_a_shifted_plane_is_focal_times_shift_over_depth():
    a, b = see(camera_at(), PLANE), camera_at(x=0.3, y=-0.1)
    found = field_flow(a, b)
    np.testing.assert_allclose(found, np.broadcast_to([-60 * 0.3 / 3, 60 * 0.1 / 3], found.shape), atol=1e-4)


def test_flow_of_a_turned_camera_leads_to_where_the_point_is_projected():
    planes = [(3.0, -0.5, 50.0, 1.0)]
    a, b = see(camera_at(), planes), camera_at(x=0.2, yaw=0.1)
    found = field_flow(a, b)
    assert np.isnan(found[a.alpha < 0.5]).all() and np.isfinite(found[a.alpha > 0.5]).all()
    x, y = (40.5 - 32) / 60 * 3, (10.5 - 24) / 60 * 3  # the point that pixel (40, 10) sees
    local = b.camera_from_world @ [x, y, 3, 1]
    wanted = [60 * local[0] / local[2] + 32 - 40.5, 60 * local[1] / local[2] + 24 - 10.5]
    np.testing.assert_allclose(found[10, 40], wanted, atol=1e-4)


def test_reading_along_a_flow_is_scipys_interpolation_with_zero_around():
    values = np.random.default_rng(0).random((9, 11, 3))
    flow = random_flow(1, reach=9)
    rows, columns = np.mgrid[:9, :11]
    places = [rows + flow[..., 1], columns + flow[..., 0]]
    for channel in range(3):
        wanted = map_coordinates(values[..., channel], places, order=1, mode="grid-constant", cval=0)
        np.testing.assert_allclose(sampled(values, flow)[..., channel], wanted, atol=1e-12)
    with pytest.raises(InvalidValue, match="11x9"):
        sampled(values, flow[:-1])


def slow_occluded(a, b, e):
    height, width, _ = a.shape
    found = np.zeros((height, width), bool)
    for i in range(height):
        for j in range(width):
            apart = (a[i, j, 0] + b[i, j, 0]) ** 2 + (a[i, j, 1] + b[i, j, 1]) ** 2
            long = (a[i, j] ** 2).sum() + (b[i, j] ** 2).sum()
            steps = 0.0
            for k in range(2):
                steps += (e[i, j + 1, k] - e[i, j, k]) ** 2 if j + 1 < width else 0
                steps += (e[i + 1, j, k] - e[i, j, k]) ** 2 if i + 1 < height else 0
            found[i, j] = apart > 0.01 * long + 0.5 or steps > 0.01 * (e[i, j] ** 2).sum() + 0.002
    return found


def test_occlusion_is_ruders_test_pixel_by_pixel():
    a, b = random_flow(2, reach=0.7), random_flow(3, reach=0.7)
    smooth = np.full_like(a, 0.3) + 0.02 * random_flow(4, reach=1)
    found = occluded(a, b, smooth)
    assert 0 < found.sum() < found.size
    np.testing.assert_array_equal(found, slow_occluded(a, b, smooth))


def test_what_a_board_hides_is_not_visible_and_the_rest_is():
    a, b = see(camera_at(), BOARD), see(camera_at(x=0.5), BOARD)
    seen = visible(field_flow(a, b.camera), field_flow(b, a.camera))
    points = b.camera.unproject(
        np.stack(np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5), -1).reshape(-1, 2), b.z.reshape(-1)
    ).reshape(48, 64, 3)
    # a sees the wall behind its board no more: |x| < 0.2 at z = 1.5 covers |x| < 0.4 at z = 3.
    hidden = (np.abs(points[..., 0]) < 0.36) & (points[..., 2] > 2)
    assert hidden.sum() > 50 and not seen[hidden].any()
    plain = (points[..., 0] > 0.6) & (points[..., 0] < 1.4) & (points[..., 2] > 2)
    assert plain.sum() > 300 and seen[plain].all()
    outside = points[..., 0] > 1.7  # a's view ends at 1.6
    assert outside.any() and not seen[outside].any()


def slow_splat(image, flow, importance):
    height, width, channels = image.shape
    total, found = np.zeros((height, width)), np.zeros((height, width, channels))
    for i in range(height):
        for j in range(width):
            if not np.isfinite(flow[i, j]).all():
                continue
            for m in range(height):
                for n in range(width):
                    share = max(0, 1 - abs(n - j - flow[i, j, 0])) * max(0, 1 - abs(m - i - flow[i, j, 1]))
                    total[m, n] += share * np.exp(importance[i, j])
                    found[m, n] += share * np.exp(importance[i, j]) * image[i, j]
    return found / np.where(total > 0, total, 1)[..., None], total > 0


def test_splatting_is_the_papers_sum():
    random = np.random.default_rng(5)
    image, importance, flow = random.random((9, 11, 3)), random.uniform(-8, 0, (9, 11)), random_flow(6)
    flow[2, 3], flow[4, 5] = np.nan, [1e9, 0]
    found, landed = softmax_splat(image, flow, importance)
    wanted, filled = slow_splat(image, flow, importance)
    assert 0 < landed.sum() < landed.size
    np.testing.assert_array_equal(landed, filled)
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_the_more_important_pixel_comes_out_on_top():
    image, flow = np.zeros((1, 4, 3)), np.zeros((1, 4, 2))
    image[0, 0], image[0, 1] = 1.0, 0.25
    flow[0, 0, 0] = 1  # both land on the second pixel
    importance = np.array([[-15.0, 0, 0, 0]])
    found, landed = softmax_splat(image, flow, importance)
    assert landed.tolist() == [[False, True, True, True]]
    assert found[0, 1, 0] == pytest.approx((0.25 + np.exp(-15)) / (1 + np.exp(-15)))
    assert softmax_splat(image, flow, -importance)[0][0, 1, 0] == pytest.approx(1, abs=1e-5)
    assert not softmax_splat(image, np.full_like(flow, np.nan), importance)[1].any()


def test_importance_falls_by_twenty_for_a_difference_of_one():
    source, target, flow = np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), np.zeros((2, 3, 2))
    flow[..., 0] = 1
    target[0, 1] = [0.3, 0.6, 0.9]
    found = photometric_importance(source, target, flow)
    assert found[0, 0] == pytest.approx(-20 * 0.6) and found[0, 1] == 0
