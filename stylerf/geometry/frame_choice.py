"""Which frames of a video to keep: even in motion, and the sharpest among neighbors."""

import numpy as np

# Frames are taken from this middle part of their bin, so that two neighbors are neither close nor far apart.
MIDDLE = 0.6
# A frame is blurred if its variance of the Laplacian is this many times below that of its neighbors.
BLURRED = 3.0
NEIGHBORS = 5  # bins, or frames, on either side
LONGEST_GAP = 3  # bins that may be left out in a row: a blurred frame is better than a track that breaks


def chosen_frames(motion: np.ndarray, sharpness: np.ndarray, count: int) -> tuple[np.ndarray, int]:
    """Choose at most `count` frames.

    The path is cut into `count` bins of equal motion, and the sharpest frame of each is taken. A bin that holds blurred
    frames only, compared with the bins around it, is left out.

    Args:
        motion: [n] the motion from the frame before; 0 for the first of a clip, NaN if unknown.
        sharpness: [n] as in frame_motion.sharpness.
        count: Number of bins, at least 1.

    Returns:
        The indices, increasing, and how many bins were left out as blurred.
    """
    path = positions(motion, sharpness)
    total = path[-1] if len(path) else 0.0
    if total <= 0:
        return np.arange(min(1, len(path))), 0
    places = np.minimum(path / total * count, count * (1 - 1e-12))
    bins = places.astype(np.int64)
    central = np.abs(places - bins - 0.5) <= MIDDLE / 2
    best: list[int] = []
    for number in np.unique(bins):
        inside = np.flatnonzero(bins == number)
        middle = inside[central[inside]]
        candidate = _sharpest(middle if len(middle) else inside, sharpness)
        # At the edge of a bin a frame is still better than a blurred one in its middle.
        anywhere = _sharpest(inside, sharpness)
        if sharpness[anywhere] - sharpness[candidate] > np.log(BLURRED):
            candidate = anywhere
        best.append(candidate)
    blurred = _blurred(sharpness[best])
    return np.array(best)[~blurred], int(blurred.sum())


def positions(motion: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """Return the motion [n] since the first frame.

    What is unknown counts as the median of the frames around; so does motion between a sharp frame and a blurred one,
    whose correlation peaks anywhere within the blur.
    """
    steps = np.abs(np.diff(sharpness, prepend=sharpness[:1]))
    known = np.isfinite(motion) & ((steps < np.log(BLURRED)) | (motion == 0))
    filled = motion.copy()
    for k in np.flatnonzero(~known):
        near = slice(max(0, k - NEIGHBORS), k + NEIGHBORS + 1)
        values = motion[near][known[near]]
        filled[k] = np.median(values if len(values) else motion[known]) if known.any() else 0.0
    return np.cumsum(filled)


def _sharpest(frames: np.ndarray, sharpness: np.ndarray) -> int:
    return int(frames[sharpness[frames].argmax()])


def _blurred(values: np.ndarray) -> np.ndarray:
    """Mark the bins whose best frame is blurred; runs of more than LONGEST_GAP are not marked."""
    around = [np.median(values[max(0, k - NEIGHBORS) : k + NEIGHBORS + 1]) for k in range(len(values))]
    marked = values < np.array(around) - np.log(BLURRED)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked, [0]])))
    for start, end in edges.reshape(-1, 2):
        if end - start > LONGEST_GAP:
            marked[start:end] = False
    return marked
