"""Messages between the parent and the child process: the job, as JSON, and its progress, a JSON line per event."""

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from schemas.atomic_write import write_json
from schemas.journal import Journal

# In the job's folder: the poses as a COLMAP model, and everything else.
MODEL, RESULT = "model", "result.json"


@dataclass(frozen=True)
class Job:
    """A structure from motion to run.

    Attributes:
        folder: Where the steps are kept.
        photos: Files, sorted by name, which is taken for the order of capture.
        masks: Per photo a mask of what to keep and one of what to hide, empty if absent; () if no photo has any.
        side: Longest side of the copies that are searched for features, pixels.
        features: Most features per photo.
        matching: exhaustive or sequential.
        shared: Photos of one size and zoom share a camera; otherwise each has its own.
        seed: Seed of every RANSAC.
        threads: For features, and processes for matches; the mapper uses one thread, to be reproducible.
        clips: For frames of video the number of each one's clip; () for photos.
        allowance: Bytes of memory that decoding photos may take.
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
    clips: tuple[int, ...] = ()
    allowance: int = 4 << 30

    def write(self, path: Path) -> None:
        """Write the job to `path` as JSON, atomically."""
        write_json(path, asdict(self))

    @staticmethod
    def read(path: Path) -> "Job":
        """Read what `write` wrote."""
        content = json.loads(path.read_text("utf-8", "surrogatepass"))  # file names may contain any bytes
        lists = {"photos": tuple(content["photos"]), "masks": tuple(map(tuple, content["masks"]))}
        return Job(**{**content, **lists, "clips": tuple(content["clips"])})


def journal_of(folder: Path) -> Journal:
    """Return the journal of intact files in the job's folder; files not in it are made again."""
    return Journal(folder / "whole.jsonl", folder)


class JobProgress:
    """Writes events to the parent, on a copy of stdout, since native libraries write to stdout too."""

    def __init__(self, stream: Any = None) -> None:
        self._stream = stream or sys.stdout

    def started(self) -> None:
        """Report that every library is loaded: from here on, a crash may be due to the photos."""
        self._send(event="started")

    def step(self, label: str, total: int, unit: str) -> None:
        """Begin a step of `total` units."""
        self._send(event="step", label=label, total=total, unit=unit)

    def done(self, count: int, note: str = "") -> None:
        """Report that `count` units of the step are finished."""
        self._send(event="done", count=count, note=note)

    def say(self, text: str) -> None:
        """Show the user a line."""
        self._send(event="say", text=text)

    def fault(self, kind: str, text: str) -> None:
        """Report the fault that ends the job, by its class."""
        self._send(event="fault", kind=kind, text=text)

    def _send(self, **event: Any) -> None:
        self._stream.write(json.dumps(event) + "\n")
        self._stream.flush()
