"""Digests of what a source tree computes, to compare two trees: `python -m benchmarks.same_bits DATA OUT.json`.

Fits, stylizations by every method and a local edit, all with budgets in steps, on two CPU threads. Each line of the
result has the sorted SHA-256 digests of one artifact's arrays, regardless of their names, and the seconds it took. Two
trees compute the same bits where their files agree:

    python -m benchmarks.same_bits DATA before.json      # in one tree
    python -m benchmarks.same_bits DATA after.json       # in the other
    python -m benchmarks.same_bits --compare before.json after.json
"""

import hashlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

COMMON = ("--threads", "2", "--device", "cpu", "--seed", "0", "--quiet")
SCENES = {"lego": ("100", "400"), "fern": ("200", "400")}  # longer side, steps of the fit
METHODS = ("arf", "desrf", "snerf", "refnpr")


def main() -> int:
    if sys.argv[1] == "--compare":
        return compare(*(json.loads(Path(name).read_text()) for name in sys.argv[2:4]))
    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    style = sorted(path for path in (data / "styles").iterdir() if path.suffix in (".jpg", ".png"))[0]
    result: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as folder:
        for scene, (side, steps) in SCENES.items():
            work = Path(folder) / scene
            run("import", data / scene, work, "--max-side", side)
            result[f"{scene} fit"] = timed(work, "field", "fit", "fit", work, "--budget", steps, "--no-buffers")
            for method in METHODS:
                command = ("stylize", work, "--style", style, "--method", method, "--budget", "30", "--name", method)
                result[f"{scene} {method}"] = timed(work, "field", method, *command)
            command = ("stylize", work, "--method", "palettenerf", "--budget", "60", "--name", "palette")
            result[f"{scene} palettenerf"] = timed(work, "field", "palette", *command)
        work, view = Path(folder) / "lego", first_view(Path(folder) / "lego")
        for kind, name, command in edit_commands(work, view):
            result[f"lego {kind}"] = timed(work, kind, name, *command)
    out.write_text(json.dumps(result, indent=1) + "\n")
    return 0


def edit_commands(work: Path, view: str) -> list[tuple[str, str, tuple]]:
    """Return kind, name and command of each artifact of a local edit, with budgets in steps: `edit` takes seconds."""
    steps = ("--palette-steps", "40", "--pruned-steps", "10", "--budget", "10m")
    look = ("--region", "part", "--recolor", "--palette", "0=#c03020", *steps, "--name", "look")
    return [
        ("region", "part", ("select", work, "--at", f"{view}:50,50", "--name", "part")),
        ("edit-dataset", "part", ("extract", work, "--region", "part")),
        ("edit", "look", ("stylize", work, *look)),
        ("field", "local", ("finetune", work, "--edit", "look", "--budget", "30", "--name", "local")),
    ]


def run(*arguments) -> None:
    """Run one command of this tree."""
    command = [sys.executable, "-m", "stylerf_cli.main", *map(str, arguments), *COMMON]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def timed(work: Path, kind: str, name: str, *command) -> dict:
    """Run a command; return the sorted digests of its artifact's arrays, and its seconds."""
    begun = time.monotonic()
    run(*command)
    seconds = round(time.monotonic() - begun, 1)
    files = sorted((work / kind / name).glob("*.safetensors"))
    arrays = [np.ascontiguousarray(array) for path in files for array in load_file(path).values()]
    return {"arrays": sorted(hashlib.sha256(array).hexdigest() for array in arrays), "seconds": seconds}


def first_view(work: Path) -> str:
    """Return the name of a training view of a scene."""
    views = json.loads((work / "scene" / "main" / "scene.json").read_text())["views"]
    return next(one["name"] for one in views if one["split"] == "train")


def compare(before: dict, after: dict) -> int:
    """Print for each artifact whether its bits agree, and the ratio of seconds; return 1 if any differs."""
    for name in sorted(before.keys() | after.keys()):
        one, other = before.get(name), after.get(name)
        same = one is not None and other is not None and one["arrays"] == other["arrays"]
        ratio = f"{other['seconds'] / one['seconds']:.2f}" if one and other else "-"
        print(f"{name:20} {'same bits' if same else 'DIFFERENT'}  seconds after/before {ratio}")
    return int(any(before.get(name, {}).get("arrays") != after.get(name, {}).get("arrays") for name in before | after))


if __name__ == "__main__":
    sys.exit(main())
