"""What the parent asks of the child process, and how the child tells what it does: JSON, a line at a time."""

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from schemas.atomic_write import write_json
from schemas.journal import Journal

# What the child leaves in the folder of the job: the poses as a COLMAP model, and all else.
MODEL, RESULT = "model", "result.json"


@dataclass(frozen=True)
class Job:
    """folder: where steps are kept. photos: files, in the order that they were taken in as far as names tell. masks: of
    each photo the one that keeps and the one that hides, empty where it has none; () where no photo has any.

    side: longest side in pixels of the copies that are searched for features; features: at most so many per photo.
    matching: exhaustive or sequential. shared: one camera for photos of one size and zoom, else one each. seed: of
    every RANSAC. threads: for features and matches; the mapper takes one, so that it is reproducible.
    """

    folder: str
    photos: tuple[str, ...]
    masks: tuple[tuple[str, str], ...] = ()
    side: int = 1600
    features: int = 4096
    matching: str = "exhaustive"
    shared: bool = True
    seed: int = 0
    threads: int = 2

    def write(self, path: Path) -> None:
        """As JSON at `path`, in one step."""
        write_json(path, asdict(self))

    @staticmethod
    def read(path: Path) -> "Job":
        """What `write` wrote."""
        content = json.loads(path.read_text("utf-8", "surrogatepass"))  # names of files may be of any bytes
        return Job(**{**content, "photos": tuple(content["photos"]), "masks": tuple(map(tuple, content["masks"]))})


def journal_of(folder: Path) -> Journal:
    """Which files in the job's folder are whole; what it does not hold is made again."""
    return Journal(folder / "whole.jsonl", folder)


class JobProgress:
    """Writes events to the parent. Native libraries write to stdout too, so the channel is a copy made before them."""

    def __init__(self, stream: Any = None) -> None:
        self._stream = stream or sys.stdout

    def step(self, label: str, total: int, unit: str) -> None:
        """A step of `total` units begins."""
        self._tell(event="step", label=label, total=total, unit=unit)

    def done(self, count: int, note: str = "") -> None:
        """`count` units of the step are finished."""
        self._tell(event="done", count=count, note=note)

    def say(self, text: str) -> None:
        """A line for the user."""
        self._tell(event="say", text=text)

    def fault(self, kind: str, text: str) -> None:
        """The job ends here; kind: class of the fault."""
        self._tell(event="fault", kind=kind, text=text)

    def _tell(self, **event: Any) -> None:
        self._stream.write(json.dumps(event) + "\n")
        self._stream.flush()
