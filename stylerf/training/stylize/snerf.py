"""Stylize a scene by alternation (SNeRF, Nguyen-Phuoc et al. 2022): views as images, then the field on these images.

In each round, rendered views are optimized as 2D images, each by itself, for `image_share` of the round; then the
colors learn these images by their mean squared error. The field evens out what the images disagree about, and its
renders start the next round's images. The extractor's graph and a field's samples are never in memory together.

A step optimizes one image (`image_steps` evaluations of the loss), or is one step of the field. Views take turns across
rounds: if a round is too short for all, the others keep their image; if there is time for more, images are optimized
further, in ever smaller steps. With a budget of steps, images take at most half of them, and each view one per round.
"""

import time

import numpy as np

from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.image_stylization import painted
from stylerf.training.stylize.arf import ViewLoss
from stylerf.training.stylize.scene import StyledScene
from stylerf.training.stylize.settings import SnerfSettings
from stylerf.training.stylize.trainer import StyleMethod


class Snerf(StyleMethod[SnerfSettings]):
    """SNeRF. images: by view, [h, w, 3] uint8, as an image file would hold them."""

    def __init__(self, scene: StyledScene[SnerfSettings], extractor: FeatureExtractor) -> None:
        super().__init__(scene)
        self.loss = ViewLoss(scene, extractor)
        self.images: dict[int, np.ndarray] = {}
        self._visits: dict[int, tuple[int, int]] = {}  # by view: round in which its image began, visits in that round

    @property
    def optimizes_images(self) -> bool:
        """Whether the next step is one of images."""
        s, progress, views = self.scene.settings, self.scene.budget.progress, len(self.scene.cameras)
        # `% 1`: the place within the round. The field needs at least one image to learn from.
        share = min(s.image_share, 0.5, views * s.rounds / s.steps) if s.steps else s.image_share
        return progress * s.rounds % 1.0 < share or not self.images

    @property
    def seconds_left_for_images(self) -> float:
        """Seconds until this round turns to the field, with a budget of time."""
        s = self.scene.settings
        rounds = self.scene.budget.progress * s.rounds
        return (int(rounds) + s.image_share - rounds) * s.seconds / s.rounds

    def step(self) -> dict[str, float]:
        return self.image_step() if self.optimizes_images else self.field_step()

    def image_step(self) -> dict[str, float]:
        """Optimize the next view's image, from its render or from this round's image; the parts of its loss."""
        scene, s, counts = self.scene, self.scene.settings, self.scene.state.counts
        made, views = counts.get("pictures", 0), len(scene.cameras)
        epoch, at = divmod(made, views)
        view = int(np.random.default_rng([scene.problem.seed, 3, epoch]).permutation(views)[at])
        this_round = int(scene.budget.progress * s.rounds)
        begun, visits = self._visits.get(view, (this_round, 0))
        visits = visits if begun == this_round else 0
        rgb = self.images[view].astype(np.float32) / 255 if visits else scene.render_over(view)
        # However slow the machine, the field gets its share of the round.
        end = time.perf_counter() + self.seconds_left_for_images
        image, parts = painted(
            self.loss.to_device(rgb), self.loss.coverage(view), float(scene.background), self.loss.of_view(view),
            s.image_steps, s.image_rate / (1 + visits), lambda: not s.steps and time.perf_counter() > end,
        )  # fmt: skip
        # Rounded as the checkpoint holds it, so that a resumed run continues from the same image.
        self.images[view], self._visits[view] = np.rint(image * 255).astype(np.uint8), (this_round, visits + 1)
        counts["pictures"] = made + 1
        return parts

    def field_step(self) -> dict[str, float]:
        """Take one step of the colors towards one of the images; its mean squared error."""
        scene, s = self.scene, self.scene.settings
        generator = np.random.default_rng([scene.problem.seed, 5, scene.state.step])
        view = sorted(self.images)[int(generator.integers(len(self.images)))]
        error = scene.learn_image(view, self.images[view].astype(np.float32) / 255, generator)
        if error is None:
            return {"mse": 0.0}
        scene.adam.step(s.rate * s.final_rate**scene.budget.progress)
        return {"mse": error}

    def arrays(self) -> dict[str, np.ndarray]:
        arrays = {f"target.{view}": image.copy() for view, image in self.images.items()}
        return arrays | {f"visits.{view}": np.asarray(visits) for view, visits in self._visits.items()}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        self.images = {int(k[7:]): v.copy() for k, v in arrays.items() if k.startswith("target.")}
        self._visits = {int(k[7:]): (int(v[0]), int(v[1])) for k, v in arrays.items() if k.startswith("visits.")}
