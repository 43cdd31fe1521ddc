"""Settings of the C libraries: they hold where there are any, and leave a user's own as they are."""

import platform
import subprocess
import sys

from stylerf.environment.performance import keep_freed_pages, wait_passively

FAULTS = """
import resource
import numpy as np
from stylerf.environment.performance import keep_freed_pages
kept = keep_freed_pages()
def fill():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(12_000_000, np.float32)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
fill()
print(kept, fill())
"""


def test_a_large_array_made_again_costs_no_new_pages():
    output = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, check=True).stdout.split()
    if platform.libc_ver()[0] == "glibc":
        assert output[0] == "True" and int(output[1]) < 100  # of the 11,719 pages
    else:
        assert output[0] == str(keep_freed_pages())


def test_a_wait_policy_that_is_set_stays(monkeypatch):
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    wait_passively()
    import os

    assert os.environ["OMP_WAIT_POLICY"] == "passive"
    monkeypatch.setenv("OMP_WAIT_POLICY", "active")
    wait_passively()
    assert os.environ["OMP_WAIT_POLICY"] == "active"
