"""The loop of every whole-scene stylization: refit, then the method's phases, then color matching; checkpoints.

In the refit a new color with local detail learns the color-matched photos. Then the method teaches it; at the end the
renders' colors are matched to the style image once more.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stylerf.training.stylize.divergence_guard import DivergenceGuard, finite
from stylerf.training.stylize.method import StyleMethod
from stylerf.training.stylize.settings import StyleSettings, StyleState


class StylizationTrainer:
    """Trains a method's scene to the end of its budget.

    between_steps: Whether a checkpoint taken now is of a whole step.
    """

    def __init__(self, method: StyleMethod) -> None:
        self.method, self.scene = method, method.scene
        self.phases = ("refit", *method.phases)
        self._guard = DivergenceGuard(self.scene.settings)
        self.between_steps = True

    @property
    def state(self) -> StyleState:
        """Progress of the run."""
        return self.scene.state

    @property
    def settings(self) -> StyleSettings:
        """Settings at the present learning rates."""
        return self.scene.settings

    def run(self, on_step: Callable[["StylizationTrainer"], None] = lambda trainer: None) -> None:
        """Run all phases, calling on_step after every step.

        Raises:
            Diverged: The loss is no longer finite, and no rollback is left.
        """
        while self.state.phase != "done":
            timed = False  # a process's first step of a phase compiles
            while self.scene.budget.progress < 1.0:
                begun, self.between_steps = time.perf_counter(), False
                parts = self.method.refit_step() if self.state.phase == "refit" else self.method.step()
                state = self.state
                state.seconds += (time.perf_counter() - begun) * timed
                timed = True
                if not all(math.isfinite(v) for v in parts.values()):
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
            if not finite(self.checkpoint()[1]):  # the last step's own result, which no loss has shown
                self._guard.roll_back(self, {"values": math.nan})
                continue
            self.next_phase()

    def next_phase(self) -> None:
        """Leave the present phase; after the last, match colors."""
        state, scene = self.state, self.scene
        if state.phase != self.phases[-1]:
            self.between_steps = False  # half of this change would make a checkpoint of neither phase
            self.method.finish_phase()
            spent = state.seconds
            state.phase, state.step, state.seconds = self.phases[self.phases.index(state.phase) + 1], 0, 0.0
            scene.start_moving()
            self.method.start_phase(spent)
            scene.collect()
            scene.adam = scene.new_adam()
            self.between_steps = True
            return
        scene.collect()
        if scene.settings.match in ("after", "both"):
            scene.field = replace(scene.field, color_map=scene.match_renders())
        # Last: a checkpoint holds no color map, so one of an interrupted match must not be marked as done.
        state.phase = "done"

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) to resume from."""
        return {"state": vars(self.state)}, self.scene.arrays() | self.method.arrays()

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """Restore a checkpoint()."""
        self.scene.state = StyleState(**data["state"])
        self.scene.settings = self._guard.slowed(self.settings, self.state)
        self.scene.restore(arrays)
        self.method.restore(arrays)
        self._guard.keep(self)
