"""A palette out of colors: histogram by hand, hulls that hold what they must, mixes that other means find too."""

from collections import defaultdict
from itertools import combinations, product

import numpy as np
import pytest
from scipy.optimize import linprog, minimize
from scipy.spatial import ConvexHull, Delaunay

from stylerf.editing.palette_hull import (
    ERROR,
    cheapest_outside,
    collapsed,
    extracted,
    histogram,
    hull_error,
    mixing_weights,
    simplified,
)
from stylerf.editing.palette_module import weighted_means
from stylerf.errors import InvalidValue

CORNERS = np.array([[0.1, 0.15, 0.1], [0.9, 0.2, 0.1], [0.2, 0.85, 0.2], [0.3, 0.2, 0.9]])


def mixes(count: int, seed: int, corners: np.ndarray = CORNERS) -> np.ndarray:
    return np.random.default_rng(seed).dirichlet(np.full(len(corners), 0.4), count) @ corners


def test_a_histogram_tells_means_and_shares_of_its_bins():
    colors = np.concatenate([np.random.default_rng(0).random((300, 3)), np.eye(3), np.ones((1, 3))])
    held = defaultdict(list)
    for color in colors:
        held[tuple(min(int(v * 8), 7) for v in color)].append(color)
    means, shares = histogram(colors, 3)
    np.testing.assert_allclose(means, [np.mean(held[key], 0) for key in sorted(held)], rtol=1e-12)
    np.testing.assert_allclose(shares, [len(held[key]) / len(colors) for key in sorted(held)])


def test_means_are_drawn_by_mass_and_an_empty_cluster_stays():
    colors = np.array([[0.1, 0, 0], [0.2, 0, 0], [0.9, 0, 0]])
    start = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 5]])
    centers, _ = weighted_means(colors, np.array([3.0, 1, 1]), start, 20)
    np.testing.assert_allclose(centers, [[0.125, 0, 0], [0.9, 0, 0], [0, 0, 5]])


def test_a_collapsed_hull_has_a_corner_less_holds_all_and_adds_the_least():
    points = np.random.default_rng(1).normal(size=(40, 3)) * 0.1 + 0.5
    hull = ConvexHull(points)
    corners = points[hull.vertices]
    fewer = collapsed(corners)
    assert len(fewer) < len(corners)
    outside = (points @ ConvexHull(fewer).equations[:, :3].T + ConvexHull(fewer).equations[:, 3]).max()
    assert outside < 1e-8
    (new,) = [corner for corner in fewer if np.abs(corners - corner).max(1).min() > 1e-9]
    np.testing.assert_allclose(new, cheapest_by_linear_programming(points, hull), atol=1e-6)


