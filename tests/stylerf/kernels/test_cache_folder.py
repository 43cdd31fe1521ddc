"""Compiled kernels are found again only while every source file that they are made of is the same."""

import os
import pickle
import re
import shutil
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import stylerf.kernels as package


def test_cache_folder_moves_when_any_kernel_source_changes(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("STYLERF_CACHE", str(tmp_path))
    before = package.kernel_cache_dir()
    assert before.is_relative_to(tmp_path / "kernels")
    copy = tmp_path / "copy"
    shutil.copytree(Path(package.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(package, "__file__", str(copy / "__init__.py"))
    assert package.kernel_cache_dir() == before
    with (copy / "cpu" / "march.py").open("a") as source:
        source.write("# a helper that other files inline has changed\n")
    assert package.kernel_cache_dir() != before


def test_a_folder_that_the_user_names_is_used_once_in_children_too(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folder = package.kernel_cache_dir()
    assert folder.parent == tmp_path
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    assert package.kernel_cache_dir() == folder


def test_unlike_processors_that_share_a_home_keep_their_kernels_apart(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    here = package.kernel_cache_dir()
    monkeypatch.setattr(package.binding, "get_host_cpu_name", lambda: "not-this-one")
    assert package.kernel_cache_dir() != here and "not-this-one" in package.kernel_cache_dir().name
    monkeypatch.undo()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    features = package.binding.get_host_cpu_features()
    monkeypatch.setattr(package.binding, "get_host_cpu_features", lambda: type(features)({"avx512f": False}))
    assert package.kernel_cache_dir() != here


def test_without_a_writable_folder_kernels_serve_one_run_and_say_so(tmp_path):
    program = """
import numpy as np, os
from stylerf.fields.vm import VmDensity
from stylerf.kernels.cpu.compiling import compiling_note
random = np.random.default_rng(0)
field = VmDensity.create(np.full(3, 24), 16, random)
for _ in range(2):
    with compiling_note(print):
        field.sigma(random.random((20, 3), dtype=np.float32), 2)
print(os.environ["NUMBA_CACHE_DIR"])
"""
    (tmp_path / "file").touch()
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "file" / "kernels"), "TMPDIR": str(tmp_path),
        "PYTHONPATH": str(Path(package.__file__).parents[2]),
    }  # fmt: skip
    run = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    note, folder = run.stdout.splitlines()
    assert "for this run alone" in note and f"{tmp_path}/file/kernels" in note and "STYLERF_CACHE" in note
    assert Path(folder).is_relative_to(tmp_path) and not Path(folder).exists()


COMPILED = """
import os, sys, numpy as np
from stylerf.kernels.cpu.compiling import compiling_note
with compiling_note(print):
    if sys.argv[1:]:
        from stylerf.fields.vm import VmDensity
        random = np.random.default_rng(0)
        VmDensity.create(np.full(3, 24), 16, random).sigma(random.random((20, 3), dtype=np.float32), 2)
print(os.environ["NUMBA_CACHE_DIR"])
"""


class Trap:
    """Leaves a mark where it is unpickled, as numba unpickles the index of its cache."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return open, (str(self.mark), "w")


def compiled(cache: Path, *kernel: str, **more: str) -> list[str]:
    """The lines that a process prints which needs a kernel, if any: notes, then its cache folder."""
    given = {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(Path(package.__file__).parents[2])}
    command = [sys.executable, "-c", COMPILED, *kernel]
    return subprocess.run(
        command, env=os.environ | given | more, capture_output=True, text=True, check=True
    ).stdout.splitlines()


def test_kernels_that_somebody_else_could_have_written_are_not_executed(tmp_path):
    mark, cache = tmp_path / "mark", tmp_path / "cache"
    note, folder = compiled(cache, "kernel", TMPDIR=str(tmp_path))
    kept = Path(folder)
    assert "once" in note and kept.parent == cache and stat.S_IMODE(kept.stat().st_mode) == 0o700
    for index in kept.rglob("*.nbi"):
        index.write_bytes(pickle.dumps(Trap(mark)))
    with suppress(subprocess.CalledProcessError):  # in a folder that is ours the trap works, so it would elsewhere
        compiled(cache, "kernel")
    assert mark.exists()
    mark.unlink()
    for spoil, restore, words, kernel in (
        (lambda: kept.chmod(0o777), lambda: kept.chmod(0o700), "can be written by others", ["kernel"]),
        (lambda: cache.chmod(0o777), lambda: cache.chmod(0o755), f"in {cache}, which can be written by others", []),
        (lambda: linked(kept), lambda: None, "is a link", []),
    ):
        spoil()
        note, folder = compiled(cache, *kernel, TMPDIR=str(tmp_path))
        assert "for this run alone" in note and words in note and "STYLERF_CACHE" in note
        assert not Path(folder).is_relative_to(cache) and not Path(folder).exists() and not mark.exists()
        restore()
    assert not list(tmp_path.glob("stylerf-kernels-*"))


def linked(folder: Path) -> None:
    """Moves a folder away and leaves a link to it."""
    elsewhere = folder.parent.parent / "elsewhere"
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)


def test_a_gpus_kernels_lie_beside_them_unless_the_user_says_where(tmp_path):
    program = "import os, stylerf.kernels; print(os.environ.get('TRITON_CACHE_DIR'), os.environ['NUMBA_CACHE_DIR'])"
    (tmp_path / "file").touch()
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("TRITON_", "NUMBA_"))}
    plain |= {"PYTHONPATH": str(Path(package.__file__).parents[2]), "TMPDIR": str(tmp_path)}

    def folders(**more: str) -> list[str]:
        command = [sys.executable, "-c", program]
        run = subprocess.run(command, env=plain | more, capture_output=True, text=True, check=True)
        return run.stdout.split()

    assert folders(STYLERF_CACHE=str(tmp_path))[0] == f"{tmp_path}/kernels/triton-{os.geteuid()}"
    assert folders(TRITON_CACHE_DIR="/mine")[0] == "/mine" and folders(TRITON_HOME="/mine")[0] == "None"
    passing, ours = folders(STYLERF_CACHE=str(tmp_path / "file"))
    assert Path(passing).parent == Path(ours).parent and Path(passing).name == f"triton-{os.geteuid()}"
    assert Path(passing).is_relative_to(tmp_path) and not Path(passing).parent.exists()
    # Nor are those executed that somebody else could have written, wherever they are.
    for place, more in ((tmp_path / "kernels" / f"triton-{os.geteuid()}", {"STYLERF_CACHE": str(tmp_path)}),
                        (tmp_path / "mine", {"TRITON_CACHE_DIR": str(tmp_path / "mine")}),
                        (tmp_path / ".triton" / "cache", {"TRITON_HOME": str(tmp_path)})):  # fmt: skip
        place.mkdir(parents=True, exist_ok=True)
        place.chmod(0o777)
        assert "stylerf-kernels-" in folders(**more)[0]


def test_a_fresh_kernel_and_the_cached_one_give_the_same_bits(tmp_path):
    """With fast-math a quarter of the densities differed in the last bit; see docs/decisions/0007."""
    program = """
import hashlib, numpy as np
from stylerf.fields.vm import VmDensity, kernels
random = np.random.default_rng(0)
field = VmDensity.create(np.full(3, 24), 16, random)
sigma = field.sigma(random.random((20000, 3), dtype=np.float32), 2)
print(hashlib.sha256(sigma.tobytes()).hexdigest(), sum(kernels.density_at.stats.cache_hits.values()))
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(package.__file__).parents[2])}
    said = [
        subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    (first, compiled), (second, loaded) = (run.stdout.split() for run in said)
    assert (compiled, loaded) == ("0", "1")
    assert first == second


def test_whoever_imports_numba_first_has_the_folder(tmp_path):
    """Else kernels lie beside their sources and are taken from there after another file they inline has changed."""
    root = Path(package.__file__).parents[2]
    given = os.environ | {"STYLERF_CACHE": str(tmp_path)}
    given.pop("NUMBA_CACHE_DIR", None)
    words = [r"^import numba\b", r"^from numba\b"]
    sources = [path for folder in ("stylerf", "stages", "schemas") for path in (root / folder).rglob("*.py")]
    users = [path for path in sources if any(re.search(one, path.read_text(), re.MULTILINE) for one in words)]
    beside = [path for path in users if "kernels" not in path.relative_to(root).parts]
    assert len(users) > 10 and beside
    for path in beside:
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        code = f"import {module}, numba; print(numba.config.CACHE_DIR)"
        found = subprocess.run(
            [sys.executable, "-c", code], env=given, cwd=root, capture_output=True, text=True, check=True
        )
        assert Path(found.stdout.strip()).is_relative_to(tmp_path / "kernels"), module
