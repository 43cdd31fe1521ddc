"""README.md, docs/, CHANGELOG.md, CONTRIBUTING.md: links, files, commands and options exist; the site builds."""

import argparse
import importlib
import importlib.util
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from schemas.errors import UsageError
from stages.configs.stylize import COLOR_CELLS
from stylerf.training.fit.settings import LEVELS
from stylerf_cli.verbs import VERBS
from tests.conftest import REPOSITORY

DOCS = REPOSITORY / "docs"
ROOT_PAGES = [REPOSITORY / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
PAGES = [*ROOT_PAGES, *sorted(DOCS.rglob("*.md"))]
# Generated from measurements: they quote commands of the versions that were measured.
QUOTED = {DOCS / "results.md", DOCS / "published.md"}
DECISIONS = sorted((DOCS / "decisions").glob("0*.md"))
ARCHITECTURE = (DOCS / "architecture.md").read_text()
FOLDERS = "stylerf_cli stages schemas stylerf tests docs benchmarks workflows examples requirements".split()
# Options of other programs that the pages mention.
OTHER_OPTIONS = {
    *("--auto-scale-poses", "--center-method", "--orientation-method"),  # nerfstudio
    *("--build-arg", "--gpus", "--rm", "--user"),  # docker
    *("--nnodes", "--no-python", "--nproc-per-node", "--rdzv-backend", "--rdzv-endpoint"),  # torchrun
    *("--index-url", "--no-build-isolation", "--no-deps", "--strict"),  # pip, mkdocs
    *("--default-resources", "--apptainer-args", "--bind"),  # Snakemake, Apptainer
    *("--cases", "--crowds", "--kills", "--mutants", "--replay", "--stages"),  # python -m tests.campaign
    "--help",
}

_spec = importlib.util.spec_from_file_location("reference_pages", DOCS / "reference_pages.py")
reference_pages = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference_pages)


def page_id(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def code_of(text: str) -> str:
    """Fenced and indented code of a page, without comments."""
    fenced = re.findall(r"^```\w*\n(.*?)^```$", text, re.S | re.M)
    indented = re.findall(r"^(?: {4}.*(?:\n|$))+", re.sub(r"^```\w*\n.*?^```$", "", text, flags=re.S | re.M), re.M)
    return "\n".join([*fenced, *indented])


def commands_in(lines: list[str]) -> list[list[str]]:
    """Arguments of every `stylerf VERB ...` in lines of code."""
    found = []
    for line in lines:
        if match := re.match(r"\s*(?:(?:torchrun|docker run) .*?)?\bstylerf ([a-z]+ .*)", line):
            found.append(shlex.split(re.split(r"\s+#\s|\s>\s", match.group(1))[0]))  # without comment, redirection
    return [one for one in found if one and one[0] in VERBS and "..." not in " ".join(one)]


def code_commands(text: str) -> list[list[str]]:
    """Commands in the code of a page."""
    return commands_in(re.sub(r"\\\n\s*", "", code_of(text)).splitlines())


def commands_of(text: str) -> list[list[str]]:
    """Commands in the code and the inline code of a page."""
    inline = [one.replace("\n", " ") for one in re.findall(r"(?<!`)`([^`]+)`(?!`)", text)]
    return code_commands(text) + commands_in(inline)


def parsed(arguments: list[str]) -> argparse.Namespace:
    parser = reference_pages.parser_of(arguments)
    return parser.parse_args(arguments[1:])


def anchors_of(path: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", path.read_text(), re.M)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", one).strip().lower()) for one in headings}


@pytest.fixture(scope="module")
def options() -> dict[str, set[str]]:
    """{verb: its option strings}."""
    return {verb: reference_pages.options_of(verb) for verb in VERBS}


def stage_modules() -> list[str]:
    return [
        path.stem for path in (REPOSITORY / "stages").glob("*.py") if re.search(r"^SPEC = ", path.read_text(), re.M)
    ]


def test_the_table_of_stages_is_that_of_the_code():
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| .+ \| `([\w-]+)`", ARCHITECTURE, re.M)
    specs = [importlib.import_module(f"stages.{name}").SPEC for name in stage_modules()]
    assert {*rows} == {(spec.stage, spec.verb, spec.writes) for spec in specs} and len(rows) == len(specs)


def test_every_verb_is_in_the_changelog():
    assert set(VERBS) <= set(re.findall(r"`stylerf (\w+)", (REPOSITORY / "CHANGELOG.md").read_text()))


def test_every_verb_is_in_the_verb_table_of_the_readme():
    table = re.search(r"^\| verb \|.*?\n\n", (REPOSITORY / "README.md").read_text(), re.S | re.M).group(0)
    first = re.findall(r"^\| (.+?) \|", table, re.M)
    assert {name for cell in first for name in re.findall(r"`(\w+)`", cell)} == set(VERBS)


def test_the_readme_is_short_and_has_one_table_of_results():
    text = (REPOSITORY / "README.md").read_text()
    assert len(text.encode()) <= 7 * 1024
    assert len(re.findall(r"^\|(?:-+\|)+$", text, re.M)) == 2  # verbs, results


