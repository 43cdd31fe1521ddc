"""The memory and the cores that a run may use, with the limits of control groups (versions 1 and 2).

Any group around the process may set a limit, so all are read up to the root.
"""

import math
import os
import re
from contextlib import suppress
from pathlib import Path, PurePosixPath

CGROUPS = Path("/sys/fs/cgroup")
OWN_GROUPS = Path("/proc/self/cgroup")  # lines `0::/path` (version 2) and `4:cpu,cpuacct:/path` (version 1)


def memory_left() -> float:
    """Return the bytes that can still be allocated: limit minus usage, reclaimable file cache not counted as usage.

    Infinity without a limit.
    """
    ways = (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    )
    left = [
        limit - taken + _reclaimable(folder, files)
        for folder in _groups("memory")
        for most, now, files in ways
        if (limit := _number(folder / most)) is not None and (taken := _number(folder / now)) is not None
    ]
    return min(left, default=float("inf"))


def cores() -> float:
    """Return the CPU quota in cores, infinity without a quota."""
    shares = []
    for folder in _groups("cpu"):
        quota, period = _number(folder / "cpu.cfs_quota_us"), _number(folder / "cpu.cfs_period_us")
        with suppress(OSError, ValueError):
            quota, period = map(int, (folder / "cpu.max").read_text().split())
        if quota and period and quota > 0:
            shares.append(quota / period)
    return min(shares, default=float("inf"))


def _groups(controller: str) -> list[Path]:
    """Return the folders of the groups around the process."""
    found = [CGROUPS, CGROUPS / controller]
    with suppress(OSError, ValueError):
        for line in OWN_GROUPS.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if not controllers or controller in controllers.split(","):
                at = PurePosixPath(path)
                base = CGROUPS / controller if controllers else CGROUPS
                found += [base / one.relative_to("/") for one in (at, *at.parents)]
    return found


def _number(path: Path) -> int | None:
    with suppress(OSError, ValueError):  # `max` means no limit
        return int(path.read_text())
    return None


def _reclaimable(folder: Path, key: str) -> int:
    with suppress(OSError, ValueError, StopIteration):
        lines = (folder / "memory.stat").read_text().splitlines()
        return int(next(line for line in lines if line.startswith(f"{key} ")).split()[1])
    return 0


try:
    import psutil
except ImportError:  # not needed on Linux, where /proc has the same figures
    psutil = None

FREE_SHARE = 0.75  # of free memory, without --memory: leaves some for the rest of the machine
UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
MIN_LIMIT = 256 * 10**6  # bytes; the program alone takes more


def bytes_of(text: str) -> int:
    """Parse '512M' as 512,000,000, '8G', '1.5G'; ValueError for anything else and for less than MIN_LIMIT."""
    match = re.fullmatch(r"(\d{1,18}(?:\.\d+)?)\s*([KMGT]?)B?", text.strip(), re.IGNORECASE)
    if not match:
        raise ValueError(f"{text!r} is not an amount of memory such as 512M or 8G")
    found = int(float(match[1]) * UNITS[match[2].upper()])
    if found < MIN_LIMIT:
        raise ValueError(f"{text!r} is less than the program itself needs; give at least {in_words(MIN_LIMIT)}")
    return found


def in_words(count: float) -> str:
    """Format bytes for people: 512 MB, 1.7 GB."""
    return f"{count / 1e9:.1f} GB" if count >= 0.9995e9 else f"{max(0.0, count) / 1e6:.0f} MB"


def used() -> int:
    """Return the resident memory of this process, bytes."""
    with suppress(OSError, ValueError, IndexError):
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return psutil.Process().memory_info().rss if psutil else 0


def free() -> int:
    """Return the bytes that processes can still allocate, on the machine and in the groups that limit this process."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        found = int(next(line for line in lines if line.startswith("MemAvailable:")).split()[1]) * 1024
    except (OSError, ValueError, StopIteration):
        pages = "SC_PHYS_PAGES", "SC_PAGE_SIZE"
        found = psutil.virtual_memory().available if psutil else math.prod(map(os.sysconf, pages))
    return max(0, int(min(found, memory_left())))


def available_bytes(bound: int) -> int:
    """Return the bytes that this process may allocate in addition to what it uses.

    Args:
        bound: limit of the whole process, bytes; 0 for FREE_SHARE of free memory, shared among the processes that a
            launcher started on this machine.
    """
    if bound:
        return max(0, bound - used())
    return int(FREE_SHARE * free()) // int(os.environ.get("LOCAL_WORLD_SIZE", "1"))  # set by torchrun
