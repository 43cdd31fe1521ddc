"""How stages run what trains: checkpoints every so often and at Ctrl-C, faults in words."""

import time
from collections.abc import Callable
from typing import Any

from schemas.errors import BadInput
from schemas.work_folder import PartialArtifact
from stages.run.checkpoints import save_checkpoint
from stages.run.progress import Context
from stylerf.errors import Diverged


def run_training(
    trainer: Any, what: str, every: float, partial: PartialArtifact, context: Context, tell: Callable[[Any], None]
) -> None:
    """Calls `trainer.run` and brings it to its end.

    trainer: has run(on_step), checkpoint() and between_steps. what: is named where it does not converge, which is
    BadInput. every: seconds between checkpoints. tell: shows how far the trainer is, after each step.
    """
    saved_at = time.monotonic()

    def save() -> None:
        nonlocal saved_at
        if context.ranks.first:
            save_checkpoint(partial.checkpoint, *trainer.checkpoint())
        saved_at = time.monotonic()

    def on_step(now: Any) -> None:
        tell(now)
        if time.monotonic() - saved_at > every:
            save()

    try:
        trainer.run(on_step)
    except KeyboardInterrupt:
        # The step that was cut short may have left half a gradient: only whole steps are saved.
        if trainer.between_steps:
            save()
        raise
    except Diverged as error:
        raise BadInput(f"{what} does not converge: {error}") from error
    finally:
        context.progress.finish()
