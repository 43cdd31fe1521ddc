"""The loop of training stages: checkpoints at intervals and on Ctrl-C, resuming, faults as errors."""

import json
import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from schemas.atomic_write import sync_folder
from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged, BadInput
from schemas.safe_reading import parsed, sound
from schemas.tensors import load_tensors, save_tensors_with_digest
from schemas.work_folder import PartialArtifact
from stages.run.progress import Context
from stylerf.errors import Diverged

KEPT = 2
_NAME = re.compile(r"(\d{6,})-([0-9a-f]{64})\.safetensors")  # number, SHA-256 of the bytes


def save_checkpoint(folder: Path, data: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Save state and arrays, keeping the checkpoint before.

    Both go to one file, `NUMBER-SHA256.safetensors`, so that a kill cannot leave state and arrays of different steps.
    """
    earlier = _kept(folder)
    number = earlier[0][0] + 1 if earlier else 1
    # The final name holds the digest, known only once all is written; _kept() ignores this one.
    writing = folder / "writing.safetensors"
    digest = save_tensors_with_digest(writing, arrays, {"state": json.dumps(data)})
    os.replace(writing, folder / f"{number:06d}-{digest}.safetensors")
    sync_folder(folder)
    # Deleted last, so that a kill leaves one too many, never one too few.
    for _, _, path in earlier[KEPT - 1 :]:
        path.unlink(missing_ok=True)


def load_checkpoint(folder: Path, say: Callable[[str], None]) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Load the newest undamaged checkpoint.

    Args:
        folder: where checkpoints are kept.
        say: receives one line for each damaged checkpoint.

    Returns:
        State and arrays, or None without a checkpoint.

    Raises:
        OSError: a checkpoint cannot be read; it may be undamaged.
    """
    found = _kept(folder)
    for place, (_, digest, path) in enumerate(found):
        if file_sha256(path) == digest:
            arrays, metadata = load_tensors(path)
            return parsed(metadata.get("state", ""), str(path), ArtifactDamaged), arrays
        rest = "using the one before it" if place + 1 < len(found) else "starting over"
        say(f"checkpoint {path.name[:6]} is damaged; {rest}")
    return None


def _kept(folder: Path) -> list[tuple[int, str, Path]]:
    """Return number, digest and path of each checkpoint, newest first."""
    matches = [(_NAME.fullmatch(path.name), path) for path in folder.glob("*.safetensors")]
    return sorted(((int(match[1]), match[2], path) for match, path in matches if match), reverse=True)


Step = TypeVar("Step")
Step_co = TypeVar("Step_co", covariant=True)


class Resumable(Protocol):
    """A trainer that can start from a checkpoint."""

    def resume(self, data: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        """Take over state and arrays."""


def resumed(trainer: Resumable, partial: PartialArtifact, context: Context) -> bool:
    """Resume from the newest undamaged checkpoint, in every process; return whether there was one.

    Raises:
        ArtifactDamaged: the checkpoint is not one of this trainer.
    """
    processes = context.processes
    # Only the first reads the disk: others may be on other machines.
    saved = processes.checkpoint(load_checkpoint(partial.checkpoint, context.progress.say) if processes.first else None)
    if saved is None:
        return False
    with sound(partial.checkpoint, "a sound checkpoint"):
        trainer.resume(*saved)
    return True


class Trainer(Protocol[Step_co]):
    """The trainer that the loop runs. between_steps: whether the state is that of complete steps."""

    @property
    def between_steps(self) -> bool: ...

    def run(self, on_step: Callable[[Step_co], None]) -> Any:
        """Train to the end of the budget, calling `on_step` after each step."""

    def checkpoint(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return state and arrays to resume from."""
        ...


def run_training(
    trainer: Trainer[Step],
    what: str,
    every: float,
    partial: PartialArtifact,
    context: Context,
    report: Callable[[Step], None],
) -> None:
    """Train to the end.

    Args:
        what: its name in errors.
        every: seconds between checkpoints.
        partial: the artifact in progress, which keeps the checkpoints.
        context: the first of its processes saves; its progress is closed at the end.
        report: shows progress after each step.

    Raises:
        BadInput: the training diverged.
    """
    saved_at = time.monotonic()

    def save() -> None:
        nonlocal saved_at
        # State and values are the same in every process; followers have no folder to write to.
        if context.processes.first:
            save_checkpoint(partial.checkpoint, *trainer.checkpoint())
        saved_at = time.monotonic()

    def on_step(step: Step) -> None:
        report(step)
        if time.monotonic() - saved_at > every:
            save()

    try:
        trainer.run(on_step)
    except KeyboardInterrupt:
        # An interrupted step may have left half a gradient: save only complete steps.
        if trainer.between_steps:
            save()
        raise
    except Diverged as error:
        raise BadInput(f"{what} does not converge: {error}") from error
    finally:
        context.progress.finish()
