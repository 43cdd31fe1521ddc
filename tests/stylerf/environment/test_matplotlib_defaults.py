"""matplotlib is set up in one place, by its package's own settings."""

import os
import subprocess
import sys

from tests.conftest import REPOSITORY

CODE = """
import os
from stylerf.environment.matplotlib_defaults import matplotlib
usual = {key: value for key, value in matplotlib.rcParamsDefault.items() if key != "backend"}
print([key for key, value in usual.items() if matplotlib.rcParams[key] != value], os.getcwd())
"""


def test_neither_local_nor_user_matplotlibrc_changes_a_chart(tmp_path):
    for place in (tmp_path, tmp_path / "config"):
        place.mkdir(exist_ok=True)
        (place / "matplotlibrc").write_text("font.size: 60\naxes.facecolor: red\ntext.usetex: True\nnonsense\n")
    given = os.environ | {
        "MPLCONFIGDIR": str(tmp_path / "config"), "MATPLOTLIBRC": str(tmp_path), "PYTHONPATH": str(REPOSITORY)
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=tmp_path, env=given, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["[]", str(tmp_path)] and not done.stderr


def test_all_of_matplotlib_is_imported_there():
    for folder in ("schemas", "stages", "stylerf", "stylerf_cli", "benchmarks"):
        for path in (REPOSITORY / folder).rglob("*.py"):
            if path.name != "matplotlib_defaults.py":
                lines = [line.strip() for line in path.read_text().splitlines()]
                assert not any(line.startswith(("import matplotlib", "from matplotlib")) for line in lines), path


def test_the_current_folder_is_restored_even_if_it_was_deleted(tmp_path):
    (tmp_path / "gone").mkdir()
    code = """
import os, pathlib
from stylerf.environment.trusted_paths import current_folder
os.rmdir(os.getcwd())
before = os.stat(".").st_ino
with current_folder(pathlib.Path("/")):
    assert os.getcwd() == "/"
assert os.stat(".").st_ino == before
"""
    given = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path / "gone", env=given, check=True)
