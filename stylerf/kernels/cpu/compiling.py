"""Compiler settings of the CPU kernels."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numba

from stylerf.kernels import not_kept

# No fast-math: reassociation differs between compiling a kernel and loading it from the cache, so fits would not be
# bit-reproducible. error_model numpy: division by zero gives infinity instead of a branch that raises.
parallel_kernel = numba.njit(parallel=True, error_model="numpy", cache=True, nogil=True)
serial_kernel = numba.njit(error_model="numpy", cache=True, nogil=True)
# Inlined by LLVM. numba's own inliner (inline="always") repeats type inference of the caller for each call: four times
# the compile time.
inline = numba.njit(forceinline=True, error_model="numpy")


def set_threads(threads: int) -> int:
    """Use `threads` threads, at most as many as the machine supports; return the number used."""
    used = max(1, min(int(threads), numba.config.NUMBA_NUM_THREADS))
    numba.set_num_threads(used)
    return used


def compiled_here() -> bool:
    """Whether the cache folder holds kernels compiled by an earlier run."""
    folder = Path(numba.config.CACHE_DIR or "")
    return folder.is_dir() and next(folder.glob("**/*.nbi"), None) is not None


@contextmanager
def compiling_note(say: Callable[[str], None]) -> Iterator[None]:
    """Announce through `say`, before the first compilation, that it will take a while."""
    if not compiled_here() and not_kept:
        say(
            f"compiling the kernels for this run alone, a minute or two: {not_kept}; set STYLERF_CACHE to a folder "
            "that you alone may write to"
        )
    elif not compiled_here():
        say("compiling the kernels for this processor, once: a minute or two")
    yield
