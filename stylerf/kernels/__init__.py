"""The hot steps, each behind one signature with an exact backward.

`cpu` holds the numba kernels, `oracle` the same mathematics in plain torch for any dtype. Compiled kernels are cached
where the user can write, so that only the first run on a machine compiles: a read-only install and a container too.
"""

import os
from pathlib import Path


def kernel_cache_dir() -> Path:
    """Folder of compiled kernels: $NUMBA_CACHE_DIR, else $STYLERF_CACHE/kernels, else the user's cache folder."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given)
    root = os.environ.get("STYLERF_CACHE")
    if root:
        return Path(root) / "kernels"
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "stylerf" / "kernels"


# numba reads this once, at its import; every kernel module is imported through this package.
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_cache_dir()))
