"""Palette extraction from a simplified convex hull of a scene's colors (Tan et al. 2016 and 2018).

As in PaletteNeRF: frequent colors by histogram and weighted k-means, their convex hull, and edge collapses. Every color
inside the hull is then a mix of its corners, which initializes the weights.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from stylerf.editing.palette_module import clustered_palette, weighted_means
from stylerf.errors import InvalidValue

COARSE, FINE = 3, 5  # bits per channel
FREQUENT = 8e-3  # minimum fraction of all colors for a coarse bin to seed a cluster
ERROR = 5 / 255  # maximum root mean square error of the frequent colors if the size is chosen automatically
FEWEST = 4  # corners of a hull with a volume
ROUNDS = 20
SUM_WEIGHT = 100.0  # weight of the constraint that weights add up to 1, relative to the color error
SIDE = 1 << FINE
SLANTED = 1e-9  # determinant of three unit normals below which their planes have no common point
FARTHEST = 1.5  # maximum distance of a corner from mid-gray, per channel, before clipping


@dataclass(frozen=True, eq=False)
class ExtractedPalette:
    """A palette and the weights of all colors.

    Attributes:
        palette: [M, 3] sRGB 0..1.
        guide: [32, 32, 32, M] float32, weights for each color bin, which add up to 1.
        error: Root mean square error of the mixes over colors and channels.
    """

    palette: np.ndarray
    guide: np.ndarray
    error: float

    def weights_of(self, colors: np.ndarray) -> np.ndarray:
        """Look up the weights [n, M] of colors [n, 3], 0..1."""
        return self.guide[tuple(bins_of(colors, FINE).T)]


def bins_of(colors: np.ndarray, bits: int) -> np.ndarray:
    """Return the bin indices [n, 3] int64 of colors 0..1."""
    return np.clip(np.floor(np.asarray(colors) * (1 << bits)), 0, (1 << bits) - 1).astype(np.int64)


def histogram(colors: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean colors [m, 3] float64 and fractions [m] of the nonempty bins of colors [n, 3]."""
    side = 1 << bits
    flat = np.ravel_multi_index(tuple(bins_of(colors, bits).T), (side,) * 3)
    counts = np.bincount(flat, minlength=side**3)
    there = np.flatnonzero(counts)
    sums = np.stack([np.bincount(flat, np.asarray(colors)[:, a], side**3)[there] for a in range(3)], 1)
    return sums / counts[there, None], counts[there] / len(flat)


def extracted(colors: np.ndarray, size: int, generator: np.random.Generator) -> ExtractedPalette:
    """Extract a palette from colors [n, 3], 0..1.

    Colors without volume (grays, a single ramp) have no hull; their palette comes from k-means, or from flat_palette.

    Args:
        colors: [n, 3].
        size: Number of corners, at least 4; 0 for the fewest with an error of at most ERROR (for colors without volume,
            one to three may suffice).
    """
    if len(colors) == 0 or not np.isfinite(colors).all() or 0 < size < FEWEST or size < 0:
        raise InvalidValue(f"cannot extract a palette of {size} colors (0, or at least 4) from {len(colors)} colors")
    fine, masses = histogram(colors, FINE)
    means, shares = histogram(colors, COARSE)
    frequent = weighted_means(fine, masses, means[shares > FREQUENT] if (shares > FREQUENT).any() else means, ROUNDS)[0]
    try:
        palette = simplified(frequent, size)
    except (QhullError, ValueError):
        if size:
            palette = clustered_palette(generator, fine, size).astype(np.float64)
        else:
            palette = flat_palette(frequent, fine, masses)
    mixes = mixing_weights(fine, palette)
    error = np.sqrt((masses[:, None] * np.square(mixes @ palette - fine)).sum() / 3)
    return ExtractedPalette(palette.astype(np.float32), _table(fine, mixes), float(error))


def simplified(colors: np.ndarray, size: int) -> np.ndarray:
    """Return the corners [M, 3], 0..1, of the convex hull of colors [n, 3], with edges collapsed until `size` are left.

    With size 0, until another collapse would exceed ERROR or 4 are left. If no edge can be collapsed, as in a box, the
    corner whose removal costs least is removed. Raises QhullError if colors have no volume.
    """
    hull = ConvexHull(colors)
    corners = colors[hull.vertices]
    while len(corners) > max(size, FEWEST):
        fewer = collapsed(corners)
        if fewer is None:
            fewer = min((np.delete(corners, i, 0) for i in range(len(corners))), key=lambda c: hull_error(c, colors))
        if size == 0 and hull_error(np.clip(fewer, 0, 1), colors) > ERROR:
            break
        corners = fewer
    return np.clip(corners, 0, 1)


