"""Compute kernels with exact, hand-written backward passes: `cpu` holds the numba kernels, `gpu` the Triton ones.

Compiled kernels are cached in a user-writable folder, so that only the first run on a machine compiles, even for a
read-only install or in a container. Kernels in a folder that other users can write to are never executed.
"""

import atexit
import hashlib
import os
import re
import shutil
import tempfile
from pathlib import Path

from llvmlite import binding

from stylerf.environment.trusted_paths import current_folder, not_ours, user_id

_NAME = re.compile(r"[0-9a-f]{12}-[^/]+-[0-9a-f]{8}-[0-9]+")


def kernel_cache_dir() -> Path:
    """Return the folder for compiled kernels, specific to the state of their sources, the processor type and the user.

    It is in $NUMBA_CACHE_DIR, else in $STYLERF_CACHE/kernels, else in the user's cache folder.
    """
    if configured := os.environ.get("NUMBA_CACHE_DIR"):
        folder = Path(configured)
        # A child process inherits the whole path.
        return (folder.parent if _NAME.fullmatch(folder.name) else folder) / _name()
    if root := os.environ.get("STYLERF_CACHE"):
        return Path(root) / "kernels" / _name()
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "stylerf" / "kernels" / _name()


def _name() -> str:
    """Return a name that identifies everything that the kernels are compiled from and for.

    numba checks only the age of a kernel's own file, and would load a stale kernel if another file changes whose
    functions it inlines. Different processors with a shared home folder would overwrite each other's index, and users
    with a shared folder must not execute each other's kernels.
    """
    digest = hashlib.sha256()
    for source in sorted((Path(__file__).parent / "cpu").glob("*.py")):
        digest.update(source.read_bytes())
    features = hashlib.sha256(binding.get_host_cpu_features().flatten().encode())
    return f"{digest.hexdigest()[:12]}-{binding.get_host_cpu_name()}-{features.hexdigest()[:8]}-{user_id()}"


def refusal(folder: Path) -> str | None:
    """Return why compiled kernels cannot be kept in `folder`, or None if they can; creates a missing folder."""
    try:
        for parent in reversed([one for one in folder.absolute().parents if not one.exists()]):
            parent.mkdir(mode=0o755, exist_ok=True)  # regardless of the umask
        folder.mkdir(mode=0o700, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            why = not_ours(folder)
    except OSError:
        return f"{folder} cannot be written"
    return f"{folder} {why}" if why else None


def _private() -> Path:
    """Create a folder that is removed when this process ends."""
    folder, maker = tempfile.mkdtemp(prefix="stylerf-kernels-"), os.getpid()
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == maker else None)
    return Path(folder)


# numba reads this once, when it is imported, and every kernel module is imported through this package. not_kept and
# triton_not_kept are the reasons why compiled kernels are lost when this process ends, or None.
_folder = kernel_cache_dir()
if not_kept := refusal(_folder):
    _folder = _private() / _folder.name
os.environ["NUMBA_CACHE_DIR"] = str(_folder)
# Triton's cache is next to numba's unless the user has configured another folder; Triton itself hashes all sources.
if configured := os.environ.get("TRITON_CACHE_DIR"):
    _triton = Path(configured)
elif configured := os.environ.get("TRITON_HOME"):
    _triton = Path(configured) / ".triton" / "cache"
else:
    _triton = _folder.parent / f"triton-{user_id()}"
    os.environ["TRITON_CACHE_DIR"] = str(_triton)
triton_not_kept = refusal(_triton) if _triton.exists() or not configured else None
if triton_not_kept:
    os.environ["TRITON_CACHE_DIR"] = str(_private() / "triton")
# numba would read .numba_config.yaml from the current folder, on import and again before compiling; that file may
# belong to another user.
with current_folder(Path(__file__).parent):
    import numba.core.config
numba.core.config._config_fname = ""
