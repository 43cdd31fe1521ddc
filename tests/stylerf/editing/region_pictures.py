"""Views of a flat region of four plain colors under a shade, as extraction would give them."""

import numpy as np

from stylerf.editing.extraction import EditView

PLAIN = np.array([[0.85, 0.15, 0.1], [0.1, 0.6, 0.2], [0.15, 0.2, 0.8], [0.9, 0.85, 0.2]], np.float32)


def view_of(number: int, side: int = 48, shade: float = 0.12, width: int = 60) -> EditView:
    """A disc on the plane z = 0.4 of the cube, its quarters colored; each view sees it moved a little.

    The picture is `width` pixels wide with the disc from column 6 on, whatever `side` the disc has.
    """
    moved = np.random.default_rng(number).uniform(-0.02, 0.02, 2)
    rows, columns = np.divmod(np.arange(side * side), side)
    place = (np.stack([rows, columns], 1) + 0.5) / side
    inside = np.square(place - 0.5).sum(1) < 0.23
    seen = np.clip(place + moved, 0, 1)[inside]
    quarter = (seen[:, 0] > 0.5) * 2 + (seen[:, 1] > 0.5)
    lit = 1 - shade + shade * np.sin(8 * seen[:, 0] + 2 * seen[:, 1])
    count = len(seen)
    directions = np.tile(np.float32([0, 0, -1]), (count, 1))
    return EditView(
        number,
        max(width, side + 6),
        side,
        (rows * max(width, side + 6) + columns + 6)[inside],
        np.column_stack([0.3 + 0.2 * seen, np.full(count, 0.4)]).astype(np.float32),
        (1e-3 * directions).astype(np.float32),
        directions,
        (PLAIN[quarter] * lit[:, None]).astype(np.float32),
        *(np.ones(count, np.float32),) * 4,
        np.zeros(count, np.float32),
        np.zeros((count, 2), np.float32),
    )


def tiny_view(colors=None, edges=None, transition=None) -> EditView:
    """Two rows and three columns of a picture of 4x3 pixels, from column 1 of row 1 on."""
    zeros = np.zeros(6, np.float32)
    return EditView(
        0,
        4,
        3,
        np.array([5, 6, 7, 9, 10, 11]),
        np.zeros((6, 3), np.float32),
        np.zeros((6, 3), np.float32),
        np.tile(np.float32([0, 0, 1]), (6, 1)),
        np.zeros((6, 3), np.float32) if colors is None else np.asarray(colors, np.float32),
        *(zeros + 1,) * 4,
        zeros if transition is None else np.asarray(transition, np.float32),
        np.zeros((6, 2), np.float32) if edges is None else np.asarray(edges, np.float32),
    )
