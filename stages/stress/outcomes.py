"""Runs on disk: each in a file of its own, so that a stress goes on where it was interrupted."""

import json
from dataclasses import asdict, fields
from pathlib import Path

from schemas.atomic import write_json
from stages.stress.cells import Outcome

FOLDER = "runs"


def kept_outcome(root: Path, outcome_name: str, key: str) -> Outcome | None:
    """The outcome of that name if it was made under this very key; None where there is none, or a damaged file."""
    path = root / FOLDER / f"{outcome_name}.json"
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    if not isinstance(content, dict) or content.keys() != {item.name for item in fields(Outcome)}:
        return None
    return Outcome(**content) if content["key"] == key else None


def keep_outcome(root: Path, outcome: Outcome) -> None:
    """In one atomic write."""
    write_json(root / FOLDER / f"{outcome.name}.json", asdict(outcome))
