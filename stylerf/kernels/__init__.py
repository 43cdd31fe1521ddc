"""The hot steps, each behind one signature with an exact backward.

`cpu` holds the numba kernels, `oracle` the same mathematics in plain torch for any dtype. Compiled kernels are cached
where the user can write, so that only the first run on a machine compiles: a read-only install and a container too.
"""

import atexit
import hashlib
import os
import re
import shutil
import tempfile
from pathlib import Path

from llvmlite import binding

_NAME = re.compile(r"[0-9a-f]{12}-[^/]+-[0-9a-f]{8}")


def kernel_cache_dir() -> Path:
    """Folder of compiled kernels, one for each state of their sources and each kind of processor.

    It lies in $NUMBA_CACHE_DIR, else in $STYLERF_CACHE/kernels, else in the user's cache folder.
    """
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        folder = Path(given)
        # A child process inherits the whole path.
        return (folder.parent if _NAME.fullmatch(folder.name) else folder) / _name()
    if root := os.environ.get("STYLERF_CACHE"):
        return Path(root) / "kernels" / _name()
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "stylerf" / "kernels" / _name()


def _name() -> str:
    """For what all kernels are compiled from and for.

    numba looks at the age of a kernel's own file only: one that inlines another file's function would be taken from the
    cache after that other file has changed. Unlike processors that share a home would overwrite each other's index.
    """
    digest = hashlib.sha256()
    for source in sorted((Path(__file__).parent / "cpu").glob("*.py")):
        digest.update(source.read_bytes())
    features = hashlib.sha256(binding.get_host_cpu_features().flatten().encode())
    return f"{digest.hexdigest()[:12]}-{binding.get_host_cpu_name()}-{features.hexdigest()[:8]}"


def _prepared(folder: Path) -> tuple[Path, Path | None]:
    """The folder, made; and None. Where it cannot be written, one that goes with this process; and the folder."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder, None
    except OSError:
        # Of this process alone: what lies in a cache is executed, and a folder of a known name could be anyone's.
        root, maker = tempfile.mkdtemp(prefix="stylerf-kernels-"), os.getpid()
        atexit.register(lambda: shutil.rmtree(root, ignore_errors=True) if os.getpid() == maker else None)
        return Path(root) / folder.name, folder


# numba reads this once, at its import; every kernel module is imported through this package. unwritable: the folder in
# which compiled kernels would have been kept, where that cannot be.
_folder, unwritable = _prepared(kernel_cache_dir())
os.environ["NUMBA_CACHE_DIR"] = str(_folder)
# Triton's lie beside them, unless the user has set them another place; it names them by all that they are made of.
if not any(os.environ.get(name) for name in ("TRITON_CACHE_DIR", "TRITON_HOME")):
    os.environ["TRITON_CACHE_DIR"] = str(_folder.parent / "triton")
