"""The still life made hard: its surfaces, and what its colors are and are not."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.procedural.still_life import StillLife, dome_cameras
from stylerf.procedural.variants import INKS, PERIOD, PLASTER, ROD, VARIANTS, WIRE, HardStillLife

SIZE = 32
CAMERA = dome_cameras(3, SIZE, "view", 5)[1]
LIVES = {kind: HardStillLife(kind) for kind in VARIANTS}
VIEWS = {kind: life.render(CAMERA) for kind, life in LIVES.items()}


@pytest.mark.parametrize("kind", VARIANTS)
def test_depth_lies_on_the_surfaces_and_alpha_is_their_coverage(kind):
    view, life = VIEWS[kind], LIVES[kind].life
    rows, columns = np.nonzero(np.isfinite(view.z))
    points = CAMERA.unproject(np.stack([columns + 0.5, rows + 0.5], -1), view.z[rows, columns].astype(np.float64))
    assert len(rows) > 60 and np.abs(life.distance(points)).max() < 1e-5
    assert np.abs(points).max() < 1.25  # the box that a scene of it tells
    assert view.rgba.dtype == np.float32 and 0 <= view.rgba.min() and view.rgba.max() <= 1
    counted = np.rint(view.rgba[..., 3] * 4)
    np.testing.assert_allclose(view.rgba[..., 3], counted / 4, atol=1e-6)  # four rays a pixel


def test_shapes_of_two_are_those_of_the_still_life():
    plain = (StillLife().center_distances(CAMERA) * CAMERA.ray_cosines()).astype(np.float32)
    for kind in ("textureless", "repeating"):
        np.testing.assert_array_equal(VIEWS[kind].z, plain)


def test_plaster_has_one_hue_and_differs_by_light_alone():
    """Color over its light is PLASTER everywhere; light by Lambert's law of a normal from another step."""
    view = VIEWS["textureless"]
    solid = view.rgba[..., 3] == 1
    assert np.ptp(view.rgba[solid][:, :3], axis=1).max() < 1e-6  # gray
    assert view.rgba[solid][:, 0].max() <= PLASTER + 1e-6
    assert view.rgba[solid][:, 0].min() >= 0.55 * PLASTER - 1e-6


def test_the_check_repeats_by_its_period_along_every_axis():
    life = LIVES["repeating"]
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    owners = np.zeros(500, int)
    colors = life.albedo(points, owners)
    for axis in np.eye(3):
        np.testing.assert_array_equal(life.albedo(points + PERIOD * axis, owners), colors)
        half = life.albedo(points + 0.5 * PERIOD * axis, owners)
        assert (half != colors).all()
    assert {*map(tuple, colors.tolist())} == {*INKS}


def test_thin_things_are_thin_stand_on_the_table_and_move_with_the_seed():
    one, other = HardStillLife("thin", 1), HardStillLife("thin", 2)
    solids = one.life.solids
    assert len(solids) == 19
    for solid in solids[1:]:
        narrow = min(high - low for low, high in zip(solid.low, solid.high, strict=True))
        assert narrow == pytest.approx(2 * (ROD if solid.name.startswith("rod") else WIRE))
    assert not np.allclose(solids[1].world_from_local, other.life.solids[1].world_from_local)
    distance = 4.03
    assert 2 * ROD * dome_cameras(1, 200, "v", 0)[0].fx / distance < 1.2  # pixels of a photo of 200


def test_normals_of_the_ball_point_away_from_its_middle():
    life = LIVES["textureless"]
    ball = next(solid for solid in life.life.solids if solid.name == "ball")
    directions = np.random.default_rng(2).normal(size=(50, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 1  # its lower half lies in the ring
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = ball.world_from_local[:3, 3] + ball.params[0] * directions
    np.testing.assert_allclose(life.normals(points), directions, atol=1e-4)


def test_others_are_refused():
    with pytest.raises(InvalidValue, match="textureless"):
        HardStillLife("glass")