def flat_palette(frequent: np.ndarray, colors: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """Return a palette [M, 3] for colors without volume: the ends of their longest axis, plus others if necessary.

    The colors that contribute most to the error are added one by one until it is at most ERROR.

    Args:
        frequent: [k, 3]; the ends are two of these, or one if all are equal.
        colors: [n, 3], for which the error is computed.
        masses: [n], their shares.
    """
    centered = frequent - frequent.mean(0)
    along = centered @ np.linalg.svd(centered, full_matrices=False)[2][0]
    palette = np.unique(frequent[[along.argmin(), along.argmax()]], axis=0)
    while True:
        squares = masses * np.square(mixing_weights(colors, palette) @ palette - colors).sum(1)
        if np.sqrt(squares.sum() / 3) <= ERROR:
            return palette
        palette = np.concatenate([palette, colors[squares.argmax()][None]])


def collapsed(corners: np.ndarray) -> np.ndarray | None:
    """Collapse the edge of a convex hull with corners [m, 3] that adds the least volume; None if that is impossible.

    The new point is outside all faces that touch the edge, so the new hull contains the old one (Sander et al. 2000).
    """
    hull = ConvexHull(corners)
    best: tuple[float, int, int, np.ndarray] | None = None
    edges = {(min(f[i], f[i - 1]), max(f[i], f[i - 1])) for f in hull.simplices for i in range(3)}
    for first, second in sorted(edges):
        beside = (hull.simplices == first).any(1) | (hull.simplices == second).any(1)
        normals, depths = hull.equations[beside, :3], hull.equations[beside, 3]
        areas = np.array([_area(corners[face]) for face in hull.simplices[beside]])
        # The added volume is a sum of pyramids over these faces, area * distance / 3, which is linear in the point.
        found = cheapest_outside(normals, depths, areas @ normals / 3)
        if found is None:
            continue
        added = float(areas @ (normals @ found + depths)) / 3
        # The slack resolves ties in favor of the first edge, regardless of rounding.
        if best is None or added < best[0] - 1e-12:
            best = added, first, second, found
    if best is None:
        return None
    _, first, second, point = best
    # The next hull drops corners that the new point has moved inside.
    left = np.concatenate([np.delete(corners, [first, second], 0), point[None]])
    return left[ConvexHull(left).vertices]


def cheapest_outside(normals: np.ndarray, depths: np.ndarray, cost: np.ndarray) -> np.ndarray | None:
    """Return the point [3] that minimizes cost @ point subject to normals [k, 3] @ point + depths >= 0, or None.

    A linear program in three unknowns: its optimum is where three of the planes intersect, so all such points are
    tried.
    """
    triples = np.array(list(combinations(range(len(depths)), 3)))
    systems = normals[triples]
    meeting = np.abs(np.linalg.det(systems)) > SLANTED
    places = np.linalg.solve(systems[meeting], -depths[triples[meeting]][..., None])[..., 0]
    places = places[(places @ normals.T + depths >= -1e-9).all(1) & (np.abs(places - 0.5) < FARTHEST).all(1)]
    return places[(places @ cost).argmin()] if len(places) else None


def _area(face: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(face[1] - face[0], face[2] - face[0])) / 2)


def hull_error(palette: np.ndarray, colors: np.ndarray) -> float:
    """Return the root mean square error of the nearest palette mixes of colors [n, 3], over colors and channels."""
    return float(np.sqrt(np.square(mixing_weights(colors, palette) @ palette - colors).mean()))


def mixing_weights(colors: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """Return the weights [n, M], nonnegative and adding up to 1, of the palette mix nearest to each of colors [n, 3].

    Barycentric coordinates for four corners; for more, the sparse solution of the active-set method.
    """
    # sum w = 1 as a heavily weighted fourth equation: NNLS supports only w >= 0.
    rows = np.concatenate([np.asarray(palette, np.float64).T, np.full((1, len(palette)), SUM_WEIGHT)])
    found = np.stack([nnls(rows, np.append(color, SUM_WEIGHT))[0] for color in np.asarray(colors, np.float64)])
    return found / found.sum(1, keepdims=True)


def _table(colors: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Spread the weights [n, M] of colors [n, 3] to all bins, [32, 32, 32, M]; empty bins use the nearest bin's."""
    table = np.zeros((SIDE, SIDE, SIDE, weights.shape[1]), np.float32)
    held = np.zeros((SIDE,) * 3, bool)
    place = tuple(bins_of(colors, FINE).T)
    table[place], held[place] = weights, True
    nearest = distance_transform_edt(~held, return_distances=False, return_indices=True)
    return table[tuple(nearest)]
