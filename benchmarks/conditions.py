"""Where and when figures were measured, as recorded in every result file."""

import os
import platform
import re
from datetime import UTC, datetime
from pathlib import Path


def here_and_now() -> dict:
    """Return JSON: machine (cpu, cores), python, date (UTC)."""
    return {
        "machine": {"cpu": _model() or platform.processor() or platform.machine(), "cores": os.cpu_count()},
        "python": platform.python_version(),
        "date": datetime.now(UTC).date().isoformat(),
    }


def _model() -> str:
    """Return the name of the processor on Linux; empty elsewhere."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"^model name\s*:\s*(.+)$", info.read_text(), re.MULTILINE) if info.is_file() else None
    return found[1].strip() if found else ""
