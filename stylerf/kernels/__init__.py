"""The hot steps, each behind one signature with an exact backward.

`cpu` holds the numba kernels, `oracle` the same mathematics in plain torch for any dtype. Compiled kernels are cached
where the user can write, so that only the first run on a machine compiles: a read-only install and a container too.
Those in a folder that somebody else could have written to are not executed.
"""

import atexit
import hashlib
import os
import re
import shutil
import tempfile
from pathlib import Path

from llvmlite import binding

from stylerf.environment.current_folder import current_folder
from stylerf.environment.trusted_paths import not_ours, user_id

_NAME = re.compile(r"[0-9a-f]{12}-[^/]+-[0-9a-f]{8}-[0-9]+")


def kernel_cache_dir() -> Path:
    """Folder of compiled kernels, one for each state of their sources, each kind of processor and each user.

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
    cache after that other file has changed. Unlike processors that share a home would overwrite each other's index;
    users who share a folder would not execute each other's kernels.
    """
    digest = hashlib.sha256()
    for source in sorted((Path(__file__).parent / "cpu").glob("*.py")):
        digest.update(source.read_bytes())
    features = hashlib.sha256(binding.get_host_cpu_features().flatten().encode())
    return f"{digest.hexdigest()[:12]}-{binding.get_host_cpu_name()}-{features.hexdigest()[:8]}-{user_id()}"


def refusal(folder: Path) -> str | None:
    """Why compiled kernels cannot be kept in `folder`, which is made where it is missing; None where they can."""
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
    """A new folder that goes with this process."""
    folder, maker = tempfile.mkdtemp(prefix="stylerf-kernels-"), os.getpid()
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == maker else None)
    return Path(folder)


# numba reads this once, at its import; every kernel module is imported through this package. not_kept, triton_not_kept:
# why compiled kernels go with this process, None where they stay.
_folder = kernel_cache_dir()
if not_kept := refusal(_folder):
    _folder = _private() / _folder.name
os.environ["NUMBA_CACHE_DIR"] = str(_folder)
# Triton's lie beside them, unless the user has set them another place; it names them by all that they are made of.
if given := os.environ.get("TRITON_CACHE_DIR"):
    _triton = Path(given)
elif given := os.environ.get("TRITON_HOME"):
    _triton = Path(given) / ".triton" / "cache"
else:
    _triton = _folder.parent / f"triton-{user_id()}"
    os.environ["TRITON_CACHE_DIR"] = str(_triton)
triton_not_kept = refusal(_triton) if _triton.exists() or not given else None
if triton_not_kept:
    os.environ["TRITON_CACHE_DIR"] = str(_private() / "triton")
# numba reads .numba_config.yaml in the current folder, at its import and again before it compiles.
with current_folder(Path(__file__).parent):
    import numba.core.config
numba.core.config._config_fname = ""
