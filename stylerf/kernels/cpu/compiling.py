"""How every CPU kernel is compiled."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numba

# Everything that fast-math allows but the assumption about infinities in comparisons: reassociation is what lets sums
# over ranks use the vector unit; the order is fixed at compile time, so results stay reproducible.
FAST = {"reassoc", "nnan", "ninf", "nsz", "arcp", "contract", "afn"}

parallel_kernel = numba.njit(parallel=True, fastmath=FAST, cache=True, nogil=True)
serial_kernel = numba.njit(fastmath=FAST, cache=True, nogil=True)
inline = numba.njit(inline="always", fastmath=FAST)


def set_threads(threads: int) -> int:
    """Use `threads` cores (clamped to what the machine has) and return how many are used."""
    used = max(1, min(int(threads), numba.config.NUMBA_NUM_THREADS))
    numba.set_num_threads(used)
    return used


def compiled_here() -> bool:
    """Whether compiled kernels of an earlier run lie in the cache folder."""
    folder = Path(numba.config.CACHE_DIR or "")
    return folder.is_dir() and next(folder.glob("**/*.nbi"), None) is not None


@contextmanager
def compiling_note(say: Callable[[str], None]) -> Iterator[None]:
    """Tell once, before a first compile, what the machine will be busy with."""
    if not compiled_here():
        say("compiling the kernels for this processor, once: about half a minute")
    yield
