"""The painting and its subject: strokes that run along the subject's lines and bend with them, seeded irregularity."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, minimum_filter

from stylerf.errors import InvalidValue
from stylerf.procedural import painting
from stylerf.procedural.composition import PALETTES, colors, compose, hexadecimal
from stylerf.procedural.painting import FINER, LAYERS, paint
from stylerf.procedural.strokes import follow_flow

SIZE = 160
PAINTED = paint(SIZE, 0)
SUBJECT = compose(FINER * SIZE, 0)


def test_it_is_a_picture_of_its_size_from_its_seed():
    assert PAINTED.shape == (SIZE, SIZE, 3) and PAINTED.dtype == np.float32
    assert 0 <= PAINTED.min() and PAINTED.max() <= 1
    assert paint(64, 3).tobytes() == paint(64, 3).tobytes()
    assert np.abs(paint(64, 3) - paint(64, 4)).mean() > 0.02
    with pytest.raises(InvalidValue, match="32 at least"):
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
