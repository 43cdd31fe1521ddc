"""The painting and its subject: strokes that run along the subject's lines and bend with them, seeded irregularity."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, minimum_filter

from stylerf.errors import InvalidValue
from stylerf.procedural import painting
from stylerf.procedural.composition import PALETTES, colors, compose, hexadecimal
from stylerf.procedural.painting import FINER, LAYERS, follow_flow, joined, lay_strokes, paint, relief

SIZE = 160
PAINTED = paint(SIZE, 0)
SUBJECT = compose(FINER * SIZE, 0)


def test_it_is_a_picture_of_its_size_from_its_seed():
    assert PAINTED.shape == (SIZE, SIZE, 3) and PAINTED.dtype == np.float32
    assert 0 <= PAINTED.min() and PAINTED.max() <= 1
    assert paint(64, 3).tobytes() == paint(64, 3).tobytes()
    assert np.abs(paint(64, 3) - paint(64, 4)).mean() > 0.02
    with pytest.raises(InvalidValue, match="at least 32"):
        paint(31)


def orientation(picture: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Of the lines in a gray picture by its structure tensor: angle [h, w] of least change, coherence 0..1."""
    down, right = np.gradient(gaussian_filter(picture, 0.7))
    xx, yy, xy = (gaussian_filter(one, scale) for one in (right * right, down * down, right * down))
    across = 0.5 * np.arctan2(2 * xy, xx - yy)
    return across + np.pi / 2, np.hypot(xx - yy, 2 * xy) / np.maximum(xx + yy, 1e-12)


def agreement(picture: np.ndarray) -> float:
    """Mean of cos 2(angle of the painted lines - angle of the subject's): 1 along them, 0 at random, -1 across."""
    found, coherence = orientation(picture.mean(-1), 3.0)
    wanted = np.exp(2j * SUBJECT.angles).reshape(SIZE, FINER, SIZE, FINER).mean(axis=(1, 3))
    weights = coherence * np.abs(wanted)
    return float((weights * np.cos(2 * found - np.angle(wanted))).sum() / weights.sum())


def test_strokes_run_along_the_subject_s_lines():
    assert agreement(PAINTED) > 0.6
    assert abs(agreement(PAINTED[::-1])) < 0.35  # another picture's lines do not


def test_strokes_bend_and_show_every_direction():
    """Of the broad brush's strokes, laid as the painting lays them."""
    random, size = np.random.default_rng(0), FINER * SIZE
    starts = random.uniform(0, size - 1, (800, 2))
    points, offsets = follow_flow(starts, np.full(800, LAYERS[0].length * size), SUBJECT.angles, SUBJECT.regions, 0.6)
    turns = []
    for a, b in itertools.pairwise(offsets):
        if b - a > 40:
            way = points[a:b][::10]
            heading = np.unwrap(np.arctan2(*np.diff(way, axis=0).T[::-1]))
            turns.append(np.degrees(np.ptp(heading)))
    assert len(turns) > 300 and np.median(turns) > 15 and np.quantile(turns, 0.9) > 60
    found, coherence = orientation(PAINTED.mean(-1), 3.0)
    counts, _ = np.histogram(found % np.pi, 8, weights=coherence)
    assert counts.min() > 0.03 * counts.sum()


def test_strokes_are_strong():
    """Detail at the width of a stroke: the picture differs from its own blurred self, in relief and in color."""
    blurred = gaussian_filter(PAINTED, (4, 4, 0))
    assert np.abs(PAINTED - blurred).mean() > 0.03
    gray = PAINTED.mean(-1, keepdims=True)
    assert (PAINTED - gray).std() > 0.08


