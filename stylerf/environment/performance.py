"""Process settings that speed up the feature extractor on the CPU (see style/cpu_convolution.py)."""

import ctypes
import os

MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1  # of glibc's mallopt
LARGEST = 1 << 28  # bytes


def wait_passively() -> None:
    """Have OpenMP's threads sleep between parallel loops; to be called before torch is imported.

    By default they spin for some milliseconds, on the cores that the threads of NNPACK's convolutions need by then.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")


def keep_freed_pages() -> bool:
    """Have glibc keep freed blocks of up to LARGEST bytes for the next request; return whether it will.

    By default it returns blocks of more than 32 MB to the system at once, and each new one is paid for page by page.
    The first feature maps of a 504x378 image are that large. Other C libraries stay as they are.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(set_option(MMAP_THRESHOLD, LARGEST) and set_option(TRIM_THRESHOLD, 2 * LARGEST))
