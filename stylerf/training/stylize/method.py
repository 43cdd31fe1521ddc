"""What a stylization method offers the trainer."""

import numpy as np

from stylerf.training.stylize.scene import StyledScene


class StyleMethod:
    """A method: its phases after the refit, and a step of each. The trainer holds one; `scene` is what it changes."""

    phases: tuple[str, ...] = ("style",)

    def __init__(self, scene: StyledScene) -> None:
        self.scene = scene

    def refit_step(self) -> dict[str, float]:
        """Take one step of the refit; the parts of its loss."""
        return self.scene.refit_step()

    def step(self) -> dict[str, float]:
        """Take one step of the present phase after the refit; the parts of its loss."""
        raise NotImplementedError

    def finish_phase(self) -> None:
        """Finish the present phase, before the next begins."""

    def start_phase(self, spent: float) -> None:
        """Start state.phase. spent: seconds of the phase before."""

    def arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs beside the scene's."""
        return {}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """From arrays(); scene and state are restored."""
