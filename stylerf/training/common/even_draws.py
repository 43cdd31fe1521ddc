"""Low-discrepancy random integers, for estimating means over pixels from few samples."""

import numpy as np

GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio


def drawn_evenly(count: int, below: int, generator: np.random.Generator, earlier: int = 0) -> np.ndarray:
    """Draw uniform integers with low discrepancy, which makes means over them less noisy than over independent draws.

    Steps of the golden ratio modulo 1 from a random start (Knuth, The Art of Computer Programming, volume 3, section
    6.4, theorem S). Any run of consecutive draws has low discrepancy, too.

    Args:
        earlier: Number of draws already made with a generator in the same state; these continue that sequence.

    Returns:
        [count] int64, 0 to below - 1.
    """
    start = generator.integers(0, 1 << 64, dtype=np.uint64)
    numbers = np.arange(earlier, earlier + count, dtype=np.uint64)
    fractions = (numbers * GOLDEN + start) >> np.uint64(11)  # 53 bits, exact in a float64
    return (fractions.astype(np.float64) * (below / (1 << 53))).astype(np.int64)
