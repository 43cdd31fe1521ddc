"""Detect frames of scanned paintings: bands along the sides, uniform along each side, that end in a straight edge.

Below, rows are the lines parallel to a side, counted from it. A row is uniform if its colors vary little apart from a
linear trend, so a band may be shaded across (a profile) and along (a lamp). A painting without a frame may also have
uniform rows, such as sky. The difference is the edge: it spans the whole side at one depth, and other sides have one
too.
"""

from dataclasses import dataclass

import numpy as np

MOST = 0.25  # widest band, relative to the image's side
LEAST = 2  # pixels
MIDDLE = (0.25, 0.75)  # part of a row that decides whether it is uniform: bands of other sides cross its ends
UNIFORM = 0.03  # largest robust spread of a uniform row, sRGB 0..1
STEP = 0.025  # minimum change of color across an edge, or SPREADS times the band's spread if larger
SPREADS = 4.0
CROSSED = 0.75  # fraction of a side along which colors must change at an edge
BESIDE = 4  # rows before an edge that it is compared with
RINGING = 8  # rows before an edge that may be affected by JPEG ringing
BLURRED = 0.75  # fraction of the change at an edge below which a row is still a mixture of both sides
ALIKE = 0.06  # maximum color difference between bands of one frame
SIDES = ("left", "top", "right", "bottom")


@dataclass(frozen=True)
class Frame:
    """Widths of a frame's bands in pixels, 0 where there is none."""

    left: int = 0
    top: int = 0
    right: int = 0
    bottom: int = 0

    def __bool__(self) -> bool:
        return any((self.left, self.top, self.right, self.bottom))

    def __str__(self) -> str:
        """Format as "24 px at the left, 30 px at the top"."""
        return ", ".join(f"{getattr(self, side)} px at the {side}" for side in SIDES if getattr(self, side))

    def without(self, pixels: np.ndarray) -> np.ndarray:
        """Return an image [h, w, c] without the bands."""
        height, width = pixels.shape[:2]
        return np.ascontiguousarray(pixels[self.top : height - self.bottom, self.left : width - self.right])


@dataclass(frozen=True)
class _Edge:
    """Where a band may end.

    Attributes:
        depth: Rows of the band.
        color: Its color beside the edge, [3].
        ends: Whether no uniform row follows; otherwise, the edge may be within a frame or within a painting.
    """

    depth: int
    color: np.ndarray
    ends: bool


def frame_of(pixels: np.ndarray) -> Frame:
    """Find the frame of an image.

    Either the bands of all four sides end in an edge, or those of at least two sides have an edge where their colors
    are similar. Thus a band that continues uniformly into the painting (a sky below white paper) ends where the others
    do. Not found: carved or worn frames, and frames wider than MOST, rotated by more than a fraction of a degree, or on
    one side only.

    Args:
        pixels: [h, w, 3] sRGB 0..1.
    """
    views = {side: _rows_from(pixels, side) for side in SIDES}
    edges = {side: _edges(rows) for side, rows in views.items()}
    found = {side: some[-1] for side, some in edges.items() if some and some[-1].ends}
    if len(found) < len(SIDES):
        groups = [{side: _innermost_like(one, some) for side, some in edges.items()} for one in found.values()]
        found = max(({s: e for s, e in group.items() if e} for group in groups), key=len, default={})
    found = {side: edge for side, edge in found.items() if _whole(views[side], side, found)}
    return Frame(**{side: edge.depth for side, edge in found.items()}) if len(found) > 1 else Frame()


def _innermost_like(wanted: _Edge, edges: list[_Edge]) -> _Edge | None:
    alike = [edge for edge in edges if np.abs(edge.color - wanted.color).max() <= ALIKE]
    return alike[-1] if alike else None


def _rows_from(pixels: np.ndarray, side: str) -> np.ndarray:
    """View an image with the given side as its first row, [rows, columns, 3]."""
    rows = pixels.swapaxes(0, 1) if side in ("left", "right") else pixels
    return rows[::-1] if side in ("right", "bottom") else rows


def _whole(rows: np.ndarray, side: str, found: dict[str, _Edge]) -> bool:
    """Whether a band and its edge extend from one neighboring band to the other."""
    before, after = ("left", "right") if side in ("top", "bottom") else ("top", "bottom")
    first, last = (found[one].depth if one in found else 0 for one in (before, after))
    between, at = rows[:, first : rows.shape[1] - last], found[side].depth
    spread = float(np.median([_spread(row) for row in between[max(0, at - RINGING) : at]]))
    return spread <= UNIFORM and _crosses(between, at, at, spread)


def _edges(rows: np.ndarray) -> list[_Edge]:
    """Return the edges within and at the end of the uniform rows, sorted by depth."""
    count, columns = rows.shape[:2]
    middle, most = rows[:, int(MIDDLE[0] * columns) : int(MIDDLE[1] * columns)], int(MOST * count)
    spreads: list[float] = []
    for row in middle[: most + 1]:
        if (spread := _spread(row)) > UNIFORM:
            break
        spreads.append(spread)
    uniform, found = len(spreads), list[_Edge]()
    if uniform < LEAST:
        return found
    crossing = [at for at in range(LEAST, uniform - 1) if _crosses(middle, at, at, max(spreads[:at]))]
    for at in [one for one in crossing if one - 1 not in crossing]:
        found.append(_Edge(_sharp(middle, at), _band(middle, at), False))
    if uniform > most:
        return found
    for at in range(uniform, min(uniform + RINGING, count - 4) + 1):
        if _crosses(middle, at, uniform, max(spreads)):
            return [*found, _Edge(_sharp(middle, at), _band(middle, uniform), True)]
    return found


def _spread(row: np.ndarray) -> float:
    """Return the standard deviation of a row's colors [n, 3] about a linear trend, estimated from their deciles."""
    places = np.linspace(-1, 1, len(row))
    centered = row - row.mean(axis=0)
    trend = places[:, None] * (places @ centered) / (places @ places)
    low, high = np.percentile(centered - trend, (10, 90), axis=0)
    return float((high - low).max()) / 2.563


def _band(rows: np.ndarray, at: int) -> np.ndarray:
    """Return the color [3] of a band before row `at`."""
    return np.median(rows[max(0, at - BESIDE) : at], axis=(0, 1))


def _crosses(rows: np.ndarray, at: int, until: int, spread: float) -> bool:
    """Whether two rows from `at` on differ, along CROSSED of the side, from the band before row `until`."""
    band = np.median(rows[max(0, until - BESIDE) : until], axis=0)
    change = np.abs(rows[at : at + 2] - band).max(axis=2)
    return bool(((change > max(STEP, SPREADS * spread)).mean(axis=1) >= CROSSED).all())


def _sharp(rows: np.ndarray, at: int) -> int:
    """Return where an edge that begins at row `at` ends: a blurred one mixes two rows of both sides."""
    band = np.median(rows[max(0, at - BESIDE) : at], axis=0)
    for _ in range(2):
        here, there = rows[at] - band, rows[at + 1] - band
        product, size = float((here * there).sum()), float((there * there).sum())
        alike = product / max(float(np.linalg.norm(here)) * size**0.5, 1e-12)
        if not (alike > 0.9 and product < BLURRED * size):
            break
        at += 1
    return at