def test_the_palette_is_that_of_the_regions():
    """Mean color of each region lies among its own paints, nearer to them than to a random region's."""
    regions = SUBJECT.regions[FINER // 2 :: FINER, FINER // 2 :: FINER]
    means = {name: PAINTED[regions == index].mean(0) for index, name in enumerate(SUBJECT.names)}
    palettes = {name: colors(name) for name in SUBJECT.names}
    for name, mean in means.items():
        assert palettes[name].min(0).min() - 0.1 < mean.min() and mean.max() < palettes[name].max() + 0.1
    assert means["sky"][2] > means["sky"][0] + 0.1 and means["field"][0] > means["field"][2] + 0.2
    assert means["tree"].mean() < means["glow"].mean() - 0.15


def test_the_ground_and_contours_belong_to_the_picture():
    ground = hexadecimal((painting.GROUND,))[0]
    bare = (np.abs(PAINTED - ground).max(-1) < 0.03).mean()
    assert bare < 0.05  # hardly any canvas is left bare
    assert all(len(codes) >= 6 for codes in PALETTES.values())


# -- the subject -------------------------------------------------------------------------------------------------------


def test_every_region_is_there_and_moves_with_the_seed_a_little():
    other = compose(FINER * SIZE, 1)
    assert SUBJECT.names == other.names and len(SUBJECT.names) == 7
    shares = [np.bincount(one.regions.ravel(), minlength=7) / one.regions.size for one in (SUBJECT, other)]
    assert min(shares[0].min(), shares[1].min()) > 0.02
    assert np.abs(shares[0] - shares[1]).max() < 0.1 and (SUBJECT.regions != other.regions).mean() > 0.005
    for name in ("tones", "detail"):
        values = getattr(SUBJECT, name)
        assert values.min() >= 0 and values.max() <= 1 and values.std() > 0.1


def test_strokes_directions_are_those_of_least_change_of_tone():
    """Along a region's lines its tone stays, across them it changes: the angles are not the gradient's."""
    down, right = np.gradient(SUBJECT.tones)
    along = right * np.cos(SUBJECT.angles) + down * np.sin(SUBJECT.angles)
    across = -right * np.sin(SUBJECT.angles) + down * np.cos(SUBJECT.angles)
    for name in ("range", "far hill", "near hill", "field"):
        index = SUBJECT.names.index(name)
        inside = minimum_filter(SUBJECT.regions == index, 7)
        assert np.median(np.abs(along[inside])) < 0.1 * np.median(np.abs(across[inside])), name


def test_outlines_stay_on_the_canvas():
    size = FINER * SIZE
    assert len(SUBJECT.outlines) > 20
    for curve in SUBJECT.outlines:
        assert curve.shape[1] == 2 and len(curve) > 20 and curve.min() > 0 and curve.max() < size
        assert np.linalg.norm(np.diff(curve, axis=0), axis=1).max() < 2


SIZE = 160
ROWS, COLUMNS = np.mgrid[0:SIZE, 0:SIZE]
ONE_REGION = np.zeros((SIZE, SIZE), np.int64)


def whirl() -> np.ndarray:
    """Angles of circles about the middle."""
    return np.arctan2(COLUMNS + 0.5 - SIZE / 2, -(ROWS + 0.5 - SIZE / 2))


def paths(starts, lengths, angles, regions=ONE_REGION, step=0.5) -> list[np.ndarray]:
    points, offsets = follow_flow(np.asarray(starts, float), np.asarray(lengths, float), angles, regions, step)
    return [points[a:b] for a, b in itertools.pairwise(offsets)]


def test_a_straight_flow_gives_a_straight_path_centered_on_its_start():
    angle = 0.4
    (path,) = paths([[80, 70]], [50], np.full((SIZE, SIZE), angle))
    along = (path - [80, 70]) @ [np.cos(angle), np.sin(angle)]
    across = (path - [80, 70]) @ [-np.sin(angle), np.cos(angle)]
    assert np.abs(across).max() < 1e-9
    np.testing.assert_allclose([along.min(), along.max()], [-24.5, 24.5], atol=0.5)
    np.testing.assert_allclose(np.diff(along), 0.5, atol=1e-9)


def test_a_whirl_bends_a_path_by_its_length_over_its_radius():
    starts = [[80 + radius, 80] for radius in (20, 40, 60)]
    for path, radius in zip(paths(starts, [40] * 3, whirl()), (20, 40, 60), strict=True):
        assert np.abs(np.linalg.norm(path - 80, axis=1) - radius).max() < 1.2  # angles are those of whole pixels
        heading = np.unwrap(np.arctan2(*np.diff(path, axis=0).T[::-1]))
        assert abs(abs(heading[-1] - heading[0]) - 40 / radius) < 0.12


def test_a_flow_has_no_sign():
    """Angles that jump by half a turn describe the same lines."""
    angles = whirl()
    flipped = np.where((ROWS // 7 + COLUMNS // 5) % 2, angles + np.pi, angles)
    one, two = paths([[120, 80]], [60], angles)[0], paths([[120, 80]], [60], flipped)[0]
    gaps = np.linalg.norm(one[:, None] - two[None], axis=-1)
    assert gaps.min(0).max() < 1e-6 and gaps.min(1).max() < 1e-6


def test_paths_end_where_their_region_does_and_at_the_edge():
    regions = (COLUMNS > 90).astype(np.int64)
    left, right, out = paths([[80, 50], [100, 50], [3, 80]], [60, 60, 60], np.zeros((SIZE, SIZE)), regions)
    assert left[:, 0].max() <= 91 < right[:, 0].min() + 0.51 and left[:, 0].max() > 90
    assert out[:, 0].min() >= 0 and out[:, 0].max() > 30


def canvas() -> tuple[np.ndarray, np.ndarray]:
    return np.full((SIZE, SIZE, 3), 0.5), np.zeros((SIZE, SIZE))


def laid(path: np.ndarray, width: float, dryness: float = 0.0, seed: int = 3):
    """One stroke of a single paint on gray."""
    paint, height = canvas()
    points, offsets = joined([path])
    color = np.array([[0.9, 0.3, 0.1]])
    lay_strokes(paint, height, points, offsets, np.array([width]), color, color, dryness, 1.0, seed)
    return paint, height


LINE = np.stack([np.linspace(30, 130, 250), np.full(250, 80.0)], -1)


def test_a_stroke_covers_its_width_and_nothing_beyond():
    paint, height = laid(LINE, 16.0)
    touched = (paint != 0.5).any(-1)
    rows, columns = np.nonzero(touched)
    assert rows.min() >= 71 and rows.max() <= 88 and columns.min() >= 29 and columns.max() <= 130
    assert (height > 0).sum() == (touched & (height > 0)).sum() and height.max() <= 1.5
    middle = touched[75:85, 60:110]
    assert middle.mean() > 0.97
    # The paint, lighter or darker by at most 7 % from hair to hair, laid on nearly opaque.
    core = paint[76:84, 60:110][middle[1:9]]
    np.testing.assert_allclose(core, np.broadcast_to([0.9, 0.3, 0.1], core.shape), atol=0.1)
    assert core[:, 0].std() > 0.003


def test_a_dry_brush_leaves_gaps_towards_its_end():
    touched = [(laid(LINE, 16.0, dryness)[0] != 0.5).any(-1)[74:87] for dryness in (0.0, 0.9)]
    share = [one[:, 100:125].mean() for one in touched]
    assert share[1] < share[0] - 0.15
    assert abs(touched[1][:, 40:60].mean() - touched[0][:, 40:60].mean()) < 0.15  # not at its beginning


def test_strokes_follow_from_their_seed():
    np.testing.assert_array_equal(laid(LINE, 16.0)[0], laid(LINE, 16.0)[0])
    assert (laid(LINE, 16.0)[0] != laid(LINE, 16.0, seed=4)[0]).any()


def test_later_strokes_lie_over_earlier_ones():
    paint, height = canvas()
    cross = LINE[:, ::-1] + [[0, 0]]
    points, offsets = joined([LINE, cross])
    first = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    lay_strokes(paint, height, points, offsets, np.array([16.0, 16.0]), first, first, 0.0, 1.0, 0)
    middle = paint[76:84, 76:84]
    assert middle[..., 2].mean() > 0.75 and middle[..., 0].mean() < 0.15


def test_relief_keeps_flat_paint_and_lights_slopes_from_the_upper_left():
    paint, _ = canvas()
    np.testing.assert_allclose(relief(paint, np.full((SIZE, SIZE), 0.7), 3.0), 0.5 * 1.10, atol=1e-12)
    hill = np.exp(-((ROWS - 80.0) ** 2 + (COLUMNS - 80.0) ** 2) / 300)
    lit = relief(paint, hill, 30.0).mean(-1)
    assert lit[68, 68] > 0.55 + 0.05 and lit[92, 92] < 0.55 - 0.05
    assert 0 <= lit.min() and lit.max() <= 1


def test_joined_paths_come_apart_again():
    pieces = [np.ones((3, 2)), np.zeros((0, 2)), 2 * np.ones((2, 2))]
    points, offsets = joined(pieces)
    for piece, a, b in zip(pieces, offsets[:-1], offsets[1:], strict=True):
        np.testing.assert_array_equal(points[a:b], piece)
    assert joined([])[0].shape == (0, 2)
