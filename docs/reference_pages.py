"""mkdocs hook: generate the reference pages of the command line and of the Python API when the site is built.

The parsers are those that `stylerf VERB --help-all` prints; the API pages list modules, which mkdocstrings renders.
"""

import argparse
import re
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

ROOT = Path(__file__).resolve().parent.parent
API = ("stylerf", "stages.pipeline", "schemas")
INTERNAL = ("stylerf.kernels", "stylerf.environment")
# Arguments under which a verb has other options: (heading, arguments).
USES: dict[str, list[tuple[str, list[str]]]] = {
    "stylize": [
        *((f"`--method {method}`", ["--method", method]) for method in ("arf", "desrf", "snerf", "refnpr")),
        ("`--method palettenerf`", ["--method", "palettenerf"]),
        ("`--region REGION`", ["--region", "REGION"]),
    ]
}


class _Captured(SystemExit):
    """Ends `main` once its parser is built; a SystemExit, as argparse itself raises after --help."""


def parser_of(arguments: list[str]) -> argparse.ArgumentParser:
    """Return the parser that the command `stylerf ARGUMENTS` builds, without running the command."""
    from stylerf_cli.main import main

    found: list[argparse.ArgumentParser] = []

    def capture(self: argparse.ArgumentParser, *_: object, **__: object) -> None:
        found.append(self)
        raise _Captured(0)

    with mock.patch.object(argparse.ArgumentParser, "parse_args", capture):
        main(arguments)
    if not found:
        raise ValueError(f"`stylerf {' '.join(arguments)}` builds no parser")
    return found[-1]


def verbs() -> dict[str, str]:
    """Return {verb: help}, in the order of `stylerf --help`."""
    from stylerf_cli.verbs import VERBS

    return {verb: help for verb, (_, help) in VERBS.items()}


def parsers_of(verb: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield (heading, parser) for each use of a verb with options of its own; the heading is empty for a single use."""
    for heading, arguments in USES.get(verb, [("", [])]):
        yield heading, parser_of([verb, *arguments, "--help-all"])


def options_of(verb: str) -> set[str]:
    """Return every option string of a verb, over all its uses."""
    return {name for _, parser in parsers_of(verb) for action in parser._actions for name in action.option_strings}


def _rows(group: argparse._ArgumentGroup) -> list[tuple[str, str, str, str]]:
    """Return (option, choices, default, help) of each argument of a group, as Markdown cells."""
    rows = []
    for action in group._group_actions:
        if action.help is argparse.SUPPRESS or "-h" in action.option_strings or "--help-all" in action.option_strings:
            continue
        text = " ".join((action.help or "").replace("%%", "%").split())
        found = re.search(r" \(default: ([^()]*(?:\([^()]*\)[^()]*)*)\)$", text)
        default = found.group(1) if found else ""
        if found:
            text = text[: found.start()]
        metavar = action.metavar if isinstance(action.metavar, str) else None
        name = ", ".join(f"`{one}`" for one in action.option_strings) or f"`{metavar or action.dest}`"
        choices = ", ".join(f"`{one}`" for one in action.choices or ())
        if action.option_strings and not choices and metavar:
            name = ", ".join(f"`{one} {metavar}`" for one in action.option_strings)
        rows.append((name, choices, f"`{default}`" if default else "", text))
    return [tuple(re.sub(r"(`[^`]*`)|\|", lambda found: found.group(1) or r"\|", cell) for cell in row) for row in rows]


def _tables(parser: argparse.ArgumentParser, level: str) -> list[str]:
    lines = []
    for group in parser._action_groups:
        if rows := _rows(group):
            lines += ["", f"{level} {(group.title or 'Options').capitalize()}", ""]
            lines += ["| argument | choices | default | meaning |", "|---|---|---|---|"]
            lines += [f"| {' | '.join(row)} |" for row in rows]
    return lines


def verb_page(verb: str) -> str:
    """Return the Markdown page of one verb: synopsis, and a table of every option per use."""
    uses = list(parsers_of(verb))
    lines = [f"# stylerf {verb}", "", f"{verbs()[verb][0].upper()}{verbs()[verb][1:]}."]
    positionals = [action.metavar or action.dest for action in uses[0][1]._actions if not action.option_strings]
    lines += ["", f"    stylerf {verb} {' '.join(map(str, positionals))} [OPTIONS]"]
    tables: dict[str, list[str]] = {}  # the headings that share each set of options
    for heading, parser in uses:
        tables.setdefault("\n".join(_tables(parser, "###" if heading else "##")), []).append(heading)
    for table, headings in tables.items():
        lines += ["", f"## {', '.join(headings)}"] if all(headings) else []
        lines.append(table)
    return "\n".join([*lines, ""])


def cli_index() -> str:
    """Return the Markdown page that lists the verbs."""
    rows = [f"| [`{verb}`]({verb}.md) | {help} |" for verb, help in verbs().items()]
    head = ["# Command line", "", "    stylerf VERB [ARGUMENTS] [OPTIONS]", "", "| verb | what it does |", "|---|---|"]
    return "\n".join([*head, *rows, ""])


def api_packages() -> dict[str, list[str]]:
    """Return {package: its public modules} for every package of the Python API."""
    packages: dict[str, list[str]] = {}
    for name in API:
        for init in sorted((ROOT / name.replace(".", "/")).rglob("__init__.py")):
            package = ".".join(init.parent.relative_to(ROOT).parts)
            modules = [f"{package}.{path.stem}" for path in sorted(init.parent.glob("[!_]*.py"))]
            if modules and not package.startswith(INTERNAL):
                packages[package] = modules
    return packages


def api_page(package: str, modules: list[str]) -> str:
    """Return the Markdown page of one package, for mkdocstrings to fill in."""
    return "\n\n".join([f"# {package}", *(f"::: {module}" for module in modules), ""])


def project_page(name: str) -> str:
    """Return a Markdown file of the repository root, its links made relative to docs/."""
    return (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")


def pages() -> dict[str, str]:
    """Return {path below docs/: Markdown} of every generated page."""
    found = {"reference/cli/index.md": cli_index()}
    found |= {f"reference/cli/{verb}.md": verb_page(verb) for verb in verbs()}
    found |= {f"reference/api/{package}.md": api_page(package, modules) for package, modules in api_packages().items()}
    return found | {"contributing.md": project_page("CONTRIBUTING.md"), "changelog.md": project_page("CHANGELOG.md")}


def on_config(config):
    """Fill in the empty sections of the navigation."""
    decisions = sorted(path.name for path in (ROOT / "docs" / "decisions").glob("0*.md"))
    filled = {
        "Command line": ["reference/cli/index.md", *({verb: f"reference/cli/{verb}.md"} for verb in verbs())],
        "Python API": [{package: f"reference/api/{package}.md"} for package in api_packages()],
        "Decisions": ["decisions/index.md", *(f"decisions/{name}" for name in decisions)],
    }
    for section in config.nav:
        for entries in section.values():
            for entry in entries if isinstance(entries, list) else []:
                if isinstance(entry, dict) and (title := next(iter(entry))) in filled:
                    entry[title] = filled[title]
    return config


def on_files(files, config):
    """Add the generated pages."""
    from mkdocs.structure.files import File

    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files
