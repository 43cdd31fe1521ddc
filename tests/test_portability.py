"""Every module imports, and a work folder, locks and memory work, without what only POSIX has."""

import re
import subprocess
import sys

from tests.conftest import REPOSITORY
from tests.portability import FLAGS, LIBRARIES, SMALL


def run_without_posix(code: str, folder, libraries: tuple[str, ...] = SMALL) -> str:
    """What `code` prints in a process that has been stripped by tests.portability."""
    stripped = f"from tests.portability import without_posix; without_posix({libraries!r})\n{code}"
    line = [sys.executable, "-c", stripped, str(folder)]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=REPOSITORY, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.strip()


def test_modules_import_and_doctor_runs_without_posix(tmp_path):
    code = """
import importlib, pkgutil
names = []
for root in ("schemas", "stylerf", "stages", "stylerf_cli"):
    package = importlib.import_module(root)
    names += [one.name for one in pkgutil.walk_packages(package.__path__, root + ".")]
for name in names:
    if "gpu" not in name.split("."):  # Triton, which they import, is for Linux
        importlib.import_module(name)
from stylerf_cli.main import main
print(len(names) > 200, main(["doctor"]))
"""
    assert run_without_posix(code, tmp_path, LIBRARIES).endswith("True 0")


def test_flags_that_windows_lacks_are_taken_from_open_flags():
    lacking = re.compile(rf"os\.({'|'.join(FLAGS)})\b")
    roots = [REPOSITORY / root for root in ("schemas", "stages", "stylerf", "stylerf_cli")]
    files = [path for root in roots for path in root.rglob("*.py")]
    assert [path.name for path in files if lacking.search(path.read_text("utf-8"))] == []


def test_artifacts_are_made_and_replaced_without_posix(tmp_path):
    code = """
import sys
from schemas.errors import OutOfResources
from schemas.work_folder import Recipe, WorkFolder
for seed in (1, 2):
    begun = WorkFolder(sys.argv[1]).begin("field", "fit", Recipe("toy", 1, {}, [], seed))
    (begun.path / "a.txt").write_text("a")
    try:
        WorkFolder(sys.argv[1]).begin("field", "fit", Recipe("toy", 1, {}, [], seed))
    except OutOfResources as error:
        print("another process" in str(error))
    begun.commit()
print(WorkFolder(sys.argv[1]).get("field", "fit").manifest.seed)
"""
    assert run_without_posix(code, tmp_path).split() == ["True", "True", "2"]
    assert sorted(item.name for item in (tmp_path / "field").iterdir()) == [".fit.lock", "fit"]


def test_a_linked_lock_is_refused_without_o_nofollow(tmp_path):
    code = """
import sys
from pathlib import Path
from schemas.errors import WouldBeLost
from schemas.lock import Lock
path = Path(sys.argv[1], ".a.lock")
path.symlink_to(Path(sys.argv[1], "new"))
try:
    Lock(path)
except WouldBeLost:
    print("refused")
"""
    assert run_without_posix(code, tmp_path) == "refused" and not (tmp_path / "new").exists()


def test_memory_is_requested_of_psutil_without_proc(tmp_path):
    code = """
import os, stages.run.memory as memory, stages.run.clock as clock
from pathlib import Path
Path.read_text = lambda *_, **__: (_ for _ in ()).throw(FileNotFoundError())
print(memory.used(), memory.free(), clock.peak_memory_mb())
"""
    assert run_without_posix(code, tmp_path) == "300000000 8000000000 400.0"


def test_a_current_folder_is_left_again_without_fchdir(tmp_path):
    code = """
import os, sys
from pathlib import Path
from stylerf.environment.trusted_paths import current_folder
before = os.getcwd()
with current_folder(Path(sys.argv[1])):
    inside = os.getcwd()
print(inside == os.path.realpath(sys.argv[1]), os.getcwd() == before)
"""
    assert run_without_posix(code, tmp_path) == "True True"
