"""Where and when a figure was measured: what every result file says of itself."""

import os
import platform
from datetime import UTC, datetime


def here_and_now() -> dict:
    """JSON: machine (cpu, cores), python, date (UTC)."""
    return {
        "machine": {"cpu": platform.processor() or platform.machine(), "cores": os.cpu_count()},
        "python": platform.python_version(),
        "date": datetime.now(UTC).date().isoformat(),
    }
