"""What lies in the current folder is never executed and configures nothing: it may have come with the photos."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY
from tests.stylerf_cli import capture

MODULES = (
    "threading", "json", "signal", "argparse", "logging", "pkgutil", "hashlib", "sqlite3", "yaml", "torch", "scipy",
    "matplotlib", "numba", "skimage", "PIL", "pycolmap", "OpenImageIO", "OpenEXR", "h5py", "safetensors", "av",
    "sitecustomize", "usercustomize", "conftest", "stylerf_cli", "schemas", "stylerf",
)  # fmt: skip
PACKAGES = ("numpy", "stages")
PROGRAMS = ("latex", "dvipng", "kpsewhich", "gcc", "git", "ffmpeg", "fc-list")
TRAP = "import os\nopen(os.environ['SPRUNG'], 'a').write(__file__ + '\\n')\n"
RUN = "import sys\nfrom stylerf_cli.main import main\nsys.exit(max(main(line.split()) for line in sys.argv[1:]))\n"


@pytest.fixture
def trap(tmp_path) -> Path:
    """A folder with photos, full of modules and configuration that leave a mark when they are used."""
    folder = tmp_path / "downloaded"
    capture.write_images(folder / "photos")
    shutil.copytree(folder / "photos", folder / "posed")
    capture.write_transforms(folder / "posed", capture.transforms())
    for name in MODULES:
        (folder / f"{name}.py").write_text(TRAP)
    for name in PACKAGES:
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(TRAP)
    for name in PROGRAMS:
        (folder / name).write_text(f"#!/bin/sh\necho {name} >> $SPRUNG\n")
        (folder / name).chmod(0o755)
    (folder / "matplotlibrc").write_text("text.usetex: True\nfont.size: 60\naxes.facecolor: 'f00'\nnot a line of it\n")
    (folder / ".numba_config.yaml").write_text("disable_jit: 1\n")
    return folder


def run(folder: Path, *lines: str, **environment: str) -> subprocess.CompletedProcess:
    """Each line a command, in one process that starts as the installed script does: its own folder is on the path."""
    (folder.parent / "bin").mkdir(exist_ok=True)
    (folder.parent / "bin" / "stylerf").write_text(RUN)
    # A yaml that can be imported, so that numba would read its file.
    (folder.parent / "lib").mkdir(exist_ok=True)
    (folder.parent / "lib" / "yaml.py").write_text(TRAP.replace("__file__", "'yaml is used: '") + "safe_load = open\n")
    path = os.pathsep.join([str(REPOSITORY), str(folder.parent / "lib")])
    given = os.environ | {"SPRUNG": str(folder.parent / "sprung"), "PYTHONPATH": path} | environment
    command = [sys.executable, str(folder.parent / "bin" / "stylerf"), *lines]
    return subprocess.run(command, cwd=folder, env=given, capture_output=True, text=True, check=False)


def sprung(folder: Path) -> str:
    mark = folder.parent / "sprung"
    return mark.read_text() if mark.exists() else ""


def test_structure_from_motions_child_runs_nothing_of_it(trap):
    done = run(trap, "import photos out")
    assert done.returncode == 3 and "photos" in done.stderr, done.stderr  # four photos of nothing cannot be placed
    assert "structure from motion" in done.stderr and not sprung(trap)


def test_a_whole_chain_runs_none_of_it_and_draws_the_usual_charts(trap, tmp_path):
    chain = ("import posed out", "fit out --budget 3 --no-buffers", "render out --path test", "eval out", "compare out")
    done = run(trap, *(f"{line} --no-paths" for line in chain))
    assert done.returncode == 0, done.stderr
    # numba imports yaml if it can; only the file's absence from its sight keeps it from being read.
    assert sprung(trap).replace("yaml is used: \n", "") == "" and "matplotlibrc" not in done.stderr
    charts = sorted((trap / "out").rglob("*.svg"))
    assert charts and all("#ff0000" not in chart.read_text() for chart in charts)
    text = charts[0].read_text()
    assert "<text" in text and "60px" not in text
    # --no-paths: nothing that was written tells where the photos or the work folder lay.
    written = [path for path in (trap / "out").rglob("*") if path.is_file() and path.suffix != ".lock"]
    assert {".json", ".exr", ".html", ".png"} <= {path.suffix for path in written}
    for path in written:
        assert str(tmp_path).encode() not in path.read_bytes(), path
    assert json.loads((trap / "out" / "scene" / "main" / "manifest.json").read_text())["config"]["source"] == "posed"


def test_an_empty_entry_of_pythonpath_does_not_import_from_it(trap):
    for name in ("sitecustomize", "usercustomize"):  # Python itself runs these, before anything of ours
        (trap / f"{name}.py").unlink()
    done = run(trap, "import photos out", PYTHONPATH=f"{REPOSITORY}{os.pathsep}")
    assert done.returncode == 3 and "structure from motion" in done.stderr, done.stderr
    assert not sprung(trap)


def test_a_folder_that_pythonpath_names_in_full_stays(trap, tmp_path):
    code = f"import sys; sys.path.insert(0, {str(REPOSITORY)!r}); import stylerf_cli; print({str(trap)!r} in sys.path)"
    for named, stays in ((str(trap), "True"), ("", "False"), (".", "False")):
        given = os.environ | {"PYTHONPATH": os.pathsep.join([named, str(tmp_path)]), "SPRUNG": str(tmp_path / "sprung")}
        done = subprocess.run(
            [sys.executable, "-P", "-c", code], cwd=trap, env=given, capture_output=True, text=True, check=True
        )
        assert done.stdout.split()[-1] == stays, named


def test_no_child_or_documented_command_imports_from_current_folder():
    """`-m` and `-c` put the current folder first on the path; `-P` leaves it out."""
    code = [path for folder in ("schemas", "stages", "stylerf", "stylerf_cli") for path in
            (REPOSITORY / folder).rglob("*.py")]  # fmt: skip
    children = [line for path in code for line in path.read_text().splitlines() if "sys.executable," in line]
    assert children and [line for line in children if '"-P"' not in line] == []
    user_facing = [REPOSITORY / "README.md", REPOSITORY / "Dockerfile", *(REPOSITORY / "docs").rglob("*.md")]
    for path in [*user_facing, REPOSITORY / "workflows" / "scene.sh"]:
        assert not re.search(r"(python3?|torchrun .*) -m (stylerf|stages|schemas)", path.read_text()), path
