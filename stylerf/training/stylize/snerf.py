"""Stylize a whole scene by turns (SNeRF, Nguyen-Phuoc et al. 2022): its pictures in 2D, then the field on the pictures.

A round: views as they are now rendered are painted in 2D, each by itself, for `image_share` of the round; then the
colors learn these pictures by their mean squared error, for the rest of it. The budget is shared by `rounds`. What the
pictures disagree about is evened out by the field, from whose renders the next round's pictures start. Never are a
trunk's graph and a field's samples in memory together.

A step is one picture painted (`image_steps` evaluations of the loss), or one step of the field. Views are taken in turn
from round to round: where a round is too short for all of them, the others keep the picture that they had; where there
is time for more, pictures are painted on from where they are, in smaller and smaller steps. Of a budget of steps, the
pictures' turn takes no more than the field's, and no more than there are views.
"""

import time

import numpy as np

from stylerf.style.image_optimization import painted
from stylerf.training.stylize.trainer import StylizationTrainer


class SnerfTrainer(StylizationTrainer):
    """Shapes are held fast. The loss of a picture is that of the objective, its content the matched photo's."""

    def __init__(self, *given, **more) -> None:
        self.targets: dict[int, np.ndarray] = {}  # [h, w, 3] uint8, as a picture file would keep them
        self._visits: dict[int, tuple[int, int]] = {}  # the round in which each was begun, times painted in it
        super().__init__(*given, **more)

    @property
    def paints(self) -> bool:
        """Whether it is the pictures' turn."""
        s = self.settings
        share = min(s.image_share, 0.5, len(self.cameras) * s.rounds / s.steps) if s.steps else s.image_share
        return self.progress * s.rounds % 1.0 < share or not self.targets

    @property
    def left_of_turn(self) -> float:
        """Seconds until the pictures' turn ends, of a budget of time."""
        s, rounds = self.settings, self.progress * self.settings.rounds
        return (int(rounds) + s.image_share - rounds) * s.seconds / s.rounds

    def _step(self) -> dict[str, float]:
        return self.picture_step() if self.paints else self.field_step()

    def picture_step(self) -> dict[str, float]:
        """Paints the next view, from its present render or on from this round's picture; the parts of its loss."""
        s, made = self.settings, self.state.counts.get("pictures", 0)
        epoch, at = divmod(made, len(self.cameras))
        view = int(np.random.default_rng([self.seed, 3, epoch]).permutation(len(self.cameras))[at])
        alpha = self.geometry.alpha(view)
        now = int(self.progress * s.rounds)
        begun, visits = self._visits.get(view, (now, 0))
        visits = visits if begun == now else 0
        if visits:
            rgb = self.targets[view].astype(np.float32) / 255
        else:
            rgb = self.paint_view(view).reshape(*alpha.shape, 3) + (1 - alpha[..., None]) * self.background
        coverage, content = self._alpha_there(view), self._content_of(view)

        def loss(picture):
            return self.objective(picture, content, coverage, self.windows[view])

        # However slow the machine, the field has its turn.
        ends = time.perf_counter() + self.left_of_turn
        found, parts = painted(
            self._there(rgb), coverage, float(self.background), loss, s.image_steps, s.image_rate / (1 + visits),
            lambda: not s.steps and time.perf_counter() > ends,
        )  # fmt: skip
        self.targets[view], self._visits[view] = np.rint(found * 255).astype(np.uint8), (now, visits + 1)
        self.state.counts["pictures"] = made + 1
        return parts

    def field_step(self) -> dict[str, float]:
        """The colors towards one of the pictures; the mean squared error."""
        s = self.settings
        generator = np.random.default_rng([self.seed, 5, self.state.step])
        view = sorted(self.targets)[int(generator.integers(len(self.targets)))]
        error = self._learn_image(view, self.targets[view].astype(np.float32) / 255, generator)
        if error is None:
            return {"mse": 0.0}
        self.adam.step(s.rate * s.final_rate**self.progress)
        return {"mse": error}

    def _own_arrays(self) -> dict[str, np.ndarray]:
        arrays = {f"target.{view}": picture.copy() for view, picture in self.targets.items()}
        return arrays | {f"visits.{view}": np.asarray(visits) for view, visits in self._visits.items()}

    def _restore_own(self, arrays: dict[str, np.ndarray]) -> None:
        self.targets = {int(k[7:]): v.copy() for k, v in arrays.items() if k.startswith("target.")}
        self._visits = {int(k[7:]): (int(v[0]), int(v[1])) for k, v in arrays.items() if k.startswith("visits.")}
