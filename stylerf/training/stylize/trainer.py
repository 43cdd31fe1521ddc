"""The training loop of all whole-scene stylizations: refit, the method's phases, color matching; checkpoints.

In the refit, a new color with local detail learns the color-matched photos. Then the method trains it; at the end, the
renders' colors are matched to the style image once more.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Generic

import numpy as np

from stylerf.errors import Diverged
from stylerf.training.stylize.scene import Settings_co, StyledScene
from stylerf.training.stylize.settings import REFIT, STYLE, StyleSettings, StyleState


class StyleMethod(Generic[Settings_co]):
    """A method: its phases after the refit, and a step of each. The trainer holds one, which changes `scene`."""

    phases: tuple[str, ...] = (STYLE,)

    def __init__(self, scene: StyledScene[Settings_co]) -> None:
        self.scene = scene

    def refit_step(self) -> dict[str, float]:
        """Take one step of the refit; return the parts of its loss."""
        return self.scene.refit_step()

    def step(self) -> dict[str, float]:
        """Take one step of the current phase after the refit; return the parts of its loss."""
        raise NotImplementedError

    def finish_phase(self) -> None:
        """Finish the current phase, before the next one begins."""

    def start_phase(self, spent: float) -> None:
        """Start state.phase. spent: seconds of the previous phase."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the checkpoint arrays other than the scene's."""
        return {}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore from arrays(); scene and state are already restored."""


KEEP_EVERY = 25  # steps between snapshots; each takes about a tenth of a step


def finite(arrays: dict[str, np.ndarray]) -> bool:
    """Whether all values are finite."""
    return all(np.isfinite(values).all() for values in arrays.values())


class DivergenceGuard:
    """Keeps snapshots in memory only, so a resumed run can roll back no further than to where it was resumed.

    initial: the settings before any rollback; if its `rollbacks` is 0, nothing is kept.
    """

    def __init__(self, initial: StyleSettings) -> None:
        self.initial = initial
        self._snapshot: tuple[StyleState, dict[str, np.ndarray]] | None = None

    def slowed(self, settings: StyleSettings, state: StyleState) -> StyleSettings:
        """Return the settings with the learning rates after the rollbacks counted in `state`."""
        rollbacks = state.counts.get("rollbacks", 0)
        return self.initial.slowed(rollbacks) if rollbacks else settings

    def keep(self, trainer: "StylizationTrainer") -> None:
        """Take a snapshot every KEEP_EVERY steps and at each phase's first step, if all arrays are finite."""
        state, kept = trainer.state, self._snapshot
        if not self.initial.rollbacks or (state.step % KEEP_EVERY and kept and kept[0].phase == state.phase):
            return
        _, arrays = trainer.checkpoint()
        if not finite(arrays):
            return  # a gradient may be non-finite although the loss was finite
        at = StyleState(state.phase, state.step, state.seconds, list(state.curve), dict(state.counts))
        self._snapshot = at, {name: np.array(values, copy=True) for name, values in arrays.items()}

    def roll_back(self, trainer: "StylizationTrainer", parts: dict[str, float]) -> None:
        """Restore the last snapshot, except for the clock; increment the count of rollbacks.

        Raises:
            Diverged: No rollback is left, or there is no snapshot of this phase.
        """
        state = trainer.state
        rollbacks = state.counts.get("rollbacks", 0) + 1
        if rollbacks > self.initial.rollbacks or self._snapshot is None or self._snapshot[0].phase != state.phase:
            raise Diverged(f"{state.phase} step {state.step}: the loss is not finite ({parts})")
        at, arrays = self._snapshot
        counts = {**at.counts, "rollbacks": rollbacks}
        trainer.resume({"state": vars(state) | {"step": at.step, "counts": counts, "curve": list(at.curve)}}, arrays)


class StylizationTrainer:
    """Trains a method's scene until its budget is spent.

    until: Step of the last phase after which to stop early; 0: none.
    between_steps: Whether a checkpoint taken now would be consistent.
    """

    def __init__(self, method: StyleMethod, until: int = 0) -> None:
        self.method, self.scene, self._until = method, method.scene, until
        self.phases = (REFIT, *method.phases)
        self._guard = DivergenceGuard(self.scene.settings)
        self.between_steps = True

    @property
    def state(self) -> StyleState:
        """Progress of the run."""
        return self.scene.state

    @property
    def settings(self) -> StyleSettings:
        """Settings with the current learning rates."""
        return self.scene.settings

    @property
    def _reached(self) -> bool:
        return self._until > 0 and self.state.phase == self.phases[-1] and self.state.step >= self._until

    @property
    def passed(self) -> bool:
        """Whether the run is already past the step at which to stop."""
        return self._reached and self.state.step > self._until

    def run(self, on_step: Callable[["StylizationTrainer"], None] = lambda trainer: None) -> None:
        """Run all phases, calling on_step after every step.

        Raises:
            Diverged: The loss is no longer finite and no rollback is left.
        """
        while self.state.phase != "done":
            timed = False  # a process's first step of a phase compiles kernels
            while self.scene.budget.progress < 1.0 and not self._reached:
                begun, self.between_steps = time.perf_counter(), False
                parts = self.method.refit_step() if self.state.phase == REFIT else self.method.step()
                state = self.state
                # Compilation would use up a short budget and lower the learning rates of all later steps.
                state.seconds += (time.perf_counter() - begun) * timed
                timed = True
                if not all(math.isfinite(v) for v in parts.values()):
                    # The step count is restored too, but not the clock, so that a time budget still ends.
                    self._guard.roll_back(self, parts)
                    continue
                state.step += 1
                if state.step % 10 == 0:
                    rounded = {k: round(v, 5) for k, v in parts.items()}
                    state.curve.append(
                        {"phase": state.phase, "step": state.step, "seconds": round(state.seconds, 2), **rounded}
                    )
                self._guard.keep(self)
                self.between_steps = True
                on_step(self)
            if not finite(self.checkpoint()[1]):  # the last step's result, which no loss has evaluated
                self._guard.roll_back(self, {"values": math.nan})
                continue
            self.next_phase()

    def next_phase(self) -> None:
        """Start the next phase; after the last one, match colors."""
        state, scene = self.state, self.scene
        if state.phase != self.phases[-1]:
            self.between_steps = False  # a checkpoint halfway through this change would match neither phase
            self.method.finish_phase()
            spent = state.seconds
            state.phase, state.step, state.seconds = self.phases[self.phases.index(state.phase) + 1], 0, 0.0
            scene.start_moving()
            self.method.start_phase(spent)
            # On a GPU, new_adam() starts from the host's values, so copy back learned values first.
            scene.collect()
            scene.adam = scene.new_adam()
            self.between_steps = True
            return
        scene.collect()
        if scene.settings.match in ("after", "both"):
            scene.field = replace(scene.field, color_map=scene.match_renders())
        # Last: checkpoints hold no color map, so one from an interrupted match must not be marked as done.
        state.phase = "done"

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """Return (JSON, arrays) to resume from."""
        return {"state": vars(self.state)}, self.scene.arrays() | self.method.arrays()

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """Restore a checkpoint()."""
        self.scene.state = StyleState(**data["state"])
        self.scene.settings = self._guard.slowed(self.settings, self.state)
        self.scene.restore(arrays)
        self.method.restore(arrays)
        self._guard.keep(self)
