"""How the procedural scene is compiled: once, cached on disk, and quickly, since a user waits for it.

`compiled` is a kernel function called by kernels only: leaving out its wrappers for Python and C takes a tenth off the
compilation. `released` is one called from Python, during which other Python threads run.
Infinities and NaN must not occur in any of them (fast-math).
"""

import stylerf.kernels  # noqa: F401, I001 - before numba, which looks once for where compiled kernels are kept
import numba

FAST = {"reassoc", "nnan", "ninf", "nsz", "arcp", "contract", "afn"}

compiled = numba.njit(cache=True, fastmath=FAST, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
released = numba.njit(cache=True, fastmath=FAST, error_model="numpy", nogil=True)
