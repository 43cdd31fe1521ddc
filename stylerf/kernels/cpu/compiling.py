"""How every CPU kernel is compiled."""

import numba

# Everything that fast-math allows but the assumption about infinities in comparisons: reassociation is what lets sums
# over ranks use the vector unit; the order is fixed at compile time, so results stay reproducible.
FAST = frozenset({"reassoc", "nnan", "ninf", "nsz", "arcp", "contract", "afn"})

parallel_kernel = numba.njit(parallel=True, fastmath=FAST, cache=True, nogil=True)
serial_kernel = numba.njit(fastmath=FAST, cache=True, nogil=True)
inline = numba.njit(inline="always", fastmath=FAST)


def set_threads(threads: int) -> int:
    """Use `threads` cores (clamped to what the machine has) and return how many are used."""
    used = max(1, min(int(threads), numba.config.NUMBA_NUM_THREADS))
    numba.set_num_threads(used)
    return used
