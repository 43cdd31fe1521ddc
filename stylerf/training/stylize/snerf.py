"""Stylize a scene by alternation (SNeRF, Nguyen-Phuoc et al. 2022): views as images, then the field on these images.

In each round, rendered views are individually optimized as 2D images for `image_share` of the round; then the colors
are trained on these images with the mean squared error. The field averages out inconsistencies between the images, and
its renders initialize the next round's images. The extractor's graph and a field's samples never coexist in memory.

A step either optimizes one image (`image_steps` evaluations of the loss) or trains the field once. Views take turns
across rounds: if a round is too short for all, the others keep their image; if there is time left, images are optimized
further, in ever smaller steps. With a step budget, images take at most half of the steps, and each view one per round.
With a time budget, an image that exceeds the rest of its round is still followed by training of the field.
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
    """SNeRF. images: [h, w, 3] uint8 by view, as in an image file."""

    def __init__(self, scene: StyledScene[SnerfSettings], extractor: FeatureExtractor) -> None:
        super().__init__(scene)
        self.loss = ViewLoss(scene, extractor)
        self.images: dict[int, np.ndarray] = {}
        self._visits: dict[int, tuple[int, int]] = {}  # by view: round in which its image began, visits in it
        self._last_image = 0, -1  # round and step of the last image step
        self._evaluation = 0.0  # last measured time of an evaluation of the images' loss, seconds

    @property
    def optimizes_images(self) -> bool:
        """Whether the next step optimizes an image."""
        s, progress, views = self.scene.settings, self.scene.budget.progress, len(self.scene.cameras)
        if not self.images:
            return True  # the field needs at least one image
        share = min(s.image_share, 0.5, views * s.rounds / s.steps) if s.steps else s.image_share
        place = progress * s.rounds
        if place % 1.0 >= share:
            return False
        # If an image takes longer than its round, the field gets a turn before the next round's images.
        in_round, at = self._last_image
        if int(place) > in_round and self.scene.state.step == at + 1:
            return False
        # A single evaluation must not take the field's share of the last round.
        reserved = (1 - s.image_share) * s.seconds / s.rounds
        return s.steps > 0 or (1 - progress) * s.seconds >= self._evaluation + reserved

    @property
    def seconds_left_for_images(self) -> float:
        """Seconds left for images in this round, for a time budget."""
        s = self.scene.settings
        rounds = self.scene.budget.progress * s.rounds
        return (int(rounds) + s.image_share - rounds) * s.seconds / s.rounds

    def step(self) -> dict[str, float]:
        return self.image_step() if self.optimizes_images else self.field_step()

    def image_step(self) -> dict[str, float]:
        """Optimize the next view's image, from its render or this round's image; return the parts of its loss."""
        scene, s, counts = self.scene, self.scene.settings, self.scene.state.counts
        made, views = counts.get("pictures", 0), len(scene.cameras)
        epoch, at = divmod(made, views)
        view = int(np.random.default_rng([scene.problem.seed, 3, epoch]).permutation(views)[at])
        this_round = int(scene.budget.progress * s.rounds)
        begun, visits = self._visits.get(view, (this_round, 0))
        visits = visits if begun == this_round else 0
        rgb = self.images[view].astype(np.float32) / 255 if visits else scene.render_over(view)
        end = time.perf_counter() + self.seconds_left_for_images
        given = self.loss.to_device(rgb), self.loss.coverage(view), float(scene.background), self.loss.of_view(view)
        times = [time.perf_counter()]

        def enough() -> bool:
            times.append(time.perf_counter())
            return not s.steps and times[-1] > end

        image, parts = painted(*given, s.image_steps, s.image_rate / (1 + visits), enough)
        self._evaluation = float(np.diff(times).min())  # slower ones may include compilation
        # Rounded as in a checkpoint, so that a resumed run continues from the same image.
        self.images[view], self._visits[view] = np.rint(image * 255).astype(np.uint8), (this_round, visits + 1)
        self._last_image = this_round, scene.state.step
        counts["pictures"] = made + 1
        return parts

    def field_step(self) -> dict[str, float]:
        """Take one step of the colors on one of the images; return the mean squared error."""
        scene, s = self.scene, self.scene.settings
        generator = np.random.default_rng([scene.problem.seed, 5, scene.state.step])
        view = sorted(self.images)[int(generator.integers(len(self.images)))]
        image, count = self.images[view].astype(np.float32) / 255, scene.settings.refit_pixels
        error = scene.learn_image(view, image, generator, count)
        if error is None:
            return {"mse": 0.0}
        scene.adam.step(s.rate * s.final_rate**scene.budget.progress)
        return {"mse": error}

    def arrays(self) -> dict[str, np.ndarray]:
        arrays = {f"target.{view}": image.copy() for view, image in self.images.items()}
        arrays["last_image"] = np.asarray(self._last_image)
        return arrays | {f"visits.{view}": np.asarray(visits) for view, visits in self._visits.items()}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        self.images = {int(k[7:]): v.copy() for k, v in arrays.items() if k.startswith("target.")}
        self._visits = {int(k[7:]): (int(v[0]), int(v[1])) for k, v in arrays.items() if k.startswith("visits.")}
        in_round, at = arrays.get("last_image", (0, -1))
        self._last_image = int(in_round), int(at)
