"""Takes away, in this process, what Windows does not have, so that tests can run the code that does without.

The third-party libraries are imported before that: they have builds of their own for each system.
"""

import os
import signal
import sys
from types import SimpleNamespace

MODULES = ("fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "posix_ipc", "syslog")
FUNCTIONS = (
    "fchdir", "fchmod", "fchown", "fork", "forkpty", "getegid", "geteuid", "getgid", "getuid", "killpg", "mkfifo",
    "mknod", "posix_fadvise", "posix_fallocate", "pread", "pwrite", "sched_getaffinity", "setsid", "setuid", "sysconf",
    "uname",
)  # fmt: skip
FLAGS = ("O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK", "O_PATH")
SIGNALS = ("SIGALRM", "SIGHUP", "SIGKILL", "SIGQUIT", "SIGSTOP", "SIGUSR1", "SIGUSR2")
SMALL = ("filelock", "numpy")
LIBRARIES = (
    *SMALL, "scipy.ndimage", "torch", "numba", "skimage", "matplotlib", "PIL.Image", "h5py", "OpenEXR", "OpenImageIO",
    "pycolmap", "av", "safetensors.numpy", "multiprocessing",
)  # fmt: skip


def without_posix(libraries: tuple[str, ...]) -> None:
    """Removes modules, functions and flags; psutil is there, as on Windows, and tells fixed amounts of memory."""
    for name in libraries:
        try:
            __import__(name)
        except ImportError:
            continue
    for name in MODULES:
        sys.modules[name] = None
    needed_by_shutil = {name: getattr(os, name) for name in ("O_DIRECTORY", "O_NONBLOCK")}  # here; not on Windows
    for owner, names in ((os, (*FUNCTIONS, *FLAGS)), (signal, SIGNALS)):
        for name in names:
            if hasattr(owner, name):
                delattr(owner, name)
    import schemas.open_flags  # noqa: F401 - as it is without the flags

    for name, value in needed_by_shutil.items():
        setattr(os, name, value)
    used = SimpleNamespace(rss=300_000_000, peak_wset=400_000_000)
    sys.modules["psutil"] = SimpleNamespace(
        Process=lambda: SimpleNamespace(memory_info=lambda: used),
        virtual_memory=lambda: SimpleNamespace(available=8_000_000_000),
    )
