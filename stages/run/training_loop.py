"""The loop of stages that train: checkpoints at intervals and on Ctrl-C, faults as errors."""

import time
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import PartialArtifact
from stages.run.checkpoints import save_checkpoint
from stages.run.progress import Context
from stylerf.errors import Diverged

Step = TypeVar("Step")
Step_co = TypeVar("Step_co", covariant=True)


class Trainer(Protocol[Step_co]):
    """What the loop runs. between_steps: whether the state is that of whole steps."""

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
        trainer: what is trained.
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
        # An interrupted step may have left half a gradient: save whole steps only.
        if trainer.between_steps:
            save()
        raise
    except Diverged as error:
        raise BadInput(f"{what} does not converge: {error}") from error
    finally:
        context.progress.finish()
