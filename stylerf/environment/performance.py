"""Process settings that speed up the feature extractor on the CPU (see style/cpu_convolution.py)."""

import ctypes
import os

MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1  # of glibc's mallopt
LARGEST = 1 << 28  # bytes


def wait_passively() -> None:
    """Make OpenMP threads sleep between parallel loops; call before importing torch.

    By default they spin for a few milliseconds, on cores that NNPACK's threads need at that time.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")


def keep_freed_pages() -> bool:
    """Make glibc keep freed blocks of up to LARGEST bytes for later requests; return whether it will.

    By default, it immediately returns blocks of more than 32 MB to the system, and each new one incurs page faults.
    The first feature maps of a 504x378 image are that large. Other C libraries are not changed.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(set_option(MMAP_THRESHOLD, LARGEST) and set_option(TRIM_THRESHOLD, 2 * LARGEST))
