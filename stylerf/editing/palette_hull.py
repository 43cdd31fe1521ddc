"""A palette of a scene's colors: the corners of a simple shape around nearly all of them (Tan et al. 2016 and 2018).

As PaletteNeRF takes it: frequent colors by histogram and weighted k-means, their convex hull, its edges collapsed one
by one. Every color within is then a mix of the corners, and the mix tells weights where there is nothing else to.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

from stylerf.editing.palette_module import clustered_palette
from stylerf.errors import InvalidValue

COARSE, FINE = 3, 5  # bits a channel
FREQUENT = 8e-3  # share of all colors from which a coarse bin begins a cluster
ERROR = 5 / 255  # root mean square that a palette chosen by error leaves of the frequent colors
FEWEST = 4  # corners of a shape that holds a volume
ROUNDS = 20
SUM_WEIGHT = 100.0  # of the weights' sum being 1, beside the color's error
SIDE = 1 << FINE
SLANTED = 1e-9  # determinant of three unit normals under which their planes meet nowhere, or in a line
FARTHEST = 1.5  # from the middle of the colors, along each channel, that a corner may lie before it is clipped


@dataclass(frozen=True, eq=False)
class ExtractedPalette:
    """palette [M, 3] sRGB 0..1. guide [32, 32, 32, M] float32: weights, each adding up to 1, of the colors of a
    32nd of each channel. error: root mean square over the frequent colors and channels that mixes leave."""

    palette: np.ndarray
    guide: np.ndarray
    error: float

    def weights_of(self, colors: np.ndarray) -> np.ndarray:
        """[n, M] of colors [n, 3] in 0..1."""
        return self.guide[tuple(bins_of(colors, FINE).T)]


def bins_of(colors: np.ndarray, bits: int) -> np.ndarray:
    """[n, 3] int64: bins of colors in 0..1."""
    return np.clip(np.floor(np.asarray(colors) * (1 << bits)), 0, (1 << bits) - 1).astype(np.int64)


def histogram(colors: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """(mean colors [m, 3] float64, shares [m]) of the bins that hold any of colors [n, 3]."""
    side = 1 << bits
    flat = np.ravel_multi_index(tuple(bins_of(colors, bits).T), (side,) * 3)
    counts = np.bincount(flat, minlength=side**3)
    there = np.flatnonzero(counts)
    sums = np.stack([np.bincount(flat, np.asarray(colors)[:, a], side**3)[there] for a in range(3)], 1)
    return sums / counts[there, None], counts[there] / len(flat)


def weighted_means(colors: np.ndarray, masses: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """[k, 3]: k-means of colors [n, 3] that count by their masses, begun at centers [k, 3]; an empty cluster stays."""
    for _ in range(ROUNDS):
        nearest = np.square(colors[:, None] - centers).sum(-1).argmin(1)
        sizes = np.bincount(nearest, masses, len(centers))
        sums = np.stack([np.bincount(nearest, masses * colors[:, a], len(centers)) for a in range(3)], 1)
        centers = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1e-12)[:, None], centers)
    return centers


def extracted(colors: np.ndarray, size: int, generator: np.random.Generator) -> ExtractedPalette:
    """Of colors [n, 3] in 0..1. size: corners, at least 4; 0: as few as leave ERROR of the frequent colors.

    Colors without volume (grays, a single ramp) have no such shape: their palette is that of k-means.
    """
    if len(colors) == 0 or not np.isfinite(colors).all() or 0 < size < FEWEST or size < 0:
        raise InvalidValue(f"a palette of {size} (0, or 4 and more) was asked of {len(colors)} colors")
    fine, masses = histogram(colors, FINE)
    means, shares = histogram(colors, COARSE)
    frequent = weighted_means(fine, masses, means[shares > FREQUENT] if (shares > FREQUENT).any() else means)
    try:
        palette = simplified(frequent, size)
    except (QhullError, ValueError):
        palette = clustered_palette(generator, fine, size or FEWEST).astype(np.float64)
    mixes = mixing_weights(fine, palette)
    error = np.sqrt((masses[:, None] * np.square(mixes @ palette - fine)).sum() / 3)
    return ExtractedPalette(palette.astype(np.float32), _table(fine, mixes), float(error))


def simplified(colors: np.ndarray, size: int) -> np.ndarray:
    """[M, 3] in 0..1: corners of the convex hull of colors [n, 3], edges collapsed until `size` are left.

    size 0: until the next would leave more than ERROR of the colors outside, or 4 are left. Raises QhullError where
    the colors have no volume.
    """
    hull = ConvexHull(colors)
    corners = colors[hull.vertices]
    while len(corners) > max(size, FEWEST):
        fewer = collapsed(corners)
        if fewer is None or (size == 0 and hull_error(np.clip(fewer, 0, 1), colors) > ERROR):
            break
        corners = fewer
    return np.clip(corners, 0, 1)


def collapsed(corners: np.ndarray) -> np.ndarray | None:
    """Corners [m, 3] of a convex hull with one edge made a point, the one that adds the least volume; None: none can.

    The point lies outside of all faces that meet the edge, so that the new hull holds the old (Sander et al. 2000).
    """
    hull = ConvexHull(corners)
    best: tuple[float, int, int, np.ndarray] | None = None
    for first, second in sorted({tuple(sorted((f[i], f[i - 1]))) for f in hull.simplices for i in range(3)}):
        beside = (hull.simplices == first).any(1) | (hull.simplices == second).any(1)
        normals, depths = hull.equations[beside, :3], hull.equations[beside, 3]
        areas = np.array([_area(corners[face]) for face in hull.simplices[beside]])
        # Volume added is a sum of pyramids over these faces: area times distance by three, linear in the point.
        found = least_outside(normals, depths, areas @ normals / 3)
        if found is None:
            continue
        added = float(areas @ (normals @ found + depths)) / 3
        if best is None or added < best[0] - 1e-12:
            best = added, first, second, found
    if best is None:
        return None
    _, first, second, point = best
    left = np.concatenate([np.delete(corners, [first, second], 0), point[None]])
    return left[ConvexHull(left).vertices]


def least_outside(normals: np.ndarray, depths: np.ndarray, cost: np.ndarray) -> np.ndarray | None:
    """The point [3] of least cost @ point with normals [k, 3] @ point + depths >= 0; None where there is none.

    A linear program of three unknowns: its answer is where three of the planes meet, so all such places are tried.
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
    """Root mean square over colors [n, 3] and channels of what the nearest mixes of the palette leave."""
    return float(np.sqrt(np.square(mixing_weights(colors, palette) @ palette - colors).mean()))


def mixing_weights(colors: np.ndarray, palette: np.ndarray) -> np.ndarray:
    """[n, M]: weights >= 0 that add up to 1 of the palette's mix nearest to each of colors [n, 3].

    Of four corners they are the barycentric ones; of more, those that the active-set method ends with: few are not 0.
    """
    rows = np.concatenate([np.asarray(palette, np.float64).T, np.full((1, len(palette)), SUM_WEIGHT)])
    found = np.stack([nnls(rows, np.append(color, SUM_WEIGHT))[0] for color in np.asarray(colors, np.float64)])
    return found / found.sum(1, keepdims=True)


def _table(colors: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[32, 32, 32, M]: weights [n, M] of bins that hold colors [n, 3]; others have those of the nearest such bin."""
    table = np.zeros((SIDE, SIDE, SIDE, weights.shape[1]), np.float32)
    held = np.zeros((SIDE,) * 3, bool)
    place = tuple(bins_of(colors, FINE).T)
    table[place], held[place] = weights, True
    nearest = distance_transform_edt(~held, return_distances=False, return_indices=True)
    return table[tuple(nearest)]
