"""Runs on disk: each in a file of its own, so that a stress goes on where it was interrupted."""

import json
from dataclasses import asdict, fields
from pathlib import Path

from schemas.atomic import write_json
from stages.stress.cells import Outcome

FOLDER = "runs"


def kept_outcome(root: Path, run: str, key: str) -> Outcome | None:
    """The outcome of the run of that name if it was made under this very key; None without one, or a damaged file."""
    for name in (run, run.rpartition("--")[0]):  # files of before had no key in their name
        try:
            content = json.loads((root / FOLDER / f"{name}.json").read_text())
        except (OSError, ValueError):
            continue
        sound = isinstance(content, dict) and content.keys() == {item.name for item in fields(Outcome)}
        if sound and content["key"] == key:
            return Outcome(**content)
    return None


def keep_outcome(root: Path, outcome: Outcome) -> None:
    """In one atomic write."""
    write_json(root / FOLDER / f"{outcome.name}.json", asdict(outcome))
