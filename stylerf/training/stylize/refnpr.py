"""Stylize a whole scene after one or a few of its views that are given stylized (Ref-NPR, Zhang et al. 2023).

    refit       the new color learns the photos
    reference   where a reference is to be made: the view's photo, painted in 2D (style/painted_picture)
    style       each step: colors of the reference on its own rays, and on the rays of other views that see the same
                surface (rendering/registration); and one view's picture by its correspondences (style/template).
                In the last quarter correspondences are sought between renders, as the field then shows them.

The loss of a step is w (MSE of the references' pixels + MSE of registered pixels) + style + content + color +
variation, in the last quarter of the style steps w (...) + 0.2 style + variation.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from stylerf.errors import InvalidValue
from stylerf.rendering.ray_registration import SOLID, SeenPoints, points_of, registered, sampled_at
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.image_optimization import ImageOptimization
from stylerf.style.reference_features import ReferenceFeatures, ReferenceObjective
from stylerf.style.style_objective import VARIATIONS
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.arf import ArfTrainer
from stylerf.training.stylize.matched_photos import ObjectPhotos, rendered_match
from stylerf.training.stylize.trainer import CONTENT

LATE_WEIGHT = 0.2  # of the style distance once matches are sought between renders (Ref-NPR)
PAINTING_SHARE = 1 / 3  # of the budget, that painting references may take
NOTHING = 0.01  # coverage under which nothing of an object is seen
REGISTERED = 0.1  # of the memory
Registered = tuple[np.ndarray, np.ndarray]  # pixels [n], colors [n, 3]


class RefNprTrainer(ArfTrainer):
    """references: by training view, its stylized picture [h, w, 3] over the background; None: painted here, in 2D, by
    the objective of `painting` (settings.loss) on `trunk`. template_trunk, coarse_trunk: see TemplateObjective.

    Painting counts towards the budget. Shapes are held fast, and must not have been displaced. Of a part of the scene
    (within) references are that part of their pictures, and the photos beside it; InvalidValue where one shows nothing
    of it.
    """

    def __init__(
        self,
        *given,
        references: dict[int, np.ndarray | None],
        template_trunk: FeatureExtractor,
        coarse_trunk: FeatureExtractor,
        **more,
    ) -> None:
        if given[0].displacement is not None:
            raise InvalidValue("rays are not registered through a deformation; give a field without one")
        self.references = dict(references)
        self.to_paint = sorted(view for view, picture in references.items() if picture is None)
        if self.to_paint:
            self.PHASES = ("refit", "reference", "style")
        self._template_trunk, self._coarse_trunk = template_trunk, coarse_trunk
        self._painted: ImageOptimization | None = None
        self._template: ReferenceObjective | None = None
        self._late: dict[int, np.ndarray] = {}  # the references' views as they are when the last quarter begins
        self._late_keys = None
        super().__init__(*given, **more)
        for view, picture in self.references.items():
            if view not in self.shown:
                raise InvalidValue(f"view {self.cameras[view].name}, a reference, shows nothing of the region")
            if picture is not None:
                self.references[view] = self._asked_for(view, picture)
        views = len(self.cameras)
        self._wanted = BoundedCache(self._wanted_of, lambda wanted: wanted.bytes, views, CONTENT * self.memory_there)
        self._reached = BoundedCache(
            self._registered_of, lambda found: sum(a.nbytes for a in found), views, REGISTERED * self.memory
        )
        self._points: dict[int, SeenPoints] = {}

    @property
    def stride(self) -> int:
        return max(trunk.stride for trunk in (self.trunk, self._template_trunk, self._coarse_trunk))

    def _asked_for(self, view: int, picture: np.ndarray) -> np.ndarray:
        """A reference without what it cannot ask for: beside the part that is stylized, or where no object is."""
        if self.partial:
            part = self.counted(view)[..., None]
            return part * picture + (1 - part) * self.photos[view]
        if self.closed:
            return picture
        return np.where(self.still.alpha(view)[..., None] > NOTHING, picture, self.background).astype(np.float32)

    # -- painting a reference ---------------------------------------------------------------------------------------

    @property
    def _painting_steps(self) -> int:
        """Of the picture of each reference that is painted here."""
        s = self.settings
        most = max(1, int(PAINTING_SHARE * s.steps / len(self.to_paint))) if s.steps else s.reference_steps
        return min(s.reference_steps, most)

    @property
    def steps_of_phase(self) -> int:
        painting = self._painting_steps * len(self.to_paint) if self.to_paint else 0
        if self.state.phase == "reference":
            return painting
        if self.state.phase == "style" and self.settings.steps:
            return max(1, self.settings.steps - painting)
        return super().steps_of_phase

    @property
    def progress(self) -> float:
        s, state = self.settings, self.state
        if state.phase == "reference":
            done = state.step / self.steps_of_phase
            return min(1.0, done if s.steps else max(done, state.seconds / (PAINTING_SHARE * s.seconds)))
        if state.phase != "style":
            return super().progress
        painted = state.counts.get("painting_ms", 0) / 1000
        done = state.step / self.steps_of_phase if s.steps else (state.seconds - painted) / (s.seconds - painted)
        return min(1.0, done)

    def _step(self) -> dict[str, float]:
        return self.reference_step() if self.state.phase == "reference" else self.style_step()

    def reference_step(self) -> dict[str, float]:
        """One step of the picture of a reference, one after the other; the parts of its loss."""
        each = self._painting_steps
        at, step = divmod(self.state.step, each)
        view = self.to_paint[at]
        if self._painted is None:
            self._painted = self._new_picture(view)
        parts = self._painted.step(self._painting_loss(view), 1 - step / each)
        self.references[view] = _in_eight_bits(self._painted.pixels())
        if step + 1 == each:
            self._painted_whole(view)
        return parts

    def _painted_whole(self, view: int) -> None:
        """A reference has had its steps: it gets the painting's colors, as ARF's result does.

        Features know little of hue: what is painted by them alone has specks of green and violet.
        """
        if self.settings.match != "none":
            counted = np.ones_like(self.counted(view)) if self._all_counts else self.counted(view)
            behind = None if self.partial else self.background
            picture = ObjectPhotos([self.references[view]], lambda _: counted, behind)
            matched = picture.mapped(0, rendered_match([picture(0)], self._palette, self.seed))
            self.references[view] = _in_eight_bits(matched)
        self._painted = None

    def _new_picture(self, view: int) -> ImageOptimization:
        start = self._there(self.photos[view])
        beside = start if self.partial else float(self.background)
        return ImageOptimization(start, self._alpha_there(view), beside, self.settings.image_rate)

    def _painting_loss(self, view: int) -> Callable:
        content, alpha, window = self._content_of(view), self._alpha_there(view), self.windows[view]

        def loss(picture: torch.Tensor) -> tuple[torch.Tensor, dict[str, float]]:
            found, parts = self.objective(picture, content, alpha, window)
            return found + self._variation_lacking(view, picture, self.settings.weights.variation), parts

        return loss

    def _variation_lacking(self, view: int, picture: torch.Tensor, weight: float) -> torch.Tensor | float:
        """What the loss of a part lacks of variation, which is a mean over all of the picture as nothing else is."""
        if not self.partial:
            return 0.0
        variation = VARIATIONS[self.settings.variation]
        return (1 / float(self.counted(view).mean()) - 1) * weight * variation(picture)

    def _next_phase(self) -> None:
        painting, seconds = self.state.phase == "reference", self.state.seconds
        if painting:
            self.between_steps = False  # a checkpoint of a picture that is matched already would have it matched again
            if self._painted is not None:  # a budget of time can end in the midst of one
                self._painted_whole(self.to_paint[self.state.step // self._painting_steps])
            for view in self.to_paint:  # or before the turn of the last ones
                if self.references[view] is None:
                    self.references[view] = _in_eight_bits(self.photos[view])
        super()._next_phase()
        if painting:
            self.state.seconds = seconds
            if not self.settings.steps:
                self.state.counts["painting_ms"] = round(1000 * seconds)

    # -- what the references ask for --------------------------------------------------------------------------------

    @property
    def template(self) -> ReferenceObjective:
        """The loss of a view by its correspondences; made when the references are there."""
        if self._template is None:
            s = self.settings
            templates = [
                ReferenceFeatures(
                    self._there(self.photos[v]), self._there(picture), self._alpha_there(v), self.windows[v]
                )
                for v, picture in self.references.items()
            ]
            given = (s.template_weights, s.feature_scale, s.style_basis, self.seed, s.variation)
            self._template = ReferenceObjective(self._template_trunk, self._coarse_trunk, templates, *given)
        return self._template

    def _wanted_of(self, view: int):
        return self.template.wanted(self._there(self.photos[view]), self._alpha_there(view), self.windows[view])

    def _points_of(self, view: int) -> SeenPoints:
        if view in self._points:
            return self._points[view]
        found = points_of(self.still.surface(view), self.cameras[view], self.field.space)
        if self.partial:
            found = replace(found, there=found.there & (self.counted(view).ravel() > SOLID))
        if view in self.references:
            self._points[view] = found
        return found

    def _registered_of(self, view: int) -> Registered:
        """Pixels of a view that see what a reference sees, and its colors there; of several, the straightest look."""
        count = self.cameras[view].width * self.cameras[view].height
        best, colors = np.full(count, -1.0), np.zeros((count, 3), np.float32)
        for other, picture in self.references.items():
            if other == view:
                continue
            pixels, positions, cosines = registered(self._points_of(view), self._points_of(other))
            nearer = cosines > best[pixels]
            best[pixels[nearer]] = cosines[nearer]
            colors[pixels[nearer]] = sampled_at(picture, positions[nearer])
        pixels = np.flatnonzero(best > -1)
        return pixels, colors[pixels]

    @property
    def registered_share(self) -> float:
        """Of what views other than the references see, the part that the references tell the color of."""
        others = [view for view in self.shown if view not in self.references]
        shares = [len(self._reached[v][0]) / max(1, int((self.counted(v) > SOLID).sum())) for v in others]
        return float(np.mean(shares)) if shares else 0.0

    def _also_learn(self, generator: np.random.Generator) -> dict[str, float]:
        weight, parts = self.settings.reference_weight, {"reference": 0.0, "registered": 0.0}
        views = list(self.references)
        view = views[int(generator.integers(len(views)))]
        parts["reference"] = self._learn_image(view, self.references[view], generator, weight) or 0.0
        others = [v for v in self.shown if v not in self.references]
        if others:
            view = others[int(generator.integers(len(others)))]
            pixels, colors = self._reached[view]
            if len(pixels):
                chosen = generator.integers(0, len(pixels), self.settings.refit_pixels)
                parts["registered"] = self._learn_pixels(view, pixels[chosen], colors[chosen], weight)
        return parts

    def _loss(self, view: int, picture: torch.Tensor) -> tuple[torch.Tensor, dict[str, float]]:
        alpha, window = self._alpha_there(view), self.windows[view]
        lacking = self._variation_lacking(view, picture, self.settings.template_weights.variation)
        if self.progress < 1 - self.settings.late:
            loss, parts = self.template(picture, self._wanted[view], alpha, window)
            return loss + lacking, parts
        found, weights = self.template.features_of(picture, window), self.settings.template_weights
        looks = {block: feature.detach() for block, feature in found.items()}
        matches = self.template.matches_of(looks, self.late_keys, alpha, window)
        style = self.template.style_distance(found, matches, alpha, window)
        variation = self.template.variation(picture)
        loss = LATE_WEIGHT * weights.style * style + weights.variation * variation + lacking
        return loss, {"style": float(style.detach()), "variation": float(variation.detach())}

    @property
    def late_keys(self):
        """What renders are matched against in the last quarter: the references' own views, as they looked before it."""
        if self._late_keys is None:
            for view in self.references:
                if view not in self._late:
                    alpha = self.geometry.alpha(view)
                    rgb = self.paint_view(view).reshape(*alpha.shape, 3)
                    self._late[view] = rgb + (1 - alpha[..., None]) * self.background
            self._late_keys = self.template.keys_of([self._there(self._late[view]) for view in self.references])
        return self._late_keys

    # -- checkpoints ------------------------------------------------------------------------------------------------

    def _own_arrays(self) -> dict[str, np.ndarray]:
        arrays = super()._own_arrays()
        for view in self.to_paint:
            if self.references[view] is not None:
                arrays[f"reference.{view}"] = np.rint(self.references[view] * 255).astype(np.uint8)
        if self._painted is not None:
            arrays |= {f"painted.{k}": v for k, v in self._painted.arrays().items()}
        arrays |= {f"late.{view}": picture.astype(np.float32) for view, picture in self._late.items()}
        return arrays

    def _restore_own(self, arrays: dict[str, np.ndarray]) -> None:
        super()._restore_own(arrays)
        for view in self.to_paint:
            if f"reference.{view}" in arrays:
                self.references[view] = arrays[f"reference.{view}"].astype(np.float32) / 255
        moments = {k[8:]: v for k, v in arrays.items() if k.startswith("painted.")}
        self._painted = None
        if moments:
            self._painted = self._new_picture(self.to_paint[self.state.step // self._painting_steps])
            self._painted.restore(moments)
        self._late = {int(k[5:]): v.copy() for k, v in arrays.items() if k.startswith("late.")}
        self._late_keys = None


def _in_eight_bits(picture: np.ndarray) -> np.ndarray:
    """Rounded as a file of it, and a checkpoint, has it."""
    return np.rint(picture * 255).astype(np.uint8).astype(np.float32) / 255
