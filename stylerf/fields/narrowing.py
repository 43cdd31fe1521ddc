"""Fewer ranks for what a vector-matrix field already holds: what the ranks left out held is lost, and learnt anew.

Only what lies where the occupancy grid sees density counts: elsewhere the factors are whatever the first noise was.
"""

import numpy as np

from stylerf.fields.occupancy import Occupancy

EMPTY = 1e-3  # weight of a texel that no occupied cell projects to
_AXES = ((1, 2), (2, 0), (0, 1))


def texel_weights(occupancy: Occupancy, size: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
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

    plane [n, old], line [k, old]; weights ([n], [k]). Returns plane [n, rank] and line [k, rank], shared out evenly.
    """
    plane_q, plane_r = np.linalg.qr((plane * weights[0][:, None]).astype(np.float64))
    line_q, line_r = np.linalg.qr((line * weights[1][:, None]).astype(np.float64))
    left, strengths, right = np.linalg.svd(plane_r @ line_r.T)
    there = min(rank, len(strengths))  # a grid of fewer vertices has no more
    root = np.sqrt(strengths[:there])
    new_plane, new_line = np.zeros((len(plane), rank)), np.zeros((len(line), rank))
    new_plane[:, :there] = plane_q @ (left[:, :there] * root) / weights[0][:, None]
    new_line[:, :there] = line_q @ (right[:there].T * root) / weights[1][:, None]
    return new_plane.astype(np.float32), new_line.astype(np.float32)


def telling_ranks(plane: np.ndarray, line: np.ndarray, weights: tuple, head: np.ndarray, rank: int) -> np.ndarray:
    """The `rank` ranks, in order, whose products the colour head makes most of. head [outputs, old]."""
    strength = np.linalg.norm(plane * weights[0][:, None], axis=0) * np.linalg.norm(line * weights[1][:, None], axis=0)
    return np.sort(np.argsort(-strength * np.linalg.norm(head, axis=0))[:rank])
