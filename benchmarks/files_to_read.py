"""How many files a reader must open to follow a command: `python -m benchmarks.files_to_read PHOTOS OUT.json`.

`stylerf fit` and `stylerf stylize --method arf` are run on a few small photos on the CPU, recording every function of
the project that is actually called and every class that is instantiated. Code that only runs on import is excluded:
nobody reads it to follow the command. Calls of compiled kernels cannot be recorded, so kernels in stylerf/kernels/cpu
are followed statically from the functions that were called. OUT.json holds, for each command, the number of files,
their lines, and their names.
"""

import ast
import json
import sys
import tempfile
import threading
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("stylerf_cli", "stages", "schemas", "stylerf")
KERNELS = ROOT / "stylerf" / "kernels" / "cpu"


def while_importing(frame: Any) -> bool:
    """Whether a module of the project is being imported further up the call stack."""
    while frame is not None:
        code = frame.f_code
        if code.co_name == "<module>" and code.co_filename.startswith(tuple(f"{ROOT}/{one}/" for one in PACKAGES)):
            return True
        frame = frame.f_back
    return False


class Recorder:
    """Collects (file, function) for every call of the project's code."""

    def __init__(self) -> None:
        self.called: set[tuple[str, str]] = set()

    def __call__(self, frame: Any, event: str, argument: Any) -> None:
        if event != "call":
            return
        code = frame.f_code
        path, name = code.co_filename, code.co_qualname.split(".<locals>")[0]
        if path == "<string>" and code.co_name in {"__init__", "__new__"}:  # of a dataclass or a NamedTuple
            one = frame.f_locals[code.co_varnames[0]]
            made = one if isinstance(one, type) else type(one)
            path, name = getattr(sys.modules.get(made.__module__), "__file__", None) or "", made.__qualname__
        if path.startswith(str(ROOT)) and (path, name) not in self.called and not while_importing(frame):
            self.called.add((path, name))

    def run(self, *command: Any) -> set[tuple[str, str]]:
        """Return the calls made by one command."""
        from stylerf_cli.main import main

        self.called = set()
        threading.setprofile(self)
        sys.setprofile(self)
        try:
            code = main([str(word) for word in command])
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
        assert not code, f"{command} ends with {code}"
        return {(path, name) for path, name in self.called if Path(path).relative_to(ROOT).parts[0] in PACKAGES}


@cache
def parsed(path: Path) -> tuple[dict[str, ast.AST], dict[str, tuple[Path, str]]]:
    """Return (top-level definitions and methods by qualified name, imports as (file, name; "" for the module))."""
    tree = ast.parse(path.read_text())
    found: dict[str, ast.AST] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found[node.name] = node
            found |= {f"{node.name}.{one.name}": one for one in ast.walk(node) if isinstance(one, ast.FunctionDef)}
        elif isinstance(node, ast.Assign):
            found |= {one.id: node for one in node.targets if isinstance(one, ast.Name)}
    imported: dict[str, tuple[Path, str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for one in node.names:
                for module, name in ((f"{node.module}.{one.name}", ""), (node.module, one.name)):
                    file = (ROOT / module.replace(".", "/")).with_suffix(".py")
                    if file.is_file():
                        imported[one.asname or one.name] = (file, name)
                        break
    return found, imported


def kernels_of(called: set[tuple[str, str]]) -> set[Path]:
    """Return the files of the CPU kernels that these functions use, directly or through other kernels."""
    waiting, seen, files = [(Path(path), name) for path, name in called], set(), set()
    while waiting:
        path, name = waiting.pop()
        definitions, imported = parsed(path)
        if (path, name) in seen or name not in definitions:
            continue
        seen.add((path, name))
        if path.parent == KERNELS:
            files.add(path)
        for node in ast.walk(definitions[name]):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in imported:
                target, inner = imported[node.value.id]
                used = (target, inner or node.attr)
            elif isinstance(node, ast.Name) and node.id in imported:
                used = imported[node.id]
            elif isinstance(node, ast.Name) and path.parent == KERNELS:
                used = (path, node.id)
            else:
                continue
            if used[0].parent == KERNELS:
                waiting.append(used)
    return files


def main() -> int:
    photos, out = Path(sys.argv[1]), Path(sys.argv[2])
    style = ROOT / "docs" / "images" / "demo.png"
    recorder, result = Recorder(), {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "work"
        common = ("--quiet", "--device", "cpu", "--threads", "2")
        recorder.run("import", photos, work, "--max-side", "64", *common)
        commands = {
            "fit": ("fit", work, "--budget", "60", *common),
            "stylize --method arf": ("stylize", work, "--style", style, "--method", "arf", "--budget", "10", *common),
        }
        for title, command in commands.items():
            called = recorder.run(*command)
            files = sorted({Path(path) for path, _ in called} | kernels_of(called))
            lines = sum(len(file.read_text().splitlines()) for file in files)
            names = [file.relative_to(ROOT).as_posix() for file in files]
            result[title] = {"files": len(files), "lines": lines, "names": names}
            print(f"{title}: {len(files)} files of {lines} lines")
    out.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
