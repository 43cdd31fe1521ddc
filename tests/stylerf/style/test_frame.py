"""Frames are found to the pixel, and paintings without one stay whole."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from stylerf.corruption import style_images
from stylerf.style.frame import Frame, frame_of

WIDTHS = (24, 31, 18, 27)  # left, top, right, bottom
Paint = Callable[[int, int], np.ndarray]
ROWS, COLUMNS = np.mgrid[:240, :320]
INWARD = np.minimum(np.minimum(COLUMNS, 319 - COLUMNS), np.minimum(ROWS, 239 - ROWS))  # pixels to the nearest side


@cache
def painted() -> np.ndarray:
    return style_images.ordinary(320, 3)[:240]


def painting() -> np.ndarray:
    return painted().copy()


def framed(widths: tuple[int, int, int, int], paint: Paint, inside: np.ndarray | None = None) -> np.ndarray:
    inside = painting() if inside is None else inside
    left, top, right, bottom = widths
    height, width = inside.shape[:2]
    whole = paint(height + top + bottom, width + left + right).astype(np.float32)
    whole[top : top + height, left : left + width] = inside
    return whole


def white(height: int, width: int) -> np.ndarray:
    return np.ones((height, width, 3))


def paper(height: int, width: int) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 0.012, (height, width, 1))
    return np.clip(np.array([0.95, 0.93, 0.88]) + noise, 0, 1)


def black(height: int, width: int) -> np.ndarray:
    return np.zeros((height, width, 3))


def gold(height: int, width: int) -> np.ndarray:
    """A profile across, a lamp's gradient along."""
    rows, columns = np.mgrid[:height, :width]
    depth = np.minimum(np.minimum(columns, width - 1 - columns), np.minimum(rows, height - 1 - rows))
    lamp = 1 - 0.25 * rows / height + 0.1 * columns / width
    return np.clip(((0.6 + 0.3 * np.sin(depth / 6)) * lamp)[..., None] * np.array([0.9, 0.7, 0.3]), 0, 1)


def black_on_white(height: int, width: int) -> np.ndarray:
    """A black frame around a mat of 8 pixels beside the painting of WIDTHS."""
    mat = white(height, width)
    left, top, right, bottom = (w - 8 for w in WIDTHS)
    mat[:top], mat[height - bottom :], mat[:, :left], mat[:, width - right :] = 0.1, 0.1, 0.1, 0.1
    return mat


@pytest.mark.parametrize(
    ("paint", "widths"),
    [
        (white, WIDTHS),
        (white, (2, 2, 2, 2)),
        (white, (0, 0, 20, 33)),  # a scan that was laid in a corner
        (paper, WIDTHS),
        (black, (0, 40, 0, 40)),  # letterbox
        (black, (36, 0, 36, 0)),
        (gold, WIDTHS),
        (black_on_white, WIDTHS),
    ],
)
def test_bands_are_found_to_the_pixel(paint, widths):
    found = frame_of(framed(widths, paint))
    assert found == Frame(*widths)
    assert np.array_equal(found.without(framed(widths, paint)), painting())


def test_paper_ends_where_an_even_sky_begins():
    inside = painting()
    inside[:90] = (0.55, 0.7, 0.85)
    assert frame_of(framed(WIDTHS, white, inside)) == Frame(*WIDTHS)


def repeated(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[..., None], 3, axis=2).astype(np.float32)


def mosaic() -> np.ndarray:
    """Tiles of 16 pixels; those at the border alternate between two grays."""
    tiles = (ROWS // 16 * 31 + COLUMNS // 16 * 17) % 7 / 7
    return repeated(np.where(INWARD < 16, (ROWS // 16 + COLUMNS // 16) % 2 * 0.5 + 0.2, tiles))


def flag() -> np.ndarray:
    colors = np.ones((240, 320, 3), np.float32) * (1, 0, 0)
    colors[80:160] = 1
    return colors


FRAMELESS = {
    "painting": painting,
    "dark painting with dark edges": lambda: painting() * np.clip(INWARD / 60, 0, 1)[..., None],
    "vignette": lambda: (
        painting() * np.clip(1.3 - np.hypot((ROWS - 120) / 120, (COLUMNS - 160) / 160), 0, 1)[..., None]
    ),
    "mosaic": mosaic,
    "stripes": lambda: repeated((COLUMNS // 10 % 2).astype(float)),
    "checks": lambda: repeated(((ROWS // 20 + COLUMNS // 20) % 2).astype(float)),
    "disc on white": lambda: repeated(np.where(np.hypot(ROWS - 120, COLUMNS - 160) < 100, 0.2, 1.0)),
    "one even side": lambda: np.where((ROWS > 190)[..., None], np.float32(0.1), painting()),
    "sky and ground": lambda: np.where(
        (ROWS > 200)[..., None], (0.2, 0.3, 0.1), np.where((ROWS < 50)[..., None], (0.5, 0.7, 0.9), painting())
    ),
    "flag": flag,
    "blank": lambda: style_images.white(64),
    "wash": lambda: style_images.weak_geometry(128, 0),
    "blots": lambda: style_images.extreme_palette(128, 0),
    "icon": lambda: style_images.tiny(16, 0),
    "scan": lambda: style_images.huge(512, 0),
}


@pytest.mark.parametrize("name", FRAMELESS)
def test_paintings_without_a_frame_stay_whole(name):
    assert not frame_of(np.asarray(FRAMELESS[name](), np.float32))


def test_a_frame_reads_as_its_sides():
    assert str(Frame(left=24, bottom=30)) == "24 px at the left, 30 px at the bottom"
    assert not Frame() and Frame(right=2)
