"""Sphere tracing of the still life's solids against closed forms, and what it promises of every one of them."""

import numpy as np
import pytest

from stylerf.errors import InvalidValue
from stylerf.procedural import shapes
from stylerf.procedural.solids import TABLE_RADIUS, TABLE_TOP, Solid, arrangement, pack
from stylerf.procedural.still_life import TRACE_TOLERANCE, StillLife
from stylerf.procedural.tracing import MISS, point_distances, trace_rays

LIFE = StillLife()
SOLIDS = {solid.name: solid for solid in arrangement()}


def turned(seed: int, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Any rigid motion."""
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation * np.sign(np.linalg.det(rotation)), shift
    return pose


def traced(solids: list[Solid], origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distances to the first hit, inf on a miss."""
    distances, owners = trace_rays(pack(solids), origins, directions, TRACE_TOLERANCE)
    return np.where(owners < 0, np.inf, distances)


def rays_at(target: np.ndarray, spread: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """From a sphere of radius 3 about the target, past it at `spread` or less on every axis."""
    random = np.random.default_rng(seed)
    origins = random.normal(size=(count, 3))
    origins = target + 3 * origins / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = target + random.uniform(-spread, spread, (count, 3)) - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_spheres_are_hit_where_the_quadratic_says():
    radius, pose = 0.4, turned(1, (0.2, -0.3, 0.5))
    ball = Solid("ball", shapes.SPHERE, (radius,), (-radius,) * 3, (radius,) * 3, pose)
    origins, directions = rays_at(pose[:3, 3], 0.5, 4000, 2)
    off = origins - pose[:3, 3]
    b = (off * directions).sum(1)
    squared = b * b - (off * off).sum(1) + radius**2
    expected = np.where(squared > 0, -b - np.sqrt(np.maximum(squared, 0)), np.inf)
    found = traced([ball], origins, directions)
    # A hit is where the distance falls under 1e-6: along a grazing ray that is sqrt(2 r 1e-6) early, or a hit.
    clear = np.abs(squared) > 1e-3
    np.testing.assert_array_equal(np.isinf(found[clear]), np.isinf(expected[clear]))
    hit = clear & np.isfinite(expected)
    np.testing.assert_allclose(found[hit], expected[hit], atol=5e-5)
    assert hit.sum() > 1500 and np.isinf(expected).sum() > 500


def test_the_table_top_is_a_plane():
    random = np.random.default_rng(3)
    aims = random.uniform(-0.8, 0.8, (2000, 2))
    origins = np.column_stack([random.uniform(-2, 2, (2000, 2)), random.uniform(0.5, 3, 2000)])
    directions = np.column_stack([aims, np.full(2000, TABLE_TOP)]) - origins
    lengths = np.linalg.norm(directions, axis=1)
    found = traced([SOLIDS["table"]], origins, directions / lengths[:, None])
    np.testing.assert_allclose(found, lengths, atol=2e-5)
    past = np.array([[TABLE_RADIUS + 0.01, 0.0, 2.0]])
    assert np.isinf(traced([SOLIDS["table"]], past, np.array([[0.0, 0.0, -1.0]]))).all()


def test_boxes_are_hit_where_slabs_say():
    half, pose = np.array([0.3, 0.2, 0.1]), turned(4, (-0.1, 0.4, 0.0))
    box = Solid("box", shapes.BOX, (*half, 0.0), tuple(-half), tuple(half), pose)
    origins, directions = rays_at(pose[:3, 3], 0.3, 4000, 5)
    local, way = (origins - pose[:3, 3]) @ pose[:3, :3], directions @ pose[:3, :3]
    ends = np.sort(np.stack([(-half - local) / way, (half - local) / way]), axis=0)
    near, far = ends[0].max(1), ends[1].min(1)
    found = traced([box], origins, directions)
    hit, missed = far - near > 1e-3, far - near < -1e-3
    assert np.isinf(found[missed]).all() and missed.sum() > 500 and hit.sum() > 1000
    np.testing.assert_allclose(found[hit], near[hit], atol=1e-4)


def test_rings_are_hit_where_the_quartic_says():
    """(|p|^2 + R^2 - r^2)^2 = 4 R^2 (x^2 + y^2): the smallest positive root of a polynomial in t."""
    major, minor = 0.3, 0.1
    ring = Solid("ring", shapes.TORUS, (major, minor), (-0.4, -0.4, -0.1), (0.4, 0.4, 0.1), np.eye(4))
    origins, directions = rays_at(np.zeros(3), 0.35, 300, 6)
    found, expected, clear = traced([ring], origins, directions), [], []
    for o, d in zip(origins, directions, strict=True):
        inner = np.polynomial.Polynomial([o @ o + major**2 - minor**2, 2 * o @ d, 1.0])
        flat = np.polynomial.Polynomial([o[:2] @ o[:2], 2 * o[:2] @ d[:2], d[:2] @ d[:2]])
        roots = (inner**2 - 4 * major**2 * flat).roots()
        real = np.sort(roots[np.abs(roots.imag) < 1e-7].real)
        expected.append(real[0] if len(real) else np.inf)
        # Two roots that fall together, or a pair that just left the real line: a grazing ray.
        clear.append(np.min(np.abs(np.diff(real))) > 0.03 if len(real) else np.abs(roots.imag).min() > 0.03)
    expected, clear = np.array(expected), np.array(clear)
    np.testing.assert_allclose(found[clear], expected[clear], atol=1e-4)
    assert (clear & np.isfinite(expected)).sum() > 60 and (clear & np.isinf(expected)).sum() > 30


@pytest.mark.parametrize("name", SOLIDS)
def test_a_distance_never_promises_more_room_than_there_is(name):
    """Lipschitz constant 1: else a ray would step through a surface."""
    solid = SOLIDS[name]
    random = np.random.default_rng(7)
    low, high = np.array(solid.low) - 0.1, np.array(solid.high) + 0.1
    one = random.uniform(low, high, (20000, 3))
    two = one + random.normal(size=one.shape) * np.exp(random.uniform(-7, 0, (20000, 1))) * 0.3
    move = solid.world_from_local
    values = [point_distances(pack([solid]), points @ move[:3, :3].T + move[:3, 3]) for points in (one, two)]
    steps = np.linalg.norm(one - two, axis=1)
    assert (np.abs(values[0] - values[1]) <= steps * (1 + 1e-6) + 1e-9).all()


@pytest.mark.parametrize("name", SOLIDS)
def test_a_solid_stays_within_its_box(name):
    """Rays look into the box alone, so what stands out of it would be cut off, if the table did not hide it."""
    solid = SOLIDS[name]
    random = np.random.default_rng(8)
    low, high = np.array(solid.low), np.array(solid.high)
    around = random.uniform(low - 0.15, high + 0.15, (40000, 3))
    move = solid.world_from_local
    outside = around[((around < low) | (around > high)).any(1)] @ move[:3, :3].T + move[:3, 3]
    hidden = (outside[:, 2] < TABLE_TOP) & (name != "table")
    assert point_distances(pack([solid]), outside[~hidden]).min() > 0
    within = random.uniform(low, high, (40000, 3))
    assert point_distances(pack([solid]), within @ move[:3, :3].T + move[:3, 3]).min() < 0


def test_a_moved_solid_is_hit_as_the_solid_at_rest_is_by_the_moved_ray():
    vase, pose = SOLIDS["vase"], turned(9, (0.3, 0.1, -0.2))
    rest = Solid(vase.name, vase.kind, vase.params, vase.low, vase.high, np.eye(4))
    away = Solid(vase.name, vase.kind, vase.params, vase.low, vase.high, pose)
    origins, directions = rays_at(np.array([0, 0, 0.5]), 0.4, 1000, 10)
    expected = traced([rest], origins, directions)
    found = traced([away], origins @ pose[:3, :3].T + pose[:3, 3], directions @ pose[:3, :3].T)
    hit = np.isfinite(expected) & np.isfinite(found)
    assert hit.sum() > 300 and (np.isfinite(expected) != np.isfinite(found)).sum() < 5
    assert np.quantile(np.abs(found[hit] - expected[hit]), 0.99) < 1e-4


def test_the_nearest_of_all_solids_is_hit_and_named():
    origins, directions = rays_at(np.array([0, 0, -0.1]), 0.9, 3000, 11)
    distances, owners = LIFE.trace_owners(origins, 2.5 * directions)  # of any length
    alone = np.array([traced([solid], origins, directions) for solid in LIFE.solids])
    np.testing.assert_allclose(distances, alone.min(0), rtol=1e-12)
    hit = np.isfinite(distances)
    np.testing.assert_array_equal(owners[hit], alone.argmin(0)[hit])
    assert (owners[~hit] == -1).all() and len(set(owners[hit])) > 10
    # Where a ray ends, the union's own distance is nothing.
    ends = origins[hit] + distances[hit, None] * directions[hit]
    assert np.abs(LIFE.distance(ends)).max() < 1e-5
    half_way = origins[hit] + 0.5 * distances[hit, None] * directions[hit]
    assert LIFE.distance(half_way).min() > 0


def test_the_still_life_lies_within_its_cube_and_rests_on_the_table():
    random = np.random.default_rng(12)
    shell = random.uniform(-1.6, 1.6, (60000, 3))
    shell = shell[(np.abs(shell) > 1.25).any(1)]
    assert LIFE.distance(shell).min() > 0
    below = np.column_stack([random.uniform(-1.3, 1.3, (20000, 2)), random.uniform(-1.2, TABLE_TOP - 0.112, 20000)])
    assert LIFE.distance(below).min() > 0
    ring, ball = SOLIDS["ring"], SOLIDS["ball"]
    lift = ball.world_from_local[2, 3] - ring.world_from_local[2, 3]
    # The ball touches the ring all round: its center is as far from the ring's core as both radii together.
    assert np.hypot(ring.params[0], lift) == pytest.approx(ball.params[0] + ring.params[1], abs=1e-12)


def test_a_ray_without_a_direction_is_refused():
    with pytest.raises(InvalidValue, match="no direction"):
        LIFE.trace(np.zeros((1, 3)), np.zeros((1, 3)))


def test_nothing_is_hit_beyond_the_scene():
    assert np.isinf(LIFE.trace(np.array([[0, 0, 5.0]]), np.array([[0, 0, 1.0]]))).all()
    assert point_distances(pack([SOLIDS["ball"]]), np.array([[1e6, 0, 0]]))[0] < MISS
