"""Rank truncation of vector-matrix fields: the best approximation with fewer ranks, for further training.

Only occupied space counts; elsewhere the factors still hold their initial noise (decision 0038).
"""

from collections.abc import Sequence

import numpy as np

from stylerf.fields.occupancy_grid import OccupancyGrid

EMPTY = 1e-3  # weight of a texel that no occupied cell projects to; nonzero, to keep the weighted problem regular
SWEEPS = 100  # of alternating least squares; more would gain less than 0.01 dB
_AXES = ((1, 2), (2, 0), (0, 1))


def texel_weights(occupancy: OccupancyGrid | None, size: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return, for m = 0, 1, 2, the weights of plane m's texels, flat [size[a] * size[b]], and of line m's, [size[m]].

    A texel's weight is the square root of the occupied fraction of the cells that project to it, at least EMPTY.
    Without an occupancy, all weights are 1.
    """
    if occupancy is None:
        return [(np.ones(size[a] * size[b]), np.ones(size[m])) for m, (a, b) in enumerate(_AXES)]
    occupied = (occupancy.distances.reshape((occupancy.cells,) * 3) == 0).astype(np.float32)
    weights = []
    for m, (a, b) in enumerate(_AXES):
        plane = occupied.mean(m) if a < b else occupied.mean(m).T  # plane 1 has axes (2, 0); the mean's axes ascend
        line = occupied.mean((a, b))
        plane = plane[np.ix_(_cells_of(size[a], occupancy.cells), _cells_of(size[b], occupancy.cells))]
        weights.append(
            tuple(np.sqrt(np.maximum(w, EMPTY**2)).ravel() for w in (plane, line[_cells_of(size[m], occupancy.cells)]))
        )
    return weights


def _cells_of(vertices: int, cells: int) -> np.ndarray:
    """Return the index of the occupancy cell that contains each of `vertices`."""
    return np.minimum(np.linspace(0, cells, int(vertices)).astype(np.int64), cells - 1)


def best_ranks(plane: np.ndarray, line: np.ndarray, weights: tuple, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the `rank` products whose sum best approximates the sum of all, in weighted squares (Eckart & Young 1936).

    Args:
        plane: [n, old]. line: [k, old]. weights: ([n], [k]).

    Returns:
        plane [n, rank] and line [k, rank], with about the same magnitudes as before.
    """
    (plane_q, plane_r), (line_q, line_r) = _orthogonal(plane, weights[0]), _orthogonal(line, weights[1])
    # plane line^T = Q_p (R_p R_l^T) Q_l^T: only the middle factor, [old, old], needs an SVD.
    left, strengths, right = np.linalg.svd(plane_r @ line_r.T)
    there = min(rank, len(strengths))  # a grid with fewer vertices has a lower rank
    factors = _shared_out([left[:, :there] * strengths[:there], right[:there].T], [plane_r, line_r])
    new_plane, new_line = np.zeros((len(plane), rank)), np.zeros((len(line), rank))
    new_plane[:, :there] = plane_q @ factors[0] / weights[0][:, None]
    new_line[:, :there] = line_q @ factors[1] / weights[1][:, None]
    return new_plane.astype(np.float32), new_line.astype(np.float32)


def best_seen_ranks(
    plane: np.ndarray, line: np.ndarray, weights: tuple, head: np.ndarray, rank: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the `rank` products that best approximate all of them as seen through a linear color head.

    The sum of plane x line x head is a tensor of `old` terms. Its best approximation with `rank` terms, in weighted
    squares, is found by alternating least squares (Kolda & Bader 2009, fig. 3.3), starting from `rank` of those terms.
    QR decompositions come first, so that the tensor has at most old^3 elements for any grid.

    Args:
        plane: [n, old]. line: [k, old]. head: [outputs, old]. weights: ([n], [k]).

    Returns:
        plane, line and head with `rank` columns, with about the same magnitudes as before.
    """
    from scipy.linalg import qr

    ones = np.ones(len(head))
    bases, cores = zip(*(_orthogonal(f, w) for f, w in zip((plane, line, head), (*weights, ones))))
    terms = np.einsum("ar,br,cr->abcr", *cores, optimize=True)
    tensor = terms.sum(-1)
    # Pivoting repeatedly picks the term with the largest residual to those before it, so no two start alike.
    kept = qr(terms.reshape(-1, terms.shape[-1]), mode="r", pivoting=True)[1][:rank]
    factors = [core[:, kept] for core in cores]
    for _ in range(SWEEPS):
        for axis in range(3):
            first, second = (factors[other] for other in range(3) if other != axis)
            along = np.moveaxis(tensor, axis, 0)
            wanted = np.einsum("abc,br,cr->ar", along, first, second, optimize=True)
            # Normal equations: the Gram matrix of a Khatri-Rao product is the elementwise product of the factors' own.
            factors[axis] = wanted @ np.linalg.pinv((first.T @ first) * (second.T @ second), rcond=1e-10)
        factors = _shared_out(factors, cores)
    found = [basis @ factor / w[:, None] for basis, factor, w in zip(bases, factors, (*weights, ones))]
    return tuple(factor.astype(np.float32) for factor in found)


def _orthogonal(factor: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the QR decomposition of a factor [n, rank] with weighted rows."""
    return np.linalg.qr((factor * weights[:, None]).astype(np.float64))


def _shared_out(factors: list[np.ndarray], like: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Rescale the columns, preserving the products, to the average relative magnitudes of the factors in `like`.

    Adam's steps all have the same size: a factor that is too small would change too fast, a large one too slowly.
    """
    lengths = [np.linalg.norm(factor, axis=0) + 1e-30 for factor in factors]
    usual = [np.sqrt(np.square(core).sum(0).mean()) + 1e-30 for core in like]
    scale = np.prod([length / one for length, one in zip(lengths, usual)], axis=0) ** (1 / len(factors))
    return [factor / length * one * scale for factor, length, one in zip(factors, lengths, usual)]
