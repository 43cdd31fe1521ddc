"""Limits of control groups (versions 1 and 2), as set by containers, batch systems and services.

Any group around the process may set a limit, so all are read up to the root.
"""

from contextlib import suppress
from pathlib import Path, PurePosixPath

ROOT = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")  # lines `0::/path` (version 2) and `4:cpu,cpuacct:/path` (version 1)


def memory_left() -> float:
    """Return the bytes that can still be allocated: limit minus usage, reclaimable file cache not counted as usage.

    Infinity without a limit.
    """
    ways = (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    )
    left = [
        limit - taken + _given_back(folder, files)
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
    found = [ROOT, ROOT / controller]
    with suppress(OSError, ValueError):
        for line in OWN.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if not controllers or controller in controllers.split(","):
                at = PurePosixPath(path)
                base = ROOT / controller if controllers else ROOT
                found += [base / one.relative_to("/") for one in (at, *at.parents)]
    return found


def _number(path: Path) -> int | None:
    with suppress(OSError, ValueError):  # `max` means no limit
        return int(path.read_text())
    return None


def _given_back(folder: Path, key: str) -> int:
    with suppress(OSError, ValueError, StopIteration):
        lines = (folder / "memory.stat").read_text().splitlines()
        return int(next(line for line in lines if line.startswith(f"{key} ")).split()[1])
    return 0
