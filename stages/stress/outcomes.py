"""Runs on disk: each in a file of its own, so that a stress goes on where it was interrupted."""

from dataclasses import asdict, fields
from pathlib import Path

from schemas.atomic_write import write_json
from schemas.errors import BadInput
from schemas.safe_names import file_name
from schemas.safe_reading import read_json
from stages.configs.faults import FAULTS, METHODS
from stages.evaluation.metrics import is_number
from stages.stress.success_rates import Outcome

FOLDER = "runs"
NOT_FINITE = ("inf", "-inf", "nan")  # as schemas.canonical writes them


def kept_outcome(root: Path, run: str, key: str) -> Outcome | None:
    """The outcome of the run of that name if it was made under this very key; None without one, or a damaged file.

    Such a file may be a stranger's: every value is of its own kind, and the picture is one beside the others.
    """
    for name in (run, run.rpartition("--")[0]):  # files of before had no key in their name
        try:
            found = _outcome(read_json(root / FOLDER / f"{name}.json"))
        except (OSError, BadInput):
            continue
        if found.key == key:
            return found
    return None


def _outcome(content: object) -> Outcome:
    if not isinstance(content, dict) or content.keys() != {item.name for item in fields(Outcome)}:
        raise BadInput("not what a run of stress leaves")
    found = Outcome(**content)
    texts = (found.key, found.method, found.fault, found.why, found.picture)
    flags = (found.remedies, found.ok)
    numbers = [found.seconds, *([] if found.score is None else [found.score])]
    sound = (
        all(isinstance(one, str) for one in texts)
        and all(isinstance(one, bool) for one in flags)
        and type(found.seed) is int
        and isinstance(found.figures, dict)
        and all(map(is_number, numbers))
        and all(is_number(one) or one in NOT_FINITE for one in found.figures.values())
        and found.method in METHODS
        and found.fault in FAULTS
    )
    if not sound:
        raise BadInput("a value of another kind than a run of stress leaves")
    if found.picture:
        file_name(found.picture, "picture", BadInput)
    return found


def keep_outcome(root: Path, outcome: Outcome) -> None:
    """In one atomic write."""
    write_json(root / FOLDER / f"{outcome.name}.json", asdict(outcome))
