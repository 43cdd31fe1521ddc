"""Stylize a scene from one or a few stylized views of it (Ref-NPR, Zhang et al. 2023).

    refit       the new color learns the photos
    reference   only if a reference must be made: optimize the view's photo in 2D (style/image_stylization.py)
    style       each step trains on the reference's colors, on its own rays and on rays of other views that see the same
                surface (rendering/ray_registration.py), and on one view by its correspondences with the reference
                (style/reference_features.py); in the last quarter, correspondences are searched between renders

The loss of a step is w (MSE of the references' pixels + MSE of registered pixels) + style + content + color +
variation; in the last quarter of the style steps, w (...) + 0.2 style + variation.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from stylerf.errors import InvalidValue
from stylerf.rendering.ray_registration import SOLID, SeenPoints, points_of, registered, sampled_at
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.feature_matching import StyleRows
from stylerf.style.image_stylization import ImageLoss, ImageOptimization
from stylerf.style.reference_features import ReferenceFeatures, ReferenceObjective, Wanted
from stylerf.style.style_loss import VARIATIONS
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.common.even_draws import drawn_evenly
from stylerf.training.stylize.arf import ViewLoss, ViewStep
from stylerf.training.stylize.scene import CONTENT, ObjectPhotos, PhaseBudget, StyledScene, rendered_match
from stylerf.training.stylize.settings import STYLE, RefNprSettings
from stylerf.training.stylize.trainer import StyleMethod

LATE_WEIGHT = 0.2  # of the style distance once renders are matched with renders (Ref-NPR)
REFERENCE_SHARE = 1 / 3  # maximum fraction of the budget for making references
EMPTY = 0.01  # coverage below which a pixel shows no object
REGISTERED = 0.1  # of the memory
Registered = tuple[np.ndarray, np.ndarray]  # pixels [n], colors [n, 3]


class ReferenceBudget(PhaseBudget):
    """The budget for making `made` references and for the style steps after them."""

    scene: StyledScene[RefNprSettings]

    def __init__(self, scene: StyledScene[RefNprSettings], made: int) -> None:
        super().__init__(scene)
        self.made = made

    @property
    def steps_of_each(self) -> int:
        """Steps per reference to be made."""
        s = self.scene.settings
        most = max(1, int(REFERENCE_SHARE * s.steps / self.made)) if s.steps else s.reference_steps
        return min(s.reference_steps, most)

    @property
    def steps(self) -> int:
        making = self.steps_of_each * self.made if self.made else 0
        s, phase = self.scene.settings, self.scene.state.phase
        if phase == "reference":
            return making
        return max(1, s.steps - making) if phase == STYLE and s.steps else super().steps

    @property
    def progress(self) -> float:
        s, state = self.scene.settings, self.scene.state
        if state.phase == "reference":
            done = state.step / self.steps
            return min(1.0, done if s.steps else max(done, state.seconds / (REFERENCE_SHARE * s.seconds)))
        if state.phase != STYLE:
            return super().progress
        making = state.counts.get("painting_ms", 0) / 1000
        if s.steps:
            return min(1.0, state.step / self.steps)
        left = max(s.seconds - making, 1e-3)  # if one slow step uses up the budget, take one style step
        return min(1.0, (state.seconds - making) / left)


class RefNpr(StyleMethod[RefNprSettings]):
    """Ref-NPR. Making references counts towards the budget; shapes are fixed.

    With a region, only that part of the reference images is used; around it, references show the photos.

    Args:
        extractor: Used to make references, with the objective of the style image (settings.loss).
        references: By training view, its stylized image [h, w, 3] over the background, or None if it is to be made.
        matching_extractor, coarse_extractor: See style/reference_features.ReferenceObjective.

    Raises:
        InvalidValue: The field is displaced, or a reference shows no part of the region or object.
    """

    def __init__(
        self,
        scene: StyledScene[RefNprSettings],
        extractor: FeatureExtractor,
        references: Mapping[int, np.ndarray | None],
        matching_extractor: FeatureExtractor,
        coarse_extractor: FeatureExtractor,
    ) -> None:
        if scene.field.displacement is not None:
            raise InvalidValue("rays cannot be registered through a deformation; give a field without one")
        super().__init__(scene)
        self._images = dict(references)
        self.to_make = sorted(view for view, image in references.items() if image is None)
        self.phases = ("reference", STYLE) if self.to_make else (STYLE,)
        self.budget = ReferenceBudget(scene, len(self.to_make))
        scene.budget = self.budget
        self._matching, self._coarse = matching_extractor, coarse_extractor
        # ViewLoss expects strides in pixels of the images that references are made with.
        made, matched = scene.settings.feature_scale, scene.settings.reference_scale
        deepest = math.ceil(max(matching_extractor.stride, coarse_extractor.stride) * made / matched)
        self.loss = ViewLoss(scene, extractor, max(extractor.stride, deepest))
        self.view_step = ViewStep(scene, self.loss_of_view, self.loss.to_device)
        self._optimized: ImageOptimization | None = None  # the reference being made
        self._objective: ReferenceObjective | None = None
        self._late_renders: dict[int, np.ndarray] = {}  # the references' views at the start of the last quarter
        self._late_keys: dict[str, StyleRows] | None = None
        for view, image in references.items():
            if view not in scene.shown:
                raise InvalidValue(f"view {scene.cameras[view].name}, a reference, shows nothing of the region")
            if not scene.of_region and scene.coverage(view).max() <= EMPTY:
                raise InvalidValue(f"view {scene.cameras[view].name}, a reference, shows nothing of the object")
            if image is not None:
                self._images[view] = self._within_coverage(view, image)
        views = len(scene.cameras)
        self._targets = BoundedCache(self._target, lambda one: one.bytes, views, CONTENT * self.loss.memory)
        memory = REGISTERED * scene.problem.memory
        self._registered = BoundedCache(self._register, lambda found: sum(a.nbytes for a in found), views, memory)
        self._points: dict[int, SeenPoints] = {}

    @property
    def references(self) -> dict[int, np.ndarray]:
        """The references that exist so far, by training view."""
        return {view: image for view, image in self._images.items() if image is not None}

    def _within_coverage(self, view: int, image: np.ndarray) -> np.ndarray:
        """Return a reference with the photo around the region, and the background where there is no object."""
        if self.scene.of_region:
            part = self.scene.coverage(view)[..., None]
            return part * image + (1 - part) * self.scene.photos[view]
        if self.scene.field.opaque_background:
            return image
        alpha = self.scene.fixed.alpha(view)[..., None]
        return np.where(alpha > EMPTY, image, self.scene.background).astype(np.float32)

    def step(self) -> dict[str, float]:
        return self.reference_step() if self.scene.state.phase == "reference" else self.style_step()

    # -- making a reference -----------------------------------------------------------------------------------------

    def reference_step(self) -> dict[str, float]:
        """Take one step on a reference's pixels, one reference after another; return the parts of its loss."""
        each = self.budget.steps_of_each
        at, step = divmod(self.scene.state.step, each)
        view = self.to_make[at]
        if self._optimized is None:
            self._optimized = self._new_image(view)
        parts = self._optimized.step(self.making_loss(view), 1 - step / each)
        # Rounded as in a checkpoint, so that style steps see the same reference whether resumed or not.
        self._images[view] = _in_eight_bits(self._optimized.pixels())
        if step + 1 == each:
            self._finish_reference(view)
        return parts

    def _finish_reference(self, view: int) -> None:
        """Match a reference's colors to the style image's, as in ARF's last step.

        Features are almost blind to hue: images optimized by them alone have green and violet specks.
        """
        scene = self.scene
        if scene.settings.match != "none" and scene.style_colors is not None:
            coverage = scene.coverage(view)
            coverage = np.ones_like(coverage) if scene.fills_views else coverage
            behind = None if scene.of_region else scene.background
            image = ObjectPhotos([self.references[view]], lambda _: coverage, behind)
            color_map = rendered_match([image(0)], scene.style_colors, scene.problem.seed)
            self._images[view] = _in_eight_bits(image.mapped(0, color_map))
        self._optimized = None

    def _new_image(self, view: int) -> ImageOptimization:
        start, scene = self.loss.to_device(self.scene.photos[view]), self.scene
        beside = start if scene.of_region else float(scene.background)
        return ImageOptimization(start, self.loss.coverage(view), beside, scene.settings.image_rate)

    def making_loss(self, view: int) -> ImageLoss:
        """Return the loss function for making a view's reference."""
        plain, weight = self.loss.of_view(view), self.scene.settings.weights.variation

        def loss(image: torch.Tensor) -> tuple[torch.Tensor, dict[str, float]]:
            found, parts = plain(image)
            return found + self._missing_variation(view, image, weight), parts

        return loss

    def _missing_variation(self, view: int, image: torch.Tensor, weight: float) -> torch.Tensor | float:
        """Return the variation missing from a region's loss, where it is the only mean over the whole image."""
        if not self.scene.of_region:
            return 0.0
        variation = VARIATIONS[self.scene.settings.variation]
        # Together with what the loss already has: variation / share, the mean over the region's pixels.
        return (1 / float(self.scene.coverage(view).mean()) - 1) * weight * variation(image)

    def finish_phase(self) -> None:
        if self.scene.state.phase != "reference":
            return
        if self._optimized is not None:  # a time budget may end within one
            self._finish_reference(self.to_make[self.scene.state.step // self.budget.steps_of_each])
        for view in self.to_make:  # or before the last ones
            if self._images[view] is None:
                self._images[view] = _in_eight_bits(self.scene.photos[view])

    def start_phase(self, spent: float) -> None:
        state = self.scene.state
        if state.phase == STYLE and self.to_make:
            # The phases share one budget: the style phase continues its clock.
            state.seconds = spent
            if not self.scene.settings.steps:
                state.counts["painting_ms"] = round(1000 * spent)

    # -- the style steps --------------------------------------------------------------------------------------------

    def style_step(self) -> dict[str, float]:
        """Take one step on a view, on a reference's pixels and on registered pixels; return the parts of the loss."""
        scene, settings = self.scene, self.scene.settings
        generator = np.random.default_rng([scene.problem.seed, 4, scene.state.step])
        parts = self.view_step.learn(generator) | self._learn_references(generator)
        scene.adam.step(settings.rate * settings.final_rate**scene.budget.progress)
        return parts

    @property
    def objective(self) -> ReferenceObjective:
        """The loss of a view by its correspondences, created once the references exist."""
        if self._objective is None:
            loss, s, seed = self.loss, self.scene.settings, self.scene.problem.seed
            pairs = [
                ReferenceFeatures(
                    loss.to_device(self.scene.photos[v]), loss.to_device(image), loss.coverage(v), loss.windows[v]
                )
                for v, image in self.references.items()
            ]
            options = (s.reference_feature_weights, s.reference_scale, s.style_basis, seed, s.variation)
            self._objective = ReferenceObjective(self._matching, self._coarse, pairs, *options)
        return self._objective

    def _target(self, view: int) -> Wanted:
        loss = self.loss
        return self.objective.wanted(loss.to_device(self.scene.photos[view]), loss.coverage(view), loss.windows[view])

    def _points_of(self, view: int) -> SeenPoints:
        if view in self._points:
            return self._points[view]
        scene = self.scene
        found = points_of(scene.fixed.surface(view), scene.cameras[view], scene.field.space)
        if scene.of_region:
            found = replace(found, there=found.there & (scene.coverage(view).ravel() > SOLID))
        if view in self.references:
            self._points[view] = found
        return found

    def _register(self, view: int) -> Registered:
        """Return a view's pixels that see what a reference sees, and its colors there (of several: most frontal)."""
        count = self.scene.cameras[view].width * self.scene.cameras[view].height
        # best: cosine between the directions in which pixel and reference see the point; -1: not seen by a reference.
        best, colors = np.full(count, -1.0), np.zeros((count, 3), np.float32)
        for other, image in self.references.items():
            if other == view:
                continue
            pixels, positions, cosines = registered(self._points_of(view), self._points_of(other))
            better = cosines > best[pixels]
            best[pixels[better]] = cosines[better]
            colors[pixels[better]] = sampled_at(image, positions[better])
        pixels = np.flatnonzero(best > -1)
        return pixels, colors[pixels]

    @property
    def _others(self) -> list[int]:
        return [view for view in self.scene.shown if view not in self.references]

    @property
    def registered_share(self) -> float:
        """Fraction of the pixels of views other than the references whose color a reference provides."""
        covered = {view: int((self.scene.coverage(view) > SOLID).sum()) for view in self._others}
        shares = [len(self._registered[view][0]) / max(1, count) for view, count in covered.items()]
        return float(np.mean(shares)) if shares else 0.0

    def _learn_references(self, generator: np.random.Generator) -> dict[str, float]:
        """Add the gradients of a reference's pixels and of registered ones; return their mean squared errors."""
        scene, weight, most = self.scene, self.scene.settings.reference_weight, self.scene.settings.reference_pixels
        views, others, error = list(self.references), self._others, 0.0
        view = views[int(generator.integers(len(views)))]
        own = scene.learn_image(view, self.references[view], generator, most, weight) or 0.0
        if others:
            view = others[int(generator.integers(len(others)))]
            pixels, colors = self._registered[view]
            if len(pixels):
                chosen = drawn_evenly(min(most, len(pixels)), len(pixels), generator)
                error = scene.learn_pixels(view, pixels[chosen], colors[chosen], weight)
        return {"reference": own, "registered": error}

    def loss_of_view(self, view: int) -> ImageLoss:
        """Return the loss function for a view's render at the current step."""
        late = self.scene.budget.progress >= 1 - self.scene.settings.late
        weights, objective = self.scene.settings.reference_feature_weights, self.objective
        coverage, window = self.loss.coverage(view), self.loss.windows[view]

        def early_loss(image: torch.Tensor) -> tuple[torch.Tensor, dict[str, float]]:
            missing = self._missing_variation(view, image, weights.variation)
            loss, parts = objective(image, self._targets[view], coverage, window)
            return loss + missing, parts

        def late_loss(image: torch.Tensor) -> tuple[torch.Tensor, dict[str, float]]:
            missing = self._missing_variation(view, image, weights.variation)
            found = objective.features_of(image, window)
            # Detached for the search only: matches are constant, while features carry the gradient.
            matches = objective.matches_of({b: f.detach() for b, f in found.items()}, self.late_keys, coverage, window)
            style, variation = objective.style_distance(found, matches, coverage, window), objective.variation(image)
            loss = LATE_WEIGHT * weights.style * style + weights.variation * variation + missing
            return loss, {"style": float(style.detach()), "variation": float(variation.detach())}

        return late_loss if late else early_loss

    @property
    def late_keys(self) -> dict[str, StyleRows]:
        """What renders are matched with in the last quarter: renders of the references' views at its start."""
        if self._late_keys is None:
            for view in self.references:
                if view not in self._late_renders:
                    self._late_renders[view] = self.scene.render_over(view)
            renders = [self.loss.to_device(self._late_renders[view]) for view in self.references]
            self._late_keys = self.objective.keys_of(renders)
        return self._late_keys

    # -- checkpoints ------------------------------------------------------------------------------------------------

    def arrays(self) -> dict[str, np.ndarray]:
        arrays = self.view_step.arrays()
        for view in self.to_make:
            if (image := self._images[view]) is not None:
                arrays[f"reference.{view}"] = np.rint(image * 255).astype(np.uint8)
        if self._optimized is not None:
            arrays |= {f"painted.{k}": v for k, v in self._optimized.arrays().items()}
        return arrays | {f"late.{view}": image.astype(np.float32) for view, image in self._late_renders.items()}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        self.view_step.restore(arrays)
        for view in self.to_make:
            if f"reference.{view}" in arrays:
                self._images[view] = arrays[f"reference.{view}"].astype(np.float32) / 255
        moments = {k[8:]: v for k, v in arrays.items() if k.startswith("painted.")}
        self._optimized = None
        if moments:
            self._optimized = self._new_image(self.to_make[self.scene.state.step // self.budget.steps_of_each])
            self._optimized.restore(moments)
        self._late_renders = {int(k[5:]): v.copy() for k, v in arrays.items() if k.startswith("late.")}
        self._late_keys = None


def _in_eight_bits(image: np.ndarray) -> np.ndarray:
    """Return an image rounded to 8 bits, as in a file or a checkpoint."""
    return np.rint(image * 255).astype(np.uint8).astype(np.float32) / 255
