"""The pinned requirements: complete, each with digests, and within what pyproject.toml allows."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, requires

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from stages.weights.sources import OBTAIN_HED, OBTAIN_ST
from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "requirements"
FILES = sorted(path.name for path in FOLDER.glob("*.txt"))
CONTENT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
PROJECT = CONTENT["project"]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")


def pinned(*names: str) -> list[Requirement]:
    """The requirements of these files, hashes gone."""
    text = "".join((FOLDER / name).read_text() for name in names)
    blocks = [line for line in text.replace("\\\n", " ").splitlines() if line and line[0] not in "#-"]
    return [Requirement(re.sub(r"--hash=\S+", "", block)) for block in blocks]


def on_linux(python: str) -> dict[str, str]:
    given = {"python_version": python, "python_full_version": f"{python}.9", "sys_platform": "linux", "extra": ""}
    return default_environment() | given | {"platform_machine": "x86_64", "platform_system": "Linux"}


def chosen(python: str, *names: str) -> dict[str, str]:
    """{name: version} that these files install there; each name once."""
    here = [one for one in pinned(*names) if one.marker is None or one.marker.evaluate(on_linux(python))]
    found = {canonicalize_name(one.name): str(one.specifier).removeprefix("==") for one in here}
    assert len(found) == len(here), "pinned twice"
    return found


@pytest.mark.parametrize("name", FILES)
def test_every_requirement_has_one_version_and_digests(name):
    blocks = (FOLDER / name).read_text().replace("\\\n", " ").splitlines()[2:]
    assert blocks
    for block in blocks:
        assert re.match(r"[a-z0-9-]+==[\w.+]+ ", block) and re.search(r"--hash=sha256:[0-9a-f]{64}( |$)", block), block
        assert not re.search(r"https?:|file:| @ ", block)


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("torch", ["torch.txt", "torch-cpu.txt"])
def test_what_pyproject_asks_for_is_pinned_within_its_bounds(python, torch):
    extras = PROJECT["optional-dependencies"]
    found = chosen(python, "locked.txt", torch)
    wanted = [*PROJECT["dependencies"], *extras["video"], *CONTENT["build-system"]["requires"]]
    for one in map(Requirement, wanted):
        if one.marker is None or one.marker.evaluate(on_linux(python)):
            assert one.specifier.contains(found[canonicalize_name(one.name)]), one
    tests = chosen(python, "test.txt")
    for one in map(Requirement, extras["test"]):
        if one.marker is not None and not one.marker.evaluate(on_linux(python)):
            continue  # no wheels for that Python
        assert one.specifier.contains(tests[canonicalize_name(one.name)]), one
    assert chosen(python, "torch.txt")["triton"] == tests["triton"]


def test_nothing_that_is_needed_is_left_out():
    """What the distributions installed here say that they need; those of another build of torch aside."""
    found = {canonicalize_name(one.name) for one in pinned("locked.txt", "test.txt", "torch.txt")}
    waiting, here = sorted(found), on_linux(".".join(map(str, sys.version_info[:2])))
    for name in waiting:
        try:
            needed = [Requirement(one) for one in requires(name) or ()]
        except PackageNotFoundError:
            continue
        for one in needed:
            if one.marker is None or one.marker.evaluate(here):
                assert canonicalize_name(one.name) in found, f"{name} needs {one}"


def test_packages_that_carry_weights_are_no_dependency():
    weights = {"weights-hed.txt": OBTAIN_HED, "weights-st.txt": OBTAIN_ST}
    assert {name for name in FILES if name.startswith("weights")} == set(weights)
    for name, command in weights.items():
        (one,) = pinned(name)
        package = Requirement(command.split()[-1])
        assert (canonicalize_name(one.name), one.specifier) == (canonicalize_name(package.name), package.specifier)
        everywhere = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["test"]]
        assert not any(canonicalize_name(Requirement(other).name) == one.name for other in everywhere)


def test_installing_goes_on_without_weights_but_not_without_the_rest(tmp_path):
    """A pip that refuses one file stands in for a package that has vanished."""
    (tmp_path / "requirements").mkdir()
    script = (FOLDER / "install.sh").read_text().replace('"${PYTHON:-python3}" -m venv "$venv"', "")
    (tmp_path / "requirements" / "install.sh").write_text(script)
    (tmp_path / "venv" / "bin").mkdir(parents=True)
    python = tmp_path / "venv" / "bin" / "python"
    for refused, code in (("weights-st.txt", 0), ("locked.txt", 1), ("torch-cpu.txt", 0), ("nothing", 0)):
        python.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/log\ncase "$*" in *{refused}*) exit 1;; esac\n')
        python.chmod(0o755)
        (tmp_path / "log").write_text("")
        command = ["sh", "requirements/install.sh", "venv", "test"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        said = (tmp_path / "log").read_text().splitlines()
        assert (done.returncode != 0) == bool(code), refused
        assert ("going on without weights-st" in done.stderr) == (refused == "weights-st.txt")
        assert all("--no-deps" in line and ("--require-hashes" in line or line.endswith("/..")) for line in said)
        assert any(line.endswith("/..") for line in said) != bool(code)
        if refused == "torch-cpu.txt":
            assert any(line.endswith("/torch.txt") for line in said)


def test_installing_without_a_folder_says_how():
    done = subprocess.run(["sh", FOLDER / "install.sh"], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.splitlines() == ["usage: sh requirements/install.sh VENV [test]"]
