"""Select video frames: evenly spaced in motion, and the sharpest among their neighbors.

Motion and sharpness are measured on small gray copies, which is cheap.
"""

import numpy as np

# Frames are taken from this central part of their bin, so that neighbors are neither too close nor too far apart.
MIDDLE = 0.6
# A frame is blurred if its variance of the Laplacian is this many times smaller than that of its neighbors.
BLURRED = 3.0
NEIGHBORS = 5  # bins, or frames, on either side
LONGEST_GAP = 3  # maximum number of consecutive bins to skip: a blurred frame is better than a broken track
# Longer side, in pixels, of the copies used to measure motion and sharpness: only the latter needs detail to show blur.
MOTION_SIDE, SHARPNESS_SIDE = 192, 640
WINDOW = 64
TILES = 8  # per side
# Minimum height of a reliable correlation peak, relative to that of equal images; noise alone reaches 0.15.
TRUSTED = 0.3
_BAND = 0.12  # standard deviation, cycles per pixel: noise is at high frequencies, and so is what blur removes


def chosen_frames(motion: np.ndarray, sharpness: np.ndarray, count: int) -> tuple[np.ndarray, int]:
    """Choose at most `count` frames.

    The path is divided into `count` bins of equal motion, and the sharpest frame of each is selected. Bins that contain
    only blurred frames, compared with the bins around them, are skipped.

    Args:
        motion: [n], motion since the previous frame; 0 for the first of a clip, NaN if unknown.
        sharpness: [n], from sharpness().
        count: Number of bins, at least 1.

    Returns:
        The indices, increasing, and the number of bins skipped as blurred.
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
        # A frame at the edge of a bin is still better than a blurred one in its middle.
        anywhere = _sharpest(inside, sharpness)
        if sharpness[anywhere] - sharpness[candidate] > np.log(BLURRED):
            candidate = anywhere
        best.append(candidate)
    blurred = _blurred(sharpness[best])
    return np.array(best)[~blurred], int(blurred.sum())


def positions(motion: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """Return the cumulative motion [n] since the first frame.

    Unknown motion is replaced with the median of the frames around it, as is motion between a sharp and a blurred
    frame, whose correlation may peak anywhere within the blur.
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


def motion_between(one: np.ndarray, two: np.ndarray) -> float:
    """Return the mean displacement between two frames as a fraction of the longer side.

    Half-overlapping windows are compared by phase correlation (Kuglin and Hines 1975), so that pans, rotations, zooms
    and parallax all count; windows without a clear peak are ignored.

    Args:
        one: [h, w] uint8, MOTION_SIDE on its longer side.
        two: The same shape.

    Returns:
        0 for equal frames; at most that of half a window in both directions; NaN if no window has a clear peak, as at
        a cut.
    """
    height, width = one.shape
    rows, columns = min(WINDOW, height), min(WINDOW, width)
    taper = np.outer(np.hanning(rows + 2)[1:-1], np.hanning(columns + 2)[1:-1])
    weights = np.exp(-0.5 * (np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)) / _BAND) ** 2)
    weights[0, 0] = 0
    best = np.fft.irfft2(weights, (rows, columns))[0, 0]
    found = []
    for top in _places(height, rows):
        for left in _places(width, columns):
            a, b = (frame[top : top + rows, left : left + columns].astype(np.float64) for frame in (one, two))
            if a.std() < 1 and b.std() < 1:  # a blank wall
                continue
            product = np.fft.rfft2((b - b.mean()) * taper) * np.conj(np.fft.rfft2((a - a.mean()) * taper))
            phases = product / np.maximum(np.abs(product), 1e-9)
            peak = np.fft.irfft2(phases * weights, (rows, columns))
            row, column = divmod(int(peak.argmax()), columns)
            if peak[row, column] >= TRUSTED * best:
                found.append(np.hypot(_offset(peak[:, column], row), _offset(peak[row], column)))
    return float(np.mean(found)) / max(height, width) if found else float("nan")


def _places(side: int, window: int) -> list[int]:
    count = max(1, round((side - window) / (window / 2)) + 1)
    return [int(place) for place in np.linspace(0, side - window, count)]


def _offset(line: np.ndarray, place: int) -> float:
    """Return the signed position of a cyclic line's peak, refined by a parabola through its neighbors."""
    before, here, after = line[place - 1], line[place], line[(place + 1) % len(line)]
    bend = before - 2 * here + after
    part = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return (place if place <= len(line) // 2 else place - len(line)) + part


def sharpness(gray: np.ndarray) -> float:
    """Return the sharpness of a frame: the mean over TILES x TILES tiles of log(1 + variance of the Laplacian).

    The logarithm keeps a single highlight from dominating. Comparable between frames with similar content.

    Args:
        gray: [h, w] uint8, SHARPNESS_SIDE on its longer side.
    """
    values = gray.astype(np.int16)
    if min(values.shape) < 3:
        return 0.0
    middle = values[1:-1, 1:-1]
    bends = values[:-2, 1:-1] + values[2:, 1:-1] + values[1:-1, :-2] + values[1:-1, 2:] - 4 * middle
    logs = [
        np.log1p(tile.var())
        for band in np.array_split(bends, min(TILES, bends.shape[0]), axis=0)
        for tile in np.array_split(band, min(TILES, bends.shape[1]), axis=1)
    ]
    return float(np.mean(logs))
