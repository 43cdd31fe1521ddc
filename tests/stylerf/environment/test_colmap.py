"""A process that has loaded pycolmap still ends as Python says when it is terminated."""

import subprocess
import sys

CODE = """
import os, signal
signal.signal(signal.SIGTERM, lambda *_: print("handled"))
import stages.pose_import
os.kill(os.getpid(), signal.SIGTERM)
print("alive", "pycolmap" in __import__("sys").modules)
"""


def test_a_handler_of_sigterm_outlives_the_import_of_pycolmap():
    ended = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout.split(), ended.stderr) == (0, ["handled", "alive", "True"], "")
