"""A stylization that leaves the finite numbers goes back to where it was last sound, and on at half the rate."""

from typing import Any

import numpy as np

from stylerf.errors import Diverged
from stylerf.training.stylize.settings import StyleSettings, StyleState

KEEP_EVERY = 25  # steps: what is kept is a checkpoint in memory, its copy costs about a tenth of a step


def finite(arrays: dict[str, np.ndarray]) -> bool:
    """Whether every value is."""
    return all(np.isfinite(values).all() for values in arrays.values())


class DivergenceGuard:
    """asked: settings as they were asked for; their `rollbacks` of 0 keeps nothing and never goes back.

    What is kept is in no checkpoint: a resumed run goes back to where it was resumed, or to what it has kept since.
    What it guards has checkpoint() and resume().
    """

    def __init__(self, asked: StyleSettings) -> None:
        self.asked, self.most = asked, asked.rollbacks
        self._kept: tuple[dict, dict[str, np.ndarray]] | None = None

    def paced(self, settings: StyleSettings, state: StyleState) -> StyleSettings:
        """The settings at the rates that are left after as many returns as the state counts."""
        rollbacks = state.counts.get("rollbacks", 0)
        return self.asked.slowed(rollbacks) if rollbacks else settings

    def look(self, loop: Any) -> None:
        """After a step whose loss was finite: keeps the state every KEEP_EVERY steps, if it is finite too."""
        state = loop.state
        if not self.most or (state.step % KEEP_EVERY and self._kept and self._kept[0]["phase"] == state.phase):
            return
        _, arrays = loop.checkpoint()
        if not finite(arrays):
            return  # a gradient may have left the numbers where the loss had not
        kept = {"phase": state.phase, "step": state.step, "counts": dict(state.counts), "told": len(state.curve)}
        self._kept = kept, {name: np.array(values, copy=True) for name, values in arrays.items()}

    def go_back(self, loop: Any, parts: dict[str, float]) -> None:
        """To the last kept state, its time and its count of returns going on; Diverged where that cannot be."""
        state = loop.state
        told = f"{state.phase} step {state.step}: the loss left the finite numbers ({parts})"
        rollbacks = state.counts.get("rollbacks", 0) + 1
        if rollbacks > self.most or self._kept is None or self._kept[0]["phase"] != state.phase:
            raise Diverged(told)
        kept, arrays = self._kept
        counts = {**kept["counts"], "rollbacks": rollbacks}
        there = {"step": kept["step"], "counts": counts, "curve": state.curve[: kept["told"]]}
        loop.resume({"state": vars(state) | there}, arrays)
