"""Fewer ranks for what a vector-matrix field already holds: as near to it as so few can be; the rest is learned anew.

Only what lies where the occupancy grid sees density counts: elsewhere the factors are whatever the first noise was.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from stylerf.fields.occupancy_grid import OccupancyGrid

EMPTY = 1e-3  # weight of a texel that no occupied cell projects to
SWEEPS = 100  # of alternating least squares: what more of them win is under a hundredth of a dB
_AXES = ((1, 2), (2, 0), (0, 1))


def texel_weights(occupancy: OccupancyGrid, size: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """For m = 0, 1, 2: weights of plane m's texels, flat [size[a] * size[b]], and of line m's, [size[m]].

    A texel weighs the square root of the share of cells along its column that are occupied, EMPTY at least.
    """
    occupied = (occupancy.distances.reshape((occupancy.cells,) * 3) == 0).astype(np.float32)
    weights = []
    for m, (a, b) in enumerate(_AXES):
        plane = occupied.mean(m) if a < b else occupied.mean(m).T
        line = occupied.mean((a, b))
        plane = plane[np.ix_(_cells_of(size[a], occupancy.cells), _cells_of(size[b], occupancy.cells))]
        weights.append(
            tuple(np.sqrt(np.maximum(w, EMPTY**2)).ravel() for w in (plane, line[_cells_of(size[m], occupancy.cells)]))
        )
    return weights


def _cells_of(vertices: int, cells: int) -> np.ndarray:
    """The occupancy cell that each of `vertices` lies in."""
    return np.minimum(np.linspace(0, cells, int(vertices)).astype(np.int64), cells - 1)


def best_ranks(plane: np.ndarray, line: np.ndarray, weights: tuple, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """The `rank` products whose sum is nearest to the sum of all (Eckart & Young 1936), in weighted squares.

    plane [n, old], line [k, old]; weights ([n], [k]). Returns plane [n, rank] and line [k, rank], as large as before.
    """
    (plane_q, plane_r), (line_q, line_r) = _orthogonal(plane, weights[0]), _orthogonal(line, weights[1])
    left, strengths, right = np.linalg.svd(plane_r @ line_r.T)
    there = min(rank, len(strengths))  # a grid of fewer vertices has no more
    factors = _shared_out([left[:, :there] * strengths[:there], right[:there].T], [plane_r, line_r])
    new_plane, new_line = np.zeros((len(plane), rank)), np.zeros((len(line), rank))
    new_plane[:, :there] = plane_q @ factors[0] / weights[0][:, None]
    new_line[:, :there] = line_q @ factors[1] / weights[1][:, None]
    return new_plane.astype(np.float32), new_line.astype(np.float32)


def best_seen_ranks(
    plane: np.ndarray, line: np.ndarray, weights: tuple, head: np.ndarray, rank: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`rank` products that look nearest to all of them through a linear color head, in weighted squares.

    plane [n, old], line [k, old], head [outputs, old]; weights ([n], [k]). Returns the three with `rank` columns, each
    about as large as before. The sum of plane x line x head is a tensor of `old` terms; the nearest of fewer is sought
    by alternating least squares (Kolda & Bader 2009, fig. 3.3) from `rank` of those terms. QR decompositions first: the
    tensor that is worked on has no more than old^3 elements, whatever the grid.
    """
    ones = np.ones(len(head))
    bases, cores = zip(*(_orthogonal(f, w) for f, w in zip((plane, line, head), (*weights, ones))))
    terms = np.einsum("ar,br,cr->abcr", *cores, optimize=True)
    tensor = terms.sum(-1)
    # One after another the term of which most is left beside those before it: none says what another says already.
    kept = qr(terms.reshape(-1, terms.shape[-1]), mode="r", pivoting=True)[1][:rank]
    factors = [core[:, kept] for core in cores]
    for _ in range(SWEEPS):
        for axis in range(3):
            first, second = (factors[other] for other in range(3) if other != axis)
            along = np.moveaxis(tensor, axis, 0)
            wanted = np.einsum("abc,br,cr->ar", along, first, second, optimize=True)
            factors[axis] = wanted @ np.linalg.pinv((first.T @ first) * (second.T @ second), rcond=1e-10)
        factors = _shared_out(factors, cores)
    found = [basis @ factor / w[:, None] for basis, factor, w in zip(bases, factors, (*weights, ones))]
    return tuple(factor.astype(np.float32) for factor in found)


def _orthogonal(factor: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """QR decomposition of a factor [n, rank], its rows weighted."""
    return np.linalg.qr((factor * weights[:, None]).astype(np.float64))


def _shared_out(factors: list[np.ndarray], like: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The same products, the columns' lengths in the proportions that those of `like` have on the whole.

    An optimizer whose steps are of one size moves what is small too fast and what is large too slowly.
    """
    lengths = [np.linalg.norm(factor, axis=0) + 1e-30 for factor in factors]
    usual = [np.sqrt(np.square(core).sum(0).mean()) + 1e-30 for core in like]
    scale = np.prod([length / one for length, one in zip(lengths, usual)], axis=0) ** (1 / len(factors))
    return [factor / length * one * scale for factor, length, one in zip(factors, lengths, usual)]