def test_capacity_levels_are_those_of_the_code():
    documented = re.search(r"starts at (\d+)\^3 and tries (\d+)\^3, (\d+)\^3 and (\d+)\^3", ARCHITECTURE).groups()
    assert [int(one) for one in documented] == [level.resolution for level in LEVELS]
    assert f"{COLOR_CELLS[1]}^3" in (DOCS / "decisions" / "0005-march-each-view-once.md").read_text()


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_links_and_files_exist(page):
    text = page.read_text()
    for name in re.findall(rf"(?<![\w./-])((?:{'|'.join(FOLDERS)})/[\w/.-]*\w(?:\.\w+|/))(?![\w*<])", text):
        assert (REPOSITORY / name).exists(), name
    for link, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([\w-]+))?\)", text):
        target = page.parent / link if link else page
        if "docs/reference/" in str(target):  # generated when the site is built
            assert str(target.relative_to(DOCS)) in reference_pages.pages(), link
            continue
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), f"{link}#{anchor}"


@pytest.mark.parametrize("page", [page for page in PAGES if page not in QUOTED], ids=page_id)
def test_commands_are_understood(page):
    for arguments in commands_of(page.read_text()):
        try:
            parsed(arguments)
        except UsageError as error:
            if not re.search(r"required|expected one argument", str(error)):  # sentences leave arguments out
                raise AssertionError(f"stylerf {shlex.join(arguments)}: {error}") from error


def test_the_check_of_commands_finds_a_misspelled_option():
    assert commands_of("`stylerf fit WORK --budgte 5m`\n\n    stylerf render W \\\n        --path orbit\n") == [
        ["render", "W", "--path", "orbit"], ["fit", "WORK", "--budgte", "5m"]
    ]  # fmt: skip
    with pytest.raises(UsageError):
        parsed(["fit", "WORK", "--budgte", "5m"])
    with pytest.raises(UsageError):
        parsed(["fit", "WORK", "--space", "sphere"])


@pytest.mark.parametrize("page", [page for page in PAGES if page not in QUOTED], ids=page_id)
def test_options_exist(page, options):
    known = set().union(*options.values()) | OTHER_OPTIONS
    text = page.read_text()
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]*[a-z](?![\w-])", text)) <= known
    for verb, option in re.findall(r"`(\w+) (--[a-z-]+)[^`]*`", text):  # such as `fit --gradient-clip`
        assert verb not in options or option in options[verb], f"{verb} {option}"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_configuration_keys_exist(page, options):
    for block in re.findall(r"(?:^    (?:\w+ = .*|\[\w+\])\n)+", page.read_text(), re.M):
        if "[" not in block.split("=")[0] and "\n    [" not in block:
            continue  # not TOML with a table
        tables = tomllib.loads(re.sub(r"^    ", "", block, flags=re.M))
        for verb, table in tables.items():
            for key in table if isinstance(table, dict) else ():
                assert "--" + key.replace("_", "-") in options[verb], f"[{verb}] {key}"


def test_commands_of_a_page_do_not_overwrite_each_other():
    for page in (DOCS / "how-to" / "palettes.md", DOCS / "how-to" / "local-edits.md"):
        named = [parsed(one).name for one in code_commands(page.read_text()) if "--name" in one]
        assert len(named) >= 3 and len(set(named)) == len(named)


@pytest.mark.parametrize("page", DECISIONS, ids=lambda path: path.name)
def test_decisions_are_short_and_complete(page):
    text = page.read_text()
    assert len(text.splitlines()) <= 24
    assert re.match(rf"# {page.name[:4]}\. ", text)
    assert all(f"**{part}**" in text for part in ("Question.", "Decision.", "Why.", "Cost."))
    title = re.match(r"# \d+\. (.+)", text).group(1)
    assert f"- [{page.name[:4]}]({page.name}) {title}\n" in (DOCS / "decisions" / "index.md").read_text()


@pytest.mark.parametrize("verb", VERBS)
def test_the_reference_of_a_verb_has_every_option(verb):
    page = reference_pages.verb_page(verb)
    for _, parser in reference_pages.parsers_of(verb):
        for action in parser._actions:
            if action.help is not argparse.SUPPRESS and not {"-h", "--help-all"} & {*action.option_strings}:
                assert all(f"`{name}" in page for name in action.option_strings)
                assert all(f"`{choice}`" in page for choice in action.choices or ())


def test_the_site_builds_without_warnings(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(
        command, cwd=REPOSITORY, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": "."}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "--capacity" in (tmp_path / "site" / "reference" / "cli" / "fit" / "index.html").read_text()
    assert "SpaceWarp" in (tmp_path / "site" / "reference" / "api" / "stylerf.geometry" / "index.html").read_text()


# Words of our own for what the field has a term for (decisions keep those of their time).
PRIVATE_WORDS = re.compile(
    r"\b(anew|backdrops?|careful|climb(s|ing)?|dear|even_from|given up|joining|ladders?|leap(s|ing)?|narrowing|rungs?|"
    r"spoiled|telling|told|traffic|trunks?|twins?|wording)\b",
    re.IGNORECASE,
)
EXCEPTIONS = {"schemas/migrations.py", "stylerf/procedural/composition.py"}  # older names on disk; a painted tree


def test_product_and_pages_use_the_field_s_terms():
    code = [path for name in ("schemas", "stages", "stylerf", "stylerf_cli", "examples", "benchmarks") for path in
            sorted((REPOSITORY / name).rglob("*.py"))]  # fmt: skip
    found = [
        f"{page_id(path)}: {match[0]}"
        for path in [*PAGES, *code]
        if path not in DECISIONS and page_id(path) not in EXCEPTIONS
        for match in PRIVATE_WORDS.finditer(path.read_text())
    ]
    assert not found
