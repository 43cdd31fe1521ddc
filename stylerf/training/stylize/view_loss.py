"""The style loss of a view's image: the objective, the view's content, its coverage and its window."""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from stylerf.fields.gpu.memory import free_on
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.style_objective import EVERYTHING, Content, GramObjective, StyleObjective, window_of
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.scene import CONTENT, StyledScene

OBJECTIVES = {"nnfm": StyleObjective, "gram": GramObjective}
ImageLoss = Callable[[Tensor], tuple[Tensor, dict[str, float]]]  # of an image [3, h, w]: the loss and its parts


class ViewLoss:
    """Compares views with the style image. Images are [3, h, w] over the background, on the extractor's device.

    stride: pixels between positions of the deepest features that the method looks at; the extractor's if not given.
    around: feature positions beside a silhouette that count too.
    """

    def __init__(
        self, scene: StyledScene, extractor: FeatureExtractor, stride: int | None = None, around: int = 0
    ) -> None:
        self.scene, self.extractor, self.around = scene, extractor, around
        self.device = extractor.input_scale.device
        s = scene.settings
        smallest = math.ceil(2 * (stride or extractor.stride) / s.feature_scale * (2 if s.coarse > 0 else 1))
        self.windows = [
            EVERYTHING if scene.fills_views else window_of(scene.coverage(view), smallest)
            for view in range(len(scene.cameras))
        ]
        # On a GPU, half of what surfaces have left free: steps need memory too.
        self.memory = free_on(self.device, 2 * scene.problem.memory) / 2
        self._objective: StyleObjective | None = None
        self._content = self._new_cache()

    @property
    def objective(self) -> StyleObjective:
        """The loss at the present feature scale; features of the style image are computed at first use."""
        scene, s = self.scene, self.scene.settings
        scale = s.feature_scale / 2 if scene.budget.progress < s.coarse else s.feature_scale
        if self._objective is None or self._objective.scale != scale:
            self._content = self._new_cache()  # at another scale
            size = (scene.cameras[0].height, scene.cameras[0].width)
            options = (s.weights, scale, s.style_rows, s.style_basis, s.style_scale, scene.problem.seed, s.variation)
            style_image = scene.problem.style_image
            self._objective = OBJECTIVES[s.loss](self.extractor, style_image, size, *options, self.around)
        return self._objective

    def content(self, view: int) -> Content | None:
        """Content of the view's photo; None if no weight asks for it."""
        return self._content[view] if self.scene.settings.weights.need_photo else None

    def _new_cache(self) -> BoundedCache:
        def content(view: int) -> Content:
            return self.objective.content_of(self.to_device(self.scene.photos[view]), self.windows[view])

        return BoundedCache(content, lambda made: made.bytes, len(self.scene.cameras), CONTENT * self.memory)

    def to_device(self, image: np.ndarray) -> Tensor:
        """An image [h, w, 3] as [3, h, w] on the extractor's device."""
        return torch.from_numpy(np.ascontiguousarray(image)).to(self.device).permute(2, 0, 1).contiguous()

    def coverage(self, view: int) -> Tensor | None:
        """The scene's coverage of a view, [h, w]; None if all of it counts."""
        if self.scene.fills_views:
            return None
        return torch.from_numpy(self.scene.coverage(view)).to(self.device)

    def of_view(self, view: int) -> ImageLoss:
        """The loss of a view's image."""
        objective, content = self.objective, self.content(view)
        coverage, window = self.coverage(view), self.windows[view]
        return lambda image: objective(image, content, coverage, window)
