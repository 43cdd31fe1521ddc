"""The published consistency protocols on picture pairs whose answer is known, and by a slow loop."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.metrics.consistency import pair_consistency
from stylerf.metrics.flow_consistency import flow_consistency, laenerf_script, stylerf_family
from stylerf.metrics.optical_flow import field_flow
from tests.stylerf.metrics.test_consistency import PLANE, camera_at, see
from tests.stylerf.metrics.test_optical_flow import BOARD

HEIGHT, WIDTH, SHIFT = 12, 20, 2


@pytest.fixture
def slid():
    """A picture in eight bits, the same moved right by two pixels, and the flows between them."""
    wide = np.random.default_rng(0).integers(30, 200, (HEIGHT, WIDTH + SHIFT, 3)) / 255
    flow = np.zeros((HEIGHT, WIDTH, 2))
    flow[..., 0] = SHIFT
    return wide[:, SHIFT:], wide[:, :-SHIFT], flow, -flow


def test_a_slid_picture_is_consistent_but_for_the_script(slid):
    source, target, forward, backward = slid
    right = flow_consistency(source, target, forward, backward)
    assert right.error == pytest.approx(0, abs=1e-12) and right.share == (WIDTH - SHIFT) / WIDTH
    family = stylerf_family(source, target, forward)
    assert family.error == pytest.approx(0, abs=1e-12) and family.share == (WIDTH - SHIFT) / WIDTH
    # The script flags every pixel, for it moves by more than half of one, and reads black beyond the picture.
    script = laenerf_script(source, target, forward, backward)
    assert script.share == 1
    assert script.error == pytest.approx((target[:, :SHIFT] ** 2).sum() / (HEIGHT * WIDTH))


def test_a_brighter_target_gives_the_known_error_in_each_protocols_unit(slid):
    source, target, forward, backward = slid
    target = target + 51 / 255
    assert flow_consistency(source, target, forward, backward).error == pytest.approx(0.2)
    assert stylerf_family(source, target, forward).error == pytest.approx(0.2)
    border = (target[:, :SHIFT] ** 2).sum()
    wanted = (border + HEIGHT * (WIDTH - SHIFT) * 3 * 0.04) / (HEIGHT * WIDTH)  # summed over RGB, no root
    assert laenerf_script(source, target, forward, backward).error == pytest.approx(wanted)


def test_the_script_has_no_flagged_pixel_where_nothing_moves(slid):
    source, _, forward, _ = slid
    still = laenerf_script(source, source + 0.1, 0 * forward, 0 * forward)
    assert still.error is None and still.share == 0


def read(values, x, y):
    height, width = values.shape[:2]
    found = np.zeros(values.shape[2])
    for i in (int(np.floor(y)), int(np.floor(y)) + 1):
        for j in (int(np.floor(x)), int(np.floor(x)) + 1):
            if 0 <= i < height and 0 <= j < width:
                found += values[i, j] * (1 - abs(x - j)) * (1 - abs(y - i))
    return found


def test_the_script_pixel_by_pixel():
    """Written from the description of the released script: forward checked against forward, flagged pixels averaged."""
    random = np.random.default_rng(1)
    source, target = random.integers(0, 256, (2, HEIGHT, WIDTH, 3)) / 255
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    forward = np.stack([0.4 * np.sin(rows / 9), 0.2 + 0.02 * columns], -1)
    backward = -forward + 0.1
    total, flagged = 0.0, 0
    for i in range(HEIGHT):
        for j in range(WIDTH):
            x, y = j + backward[i, j, 0], i + backward[i, j, 1]
            there, here = read(forward, x, y), forward[i, j]
            apart = ((there + here) ** 2).sum() > 0.01 * ((there**2).sum() + (here**2).sum()) + 0.5
            steps = ((forward[i, j + 1] - here) ** 2).sum() if j + 1 < WIDTH else 0
            steps += ((forward[i + 1, j] - here) ** 2).sum() if i + 1 < HEIGHT else 0
            if apart or steps > 0.01 * (here**2).sum() + 0.002:
                flagged += 1
                total += ((read(source, x, y) - target[i, j]) ** 2).sum()
    found = laenerf_script(source, target, forward, backward)
    assert 0 < flagged < HEIGHT * WIDTH
    assert found.share == flagged / (HEIGHT * WIDTH) and found.error == pytest.approx(total / flagged)


def test_perceptual_distances_see_what_each_protocol_hands_them(slid):
    source, target, forward, backward = slid
    seen = []

    def whole(a, b):
        seen.append((a, b))
        return 0.25

    assert laenerf_script(source, target, forward, backward, whole).perceptual == 0.25
    np.testing.assert_allclose(seen[0][1], (target + 1) / 2, atol=1e-6)  # 0..1 where -1..1 is expected
    assert seen[0][0][:, :SHIFT] == pytest.approx(0.5)  # black beyond the picture, unmasked

    def pixels(a, b):
        assert (a == b)[:, :SHIFT].all()  # where nothing lands both are the target
        return np.where(np.arange(WIDTH) < SHIFT, 9.0, 0.5) * np.ones((HEIGHT, 1))

    assert stylerf_family(source, target, forward, pixels).perceptual == 0.5
    assert flow_consistency(source, target, forward, backward, pixels).perceptual == 0.5


def test_consistency_by_the_fields_flow_agrees_with_that_by_depth():
    a, b = see(camera_at(), BOARD), see(camera_at(x=0.5), BOARD)
    forward, backward = field_flow(a, b.camera), field_flow(b, a.camera)
    by_depth = pair_consistency(a, b)
    by_flow = flow_consistency(a.image, b.image, forward, backward)
    assert by_flow.error < 4e-3 and by_depth.rmse < 4e-3
    assert by_flow.share == pytest.approx(by_depth.share, abs=0.15)
    family = stylerf_family(a.image, b.image, forward)
    assert family.error < 0.1  # the board's halo, but no more
    far = see(camera_at(x=500.0), [(3.0, 400.0, 600.0, 1.0)])
    nothing = stylerf_family(a.image, far.image, field_flow(a, far.camera))
    assert nothing.error is None and nothing.share == 0


def test_only_pixels_requested_about_count():
    a, b = see(camera_at(), PLANE), see(camera_at(x=0.1), PLANE)
    flows = field_flow(a, b.camera), field_flow(b, a.camera)
    left = np.zeros((48, 64), bool)
    left[:, :32] = True
    image = b.image.copy()
    image[:, 32:] += 0.2
    assert flow_consistency(a.image, image, *flows, within=left).error < 2e-3
    assert flow_consistency(a.image, image, *flows, within=~left).error == pytest.approx(0.2, abs=2e-3)


def test_sizes_and_values_are_checked(slid):
    source, target, forward, backward = slid
    with pytest.raises(InvalidValue, match="20x12"):
        laenerf_script(source, target, forward[:-1], backward)
    with pytest.raises(InvalidValue, match="one size"):
        stylerf_family(source[:-1], target, forward)
    with pytest.raises(InvalidValue, match="not finite"):
        flow_consistency(source, target * np.nan, forward, backward)
