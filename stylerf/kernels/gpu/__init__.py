"""Triton kernels: the same algorithms as in `cpu`, on tensors that stay on the device.

Imported lazily: torch's CUDA build includes Triton, but its CPU build does not. Gradients are accumulated atomically,
so runs agree up to rounding but are not bit-identical. With TRITON_INTERPRET=1, the kernels run slowly on CPU tensors,
which is how they are tested without a GPU.
"""

import importlib.util
import os
import shutil
import sysconfig
from pathlib import Path


def interpreted() -> bool:
    """Whether kernels run through Triton's interpreter instead of being compiled."""
    return os.environ.get("TRITON_INTERPRET", "0") == "1"


def unavailable() -> str | None:
    """Return why the kernels of this package cannot run here, as a single line, or None if they can."""
    if importlib.util.find_spec("triton") is None:
        return "Triton is not installed; the CUDA build of torch brings it (pip install triton adds it to another)"
    if interpreted():
        return None
    import torch

    if not torch.cuda.is_available():
        return "torch finds no GPU that CUDA can use"
    if why := _cannot_launch():
        return why
    if torch.version.hip:
        return None
    major, minor = torch.cuda.get_device_capability()
    # Triton compiles for Volta too, but 64-bit and vector atomics are only tested from Ampere on.
    return None if major >= 8 else f"compute capability {major}.{minor}; 8.0 (Ampere) or newer is needed"


def _cannot_launch() -> str | None:
    """Return what is missing to compile Triton's launcher, a small C extension for this Python, or None."""
    if not (os.environ.get("CC") or shutil.which("gcc") or shutil.which("clang")):
        return "Triton finds no C compiler; install gcc, or set CC to one"
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    return None if header.is_file() else f"Triton needs {header}; install Python's headers (python3-dev)"
