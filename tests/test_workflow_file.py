"""The workflow for hosts: every Python that pyproject.toml allows, on three systems, and the gate itself on Linux."""

import re
import tomllib

from packaging.specifiers import SpecifierSet

from tests.conftest import REPOSITORY

TEXT = (REPOSITORY / ".github" / "workflows" / "gate.yml").read_text()


def test_every_allowed_python_is_tested_on_three_systems():
    allowed = SpecifierSet(tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["requires-python"])
    pythons = [f"3.{minor}" for minor in range(30) if f"3.{minor}.9" in allowed]
    assert [re.findall(r'"(.+?)"', line) for line in re.findall(r"python: \[(.+)\]", TEXT)] == [pythons, pythons]
    assert set(re.findall(r"(\w+)-latest", TEXT)) == {"ubuntu", "macos", "windows"}


def test_linux_runs_the_gate_and_others_install_pinned_files():
    linux, others = TEXT.split("\n  others:\n")
    assert linux.rstrip().endswith("- run: bash .ci/run")
    named = re.findall(r"-r (\S+)", others)
    assert len(named) == 5 and all((REPOSITORY / name).is_file() for name in named)
