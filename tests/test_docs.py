"""README.md, docs/, CHANGELOG.md and CONTRIBUTING.md: stages, verbs, files and links in them exist."""

import importlib
import re
from pathlib import Path

import pytest

from stages.configs.stylize import COLOR_CELLS
from stylerf.training.fit.capacity_levels import LEVELS
from stylerf_cli.verbs import VERBS
from tests.conftest import REPOSITORY

PAPERS = sorted([*(REPOSITORY / "docs").rglob("*.md"), REPOSITORY / "CHANGELOG.md", REPOSITORY / "CONTRIBUTING.md"])
ARCHITECTURE = (REPOSITORY / "docs" / "architecture.md").read_text()
ROOMS = ("stylerf_cli", "stages", "schemas", "stylerf", "tests", "docs")


def stage_modules() -> list[str]:
    return [
        path.stem for path in (REPOSITORY / "stages").glob("*.py") if re.search(r"^SPEC = ", path.read_text(), re.M)
    ]


def test_the_table_of_stages_is_that_of_the_code():
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| .+ \| `([\w-]+)`", ARCHITECTURE, re.M)
    specs = [importlib.import_module(f"stages.{name}").SPEC for name in stage_modules()]
    assert {*rows} == {(spec.stage, spec.verb, spec.writes) for spec in specs} and len(rows) == len(specs)


def test_every_verb_is_in_the_changelog():
    told = set(re.findall(r"`stylerf (\w+)", (REPOSITORY / "CHANGELOG.md").read_text()))
    assert set(VERBS) <= told


def test_the_levels_are_those_of_the_code():
    told = re.search(r"starts at (\d+)\^3 and tries (\d+)\^3, (\d+)\^3 and (\d+)\^3", ARCHITECTURE).groups()
    assert [int(one) for one in told] == [level.resolution for level in LEVELS]
    assert f"{COLOR_CELLS[1]}^3" in (REPOSITORY / "docs/decisions/0005-surfaces-packed.md").read_text()


@pytest.mark.parametrize("paper", PAPERS, ids=lambda path: path.name)
def test_files_and_links_exist(paper: Path):
    text = paper.read_text()
    for name in re.findall(rf"(?<![\w./])((?:{'|'.join(ROOMS)})/[\w/.-]*\w(?:\.py|\.md|/))(?![\w*<])", text):
        assert (REPOSITORY / name).exists(), name
    for link in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (paper.parent / link).exists(), link


def test_no_command_of_the_readme_replaces_the_field_of_another():
    shown = re.findall(r"^stylerf (?:stylize(?! \S+ --region)|finetune|edit) .*--(?:name|edit) (\S+)",
                       (REPOSITORY / "README.md").read_text(), re.M)  # fmt: skip
    assert "blue" in shown and len(set(shown)) == len(shown)


@pytest.mark.parametrize("paper", sorted((REPOSITORY / "docs" / "decisions").glob("*.md")), ids=lambda path: path.name)
def test_decisions_are_short_and_say_what_they_cost(paper: Path):
    text = paper.read_text()
    assert len(text.splitlines()) < 40
    assert re.match(rf"# {paper.name[:4]}\. ", text)
    assert all(f"**{part}**" in text for part in ("Question.", "Decision.", "Why.", "What it costs."))
