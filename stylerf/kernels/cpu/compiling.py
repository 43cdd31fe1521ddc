"""How every CPU kernel is compiled."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numba

from stylerf.kernels import not_kept

# No fast-math: what a compiler may reorder it reorders differently when it compiles a kernel and when it links one from
# the cache, and a fit would not repeat to the bit. Division by zero gives what numpy gives.
parallel_kernel = numba.njit(parallel=True, error_model="numpy", cache=True, nogil=True)
serial_kernel = numba.njit(error_model="numpy", cache=True, nogil=True)
# Inlined by LLVM: numba's own inliner types the whole caller anew for each call, four times the time of a compile.
inline = numba.njit(forceinline=True, error_model="numpy")


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
    if not compiled_here() and not_kept:
        say(
            f"compiling the kernels for this run alone, a minute or two: {not_kept}; set STYLERF_CACHE to a folder "
            "that you alone may write to"
        )
    elif not compiled_here():
        say("compiling the kernels for this processor, once: a minute or two")
    yield