def cheapest_by_linear_programming(points: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """Of all edges' points outside of the faces beside them, the one whose tetrahedra over those hold the least."""
    found = []
    for edge in {frozenset(pair) for face in hull.simplices for pair in combinations(face.tolist(), 2)}:
        beside = [k for k, face in enumerate(hull.simplices) if edge & set(face)]
        planes, faces = hull.equations[beside], points[hull.simplices[beside]]

        def held(point, faces=faces):
            return np.abs(np.linalg.det(faces - point)).sum() / 6

        middle = points.mean(0)  # all tetrahedra over outer faces lie on one side: their volumes change linearly
        slope = [-(held(middle + step) - held(middle)) / 1e-3 for step in 1e-3 * np.eye(3)]
        best = linprog(slope, A_ub=-planes[:, :3], b_ub=planes[:, 3], bounds=[(-1, 2)] * 3)
        if best.status == 0:
            found.append((held(best.x), best.x))
    return min(found, key=lambda one: one[0])[1]


@pytest.mark.parametrize("seed", range(5))
def test_the_least_point_outside_is_that_of_linear_programming(seed):
    """Faces around a corner that looks up, moved at random."""
    generator = np.random.default_rng(seed)
    normals = np.column_stack([generator.normal(size=(8, 2)), np.full(8, 1.0)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    depths, cost = -normals @ generator.random(3) + generator.uniform(-0.02, 0.02, 8), generator.random(8) @ normals
    bounds = [(0.5 - 1.5, 0.5 + 1.5)] * 3
    expected = linprog(cost, A_ub=-normals, b_ub=depths, bounds=bounds)
    found = cheapest_outside(normals, depths, cost)
    assert expected.status == 0 and cost @ found == pytest.approx(expected.fun, abs=1e-7)
    assert (normals @ found + depths > -1e-8).all()


def test_a_shape_is_simplified_to_its_own_corners():
    found = simplified(np.concatenate([CORNERS, mixes(200, 2)]), 4)
    np.testing.assert_allclose(found[np.lexsort(found.T)], CORNERS[np.lexsort(CORNERS.T)], atol=1e-6)


def test_a_tetrahedron_is_recovered_from_points_without_its_tips():
    cut = mixes(100, 3)
    cut = cut[mixing_weights(cut, CORNERS).max(1) < 0.9]
    found = simplified(cut, 4)
    assert len(found) == 4 and (Delaunay(found).find_simplex(cut * (1 - 1e-6) + 1e-6 * cut.mean(0)) >= 0).all()
    apart = np.linalg.norm(found[:, None] - CORNERS, axis=-1).min(1)
    assert apart.max() < 0.1


def test_a_box_loses_the_corners_that_are_missed_least_since_no_edge_of_it_can_be_collapsed():
    box = np.array(list(product([0.1, 0.9], repeat=3)))
    assert collapsed(box) is None
    # Most colors are mixes of five of the corners.
    colors = np.concatenate([box, mixes(200, 8, box[[0, 1, 2, 4, 7]])])
    np.testing.assert_array_equal(simplified(colors, 5), box[[0, 1, 2, 4, 7]])
    assert len(simplified(colors, 4)) == 4 and extracted(colors, 6, np.random.default_rng(0)).palette.shape == (6, 3)


def test_as_few_corners_as_the_error_asks_for():
    colors = mixes(120, 4)
    colors = colors[(mixing_weights(colors, CORNERS).max(1) < 0.95)]
    found = simplified(colors, 0)
    assert 4 <= len(found) <= len(ConvexHull(colors).vertices) and hull_error(found, colors) <= ERROR


def test_weights_are_barycentric_inside_and_nearest_point_outside():
    wanted = np.random.default_rng(5).dirichlet(np.ones(4), 20)
    np.testing.assert_allclose(mixing_weights(wanted @ CORNERS, CORNERS), wanted, atol=1e-6)
    for color in np.random.default_rng(6).random((4, 3)) * 1.4 - 0.2:
        best = minimize(
            lambda w, color=color: np.square(w @ CORNERS - color).sum(), np.full(4, 0.25), bounds=[(0, 1)] * 4,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1}, options={"ftol": 1e-14, "maxiter": 500},
        )  # fmt: skip
        np.testing.assert_allclose(mixing_weights(color[None], CORNERS)[0] @ CORNERS, best.x @ CORNERS, atol=2e-3)


def test_an_extracted_palette_mixes_the_colors_and_guides_by_those_mixes():
    colors = np.concatenate([np.repeat(CORNERS, 400, 0), mixes(4000, 7)]).astype(np.float32)
    found = extracted(colors, 4, np.random.default_rng(0))
    assert found.palette.shape == (4, 3) and found.palette.dtype == np.float32 and found.error < 0.03
    assert np.linalg.norm(found.palette[:, None] - CORNERS, axis=-1).min(0).max() < 0.12
    np.testing.assert_allclose(found.guide.sum(-1), 1, atol=1e-5)
    np.testing.assert_allclose(found.weights_of(colors), mixing_weights(colors, found.palette), atol=0.12)
    nearest = found.weights_of(found.palette)  # a corner is nearly itself alone
    assert (nearest.max(1) > 0.7).all() and set(nearest.argmax(1)) == {0, 1, 2, 3}


def test_grays_have_a_palette_too():
    gray = np.repeat(np.linspace(0.1, 0.9, 500)[:, None], 3, 1)
    found = extracted(gray, 4, np.random.default_rng(0))
    assert found.palette.shape == (4, 3) and np.ptp(found.palette, 1).max() < 1e-6
    assert np.ptp(found.palette[:, 0]) > 0.4 and found.error < 0.1


@pytest.mark.parametrize(
    ("colors", "expected"),
    [
        (np.repeat(np.linspace(0, 1, 1000)[:, None], 3, 1), 2),
        (np.full((1000, 3), 0.4), 1),
        (np.repeat(CORNERS[:2], 500, 0), 2),
        (mixes(4000, 7, CORNERS[:3]), 3),
    ],
    ids=["ramp", "one color", "two colors", "triangle"],
)
def test_colors_without_volume_get_as_few_as_leave_the_error(colors, expected):
    found = extracted(colors, 0, np.random.default_rng(0))
    assert found.error <= ERROR and expected <= len(found.palette) <= expected + (expected > 2)
    np.testing.assert_allclose(found.guide.sum(-1), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("colors", "size"), [(np.ones((5, 3)), 3), (np.empty((0, 3)), 4), (np.full((2, 3), np.nan), 4)]
)
def test_what_has_no_palette_is_refused(colors, size):
    with pytest.raises(InvalidValue, match="a palette of"):
        extracted(colors, size, np.random.default_rng(0))
