"""Rolls a stylization back to its last finite state, at half the learning rate, after a loss that is not finite."""

from typing import Protocol

import numpy as np

from stylerf.errors import Diverged
from stylerf.training.stylize.settings import StyleSettings, StyleState

KEEP_EVERY = 25  # steps between snapshots; copying one takes about a tenth of a step


def finite(arrays: dict[str, np.ndarray]) -> bool:
    """Whether all values are finite."""
    return all(np.isfinite(values).all() for values in arrays.values())


class Resumable(Protocol):
    """What a guard can roll back."""

    @property
    def state(self) -> StyleState: ...

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]: ...

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None: ...


class DivergenceGuard:
    """Keeps snapshots, in memory only: a resumed run can roll back no further than to where it was resumed.

    initial: the settings before any rollback; with `rollbacks` of 0 nothing is kept.
    """

    def __init__(self, initial: StyleSettings) -> None:
        self.initial = initial
        self._snapshot: tuple[StyleState, dict[str, np.ndarray]] | None = None

    def slowed(self, settings: StyleSettings, state: StyleState) -> StyleSettings:
        """The settings at the learning rates left after the rollbacks that the state counts."""
        rollbacks = state.counts.get("rollbacks", 0)
        return self.initial.slowed(rollbacks) if rollbacks else settings

    def keep(self, trainer: Resumable) -> None:
        """Take a snapshot every KEEP_EVERY steps, and at each phase's first step, if all arrays are finite."""
        state, kept = trainer.state, self._snapshot
        if not self.initial.rollbacks or (state.step % KEEP_EVERY and kept and kept[0].phase == state.phase):
            return
        _, arrays = trainer.checkpoint()
        if not finite(arrays):
            return  # a gradient may have spoiled the values although the loss was finite
        at = StyleState(state.phase, state.step, state.seconds, list(state.curve), dict(state.counts))
        self._snapshot = at, {name: np.array(values, copy=True) for name, values in arrays.items()}

    def roll_back(self, trainer: Resumable, parts: dict[str, float]) -> None:
        """Restore the last snapshot; its clock and its count of rollbacks go on.

        Raises:
            Diverged: No rollback is left, or no snapshot of this phase.
        """
        state = trainer.state
        rollbacks = state.counts.get("rollbacks", 0) + 1
        if rollbacks > self.initial.rollbacks or self._snapshot is None or self._snapshot[0].phase != state.phase:
            raise Diverged(f"{state.phase} step {state.step}: the loss is not finite ({parts})")
        at, arrays = self._snapshot
        counts = {**at.counts, "rollbacks": rollbacks}
        trainer.resume({"state": vars(state) | {"step": at.step, "counts": counts, "curve": list(at.curve)}}, arrays)
