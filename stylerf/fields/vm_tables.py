"""The table of a vector-matrix field, its planes and lines in one flat array: creation, resizing, more ranks."""

import numpy as np

from stylerf import validation

MOST_VERTICES, MOST_RANK = 1 << 16, 64  # along an axis; a kernel is compiled for each rank
_AXES = ((1, 2), (2, 0), (0, 1))


def grid_of(data: dict) -> tuple[np.ndarray, int]:
    """Return size [3] and rank from the JSON form of a part, each checked against its bounds."""
    size = validation.integers(data, "size", 3, 2, MOST_VERTICES)
    return np.array(size, np.int64), validation.integer(data, "rank", 1, MOST_RANK)


def table_length(size: np.ndarray, rank: int) -> int:
    """Return the number of floats in the planes and lines."""
    planes = sum(int(size[a]) * int(size[b]) for a, b in _AXES)
    return (planes + int(size.sum())) * rank


def split_table(table: np.ndarray, size: np.ndarray, rank: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return views of the table: planes [size[a], size[b], rank] and lines [size[m], rank]."""
    planes, lines, at = [], [], 0
    for a, b in _AXES:
        n = int(size[a] * size[b] * rank)
        planes.append(table[at : at + n].reshape(int(size[a]), int(size[b]), rank))
        at += n
    for m in range(3):
        n = int(size[m] * rank)
        lines.append(table[at : at + n].reshape(int(size[m]), rank))
        at += n
    return planes, lines


def initial_table(size: np.ndarray, rank: int, generator: np.random.Generator, spread: float) -> np.ndarray:
    table = np.empty(table_length(size, rank), np.float32)
    planes, lines = split_table(table, size, rank)
    for plane in planes:
        plane[:] = generator.normal(scale=spread, size=plane.shape)
    for line in lines:
        line[:] = generator.normal(scale=spread, size=line.shape) + 0.3
    return table


def widened_table(
    table: np.ndarray, size: np.ndarray, old: int, new: int, generator: np.random.Generator
) -> np.ndarray:
    """Add ranks: new planes are random, new lines zero, so that the function is unchanged."""
    out = initial_table(np.asarray(size), new, generator, 0.1)
    for source, target in zip(split_table(table, size, old)[0], split_table(out, size, new)[0]):
        target[..., :old] = source
    for source, target in zip(split_table(table, size, old)[1], split_table(out, size, new)[1]):
        target[..., :old] = source
        target[..., old:] = 0
    return out


def resized_table(table: np.ndarray, old: np.ndarray, new: np.ndarray, rank: int) -> np.ndarray:
    """Resample planes and lines to another grid: by interpolation if it is finer, else by least squares."""
    out = np.empty(table_length(new, rank), np.float32)
    onto = [_onto(int(before), int(after)) for before, after in zip(old, new)]
    for m, (source, target) in enumerate(zip(split_table(table, old, rank)[0], split_table(out, new, rank)[0])):
        a, b = _AXES[m]
        along = onto[a] @ source.reshape(int(old[a]), -1)
        along = along.reshape(-1, int(old[b]), rank)
        target[:] = np.einsum("nb,abr->anr", onto[b], along, optimize=True)
    for m, (source, target) in enumerate(zip(split_table(table, old, rank)[1], split_table(out, new, rank)[1])):
        target[:] = onto[m] @ source
    return out


def _onto(old: int, new: int) -> np.ndarray:
    """Return [new, old] float32, the map from values on `old` vertices to the closest ones on `new`."""
    if new >= old:
        return _interpolation(new, old).astype(np.float32)
    return np.linalg.pinv(_interpolation(old, new)).astype(np.float32)


def _interpolation(at: int, vertices: int) -> np.ndarray:
    """Return [at, vertices], linear interpolation of evenly spaced vertices at `at` even positions, ends included."""
    place = np.linspace(0, vertices - 1, at)
    first = np.minimum(place.astype(np.int64), vertices - 2)
    matrix = np.zeros((at, vertices))
    matrix[np.arange(at), first] = 1 - (place - first)
    matrix[np.arange(at), first + 1] += place - first
    return matrix
