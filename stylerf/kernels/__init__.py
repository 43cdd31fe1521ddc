"""The hot steps, each behind one signature with an exact backward.

`cpu` holds the numba kernels, `oracle` the same mathematics in plain torch for any dtype. Compiled kernels are cached
where the user can write, so that only the first run on a machine compiles: a read-only install and a container too.
"""

import hashlib
import os
from pathlib import Path


def kernel_cache_dir() -> Path:
    """Folder of compiled kernels: $NUMBA_CACHE_DIR, else in $STYLERF_CACHE/kernels, else in the user's cache folder."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given)
    root = os.environ.get("STYLERF_CACHE")
    if root:
        return Path(root) / "kernels" / _sources_digest()
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "stylerf" / "kernels" / _sources_digest()


def _sources_digest() -> str:
    """Name for what all kernels are compiled from.

    numba looks at the age of a kernel's own file only: one that inlines another file's function would be taken from the
    cache after that other file has changed.
    """
    digest = hashlib.sha256()
    for source in sorted((Path(__file__).parent / "cpu").glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


# numba reads this once, at its import; every kernel module is imported through this package.
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_cache_dir()))
