"""What control groups leave a process: the limits of containers, batch systems and services, versions 1 and 2.

A limit may be set on any group around the process, so each is looked at up to the root.
"""

from contextlib import suppress
from pathlib import Path, PurePosixPath

ROOT = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")  # lines `0::/path` (version 2) and `4:cpu,cpuacct:/path` (version 1)


def memory_left() -> float:
    """Bytes that can still be taken: each group's limit less what it holds, files that it gives back when asked apart.

    Infinity where there is no limit.
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
    """Processors' worth of time that the process may take; infinity where there is no quota."""
    shares = []
    for folder in _groups("cpu"):
        quota, period = _number(folder / "cpu.cfs_quota_us"), _number(folder / "cpu.cfs_period_us")
        with suppress(OSError, ValueError):
            quota, period = map(int, (folder / "cpu.max").read_text().split())
        if quota and period and quota > 0:
            shares.append(quota / period)
    return min(shares, default=float("inf"))


def _groups(controller: str) -> list[Path]:
    """Folders of groups that may bound the process: its own and those around it."""
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
    with suppress(OSError, ValueError):  # without a limit it says `max`
        return int(path.read_text())
    return None


def _given_back(folder: Path, key: str) -> int:
    with suppress(OSError, ValueError, StopIteration):
        lines = (folder / "memory.stat").read_text().splitlines()
        return int(next(line for line in lines if line.startswith(f"{key} ")).split()[1])
    return 0
