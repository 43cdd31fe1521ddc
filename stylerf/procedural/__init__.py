"""Procedural scenes and paintings with known ground truth.

Kernels are compiled once and cached on disk. `compiled` is for functions that are only called by kernels: without
wrappers for Python and C, they compile 10 % faster. `released` is for functions called from Python; they release the
GIL. Infinities and NaN must not occur (fast-math).
"""

import stylerf.kernels  # noqa: F401, I001 - before numba, which reads its cache folder on import
import numba

FAST = {"reassoc", "nnan", "ninf", "nsz", "arcp", "contract", "afn"}

compiled = numba.njit(cache=True, fastmath=FAST, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
released = numba.njit(cache=True, fastmath=FAST, error_model="numpy", nogil=True)
