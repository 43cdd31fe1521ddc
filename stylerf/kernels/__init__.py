"""Compute kernels with exact, hand-written backwards: `cpu` holds the numba kernels, `gpu` the Triton ones.

Compiled kernels are cached where the user can write, so that only the first run on a machine compiles, also with a
read-only install or in a container. Kernels in a folder that somebody else could have written to are not executed.
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
    """Return the folder of compiled kernels: one per state of their sources, kind of processor and user.

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
    """Return a name that identifies all that the kernels are compiled from and for.

    numba checks the age of a kernel's own file only, and would take a kernel from the cache although another file,
    whose function it inlines, has changed. Different processors that share a home folder would overwrite each other's
    index, and users who share a folder must not execute each other's kernels.
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
            parent.mkdir(mode=0o755, exist_ok=True)  # whatever the umask would let a group do
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


# numba reads this once, at its import, and every kernel module is imported through this package. not_kept and
# triton_not_kept say why compiled kernels are lost with this process, or are None.
_folder = kernel_cache_dir()
if not_kept := refusal(_folder):
    _folder = _private() / _folder.name
os.environ["NUMBA_CACHE_DIR"] = str(_folder)
# Triton's cache is beside numba's unless the user has chosen another place; Triton hashes all sources by itself.
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
# numba would read .numba_config.yaml from the current folder, at its import and again before it compiles; that file may
# be a stranger's.
with current_folder(Path(__file__).parent):
    import numba.core.config
numba.core.config._config_fname = ""
