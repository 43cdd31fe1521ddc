"""Stylize a scene with one image: only its colors (ARF, Zhang et al. 2022), or its shapes too (DeSRF).

Each step compares one rendered view with the style image. The gradient of the loss flows from the image to the view's
rays (deferred back-propagation), and through them to the new color and the deformation, if any.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.gpu.memory import free_on
from stylerf.rendering.ray_selection import selected_gradient, selected_pixels, spread_over_picture
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.image_stylization import ImageLoss
from stylerf.style.style_loss import (
    EVERYTHING,
    Content,
    GramObjective,
    StyleObjective,
    TransportObjective,
    cell_colors,
    scaled_style,
    window_of,
)
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.geometry import Record
from stylerf.training.stylize.scene import CONTENT, PIXELS_AT_ONCE, StyledScene
from stylerf.training.stylize.settings import ArfSettings, DesrfSettings, ImageStyleSettings
from stylerf.training.stylize.silhouettes import mirror_pixels, object_colors, over
from stylerf.training.stylize.stroke_sizes import StrokesByDepth, stroke_sizes
from stylerf.training.stylize.trainer import StyleMethod

OBJECTIVES = {"nnfm": StyleObjective, "gram": GramObjective, "transport": TransportObjective}
MIRRORS, STROKES = 0.05, 0.02  # fractions of the memory


class ViewLoss:
    """Compares views with the style image. Images are [3, h, w] over the background, on the extractor's device.

    stride: stride in pixels of the deepest features that the method uses; by default the extractor's. around: how many
    feature positions beyond a silhouette also count.

    Raises:
        InvalidValue: The style image is so elongated that it is too small for the features at the views' size.
    """

    def __init__(
        self,
        scene: StyledScene[ImageStyleSettings],
        extractor: FeatureExtractor,
        stride: int | None = None,
        around: int = 0,
    ) -> None:
        self.scene, self.extractor, self.around = scene, extractor, around
        self.device = extractor.input_scale.device
        s = scene.settings
        self._size = scene.cameras[0].height, scene.cameras[0].width
        self._strokes = stroke_sizes(s.stroke, s.stroke_by_depth)
        self._check_style_image()
        # At least two feature positions, even at half size: networks reject smaller images.
        smallest = math.ceil(2 * (stride or extractor.stride) / s.feature_scale * (2 if s.coarse > 0 else 1))
        self.windows = [
            EVERYTHING if scene.fills_views else window_of(scene.coverage(view), smallest)
            for view in range(len(scene.cameras))
        ]
        # On a GPU, half of what the surfaces left free: steps need memory too.
        self.memory = free_on(self.device, 2 * scene.problem.memory) / 2
        self._objective: StyleObjective | None = None
        self._content = self._new_cache()
        self.of_object = not scene.fills_views and not scene.of_region
        self.behind = torch.from_numpy(scene.behind).to(self.device)[:, None, None]
        self._mirrors = BoundedCache(
            lambda view: mirror_pixels(scene.fixed.alpha(view)), lambda made: made.nbytes, len(scene.cameras),
            MIRRORS * self.memory,
        )  # fmt: skip
        self._places = StrokesByDepth(scene, STROKES * self.memory) if s.stroke_by_depth else None

    @property
    def objective(self) -> StyleObjective:
        """The loss at the current feature scale; the style image's features are computed on first use."""
        scene, s, style_image = self.scene, self.scene.settings, self.scene.style_image
        if style_image is None:
            raise InvalidValue("the style loss needs a style image")
        scale, layers = s.features_at(scene.budget.progress)
        if self._objective is None or self._objective.scale != scale:
            self._content = self._new_cache()  # at the new scale
            options = (s.weights, scale, s.style_rows, s.style_basis, s.style_scale, scene.problem.seed, s.variation)
            self._objective = OBJECTIVES[s.loss](
                self.extractor.only(layers), style_image, self._size, *options, self.around, s.diversity, self._strokes,
                s.rotations, s.keep_colors,
            )  # fmt: skip
        return self._objective

    def _check_style_image(self) -> None:
        s, style_image = self.scene.settings, self.scene.style_image
        if style_image is None:
            return
        scale = s.feature_scale / 2 if s.coarse > 0 else s.feature_scale
        height, width = scaled_style(style_image, self._size, scale, s.style_scale, min(self._strokes)).shape[1:]
        least = 2 * self.extractor.stride
        if min(height, width) < least:
            raise InvalidValue(
                f"the style image is too elongated: {style_image.shape[2]}x{style_image.shape[1]} pixels become "
                f"{width}x{height} at the size of the views, and {self.extractor.layers[-1]} needs {least} per side; "
                "crop it"
            )

    def content(self, view: int) -> Content | None:
        """Return the content features of the view's photo; None if no weight needs them."""
        return self._content[view] if self.scene.settings.weights.need_photo else None

    def _new_cache(self) -> BoundedCache[Content]:
        def content(view: int) -> Content:
            photo, alpha = self.to_device(self.scene.photos[view]), self.at_rest(view)
            return self.objective.content_of(self.without_background(view, photo, alpha), self.windows[view])

        return BoundedCache(content, lambda made: made.bytes, len(self.scene.cameras), CONTENT * self.memory)

    def to_device(self, image: np.ndarray) -> Tensor:
        """Return an image [h, w, 3] as [3, h, w] on the extractor's device."""
        return torch.from_numpy(np.ascontiguousarray(image)).to(self.device).permute(2, 0, 1).contiguous()

    def coverage(self, view: int) -> Tensor | None:
        """Return the scene's coverage of a view, [h, w]; None if every pixel counts."""
        if self.scene.fills_views:
            return None
        return torch.from_numpy(self.scene.coverage(view)).to(self.device)

    def of_view(self, view: int) -> ImageLoss:
        """Return the loss function for a view's image."""
        objective, content = self.objective, self.moved(view, self.content(view))
        coverage, window = self.coverage(view), self.windows[view]
        objective.draw = self.scene.state.step
        sizes = None if self._places is None else torch.from_numpy(self._places[view]).to(self.device)
        return lambda image: objective(
            self.without_background(view, image, coverage), content, coverage, window, sizes
        )

    def without_background(self, view: int, image: Tensor, alpha: Tensor | None) -> Tensor:
        """Return the view's image [3, h, w] with the background replaced by the object, mirrored at its silhouette.

        If the silhouette may move, the style image's mean color replaces it instead, so that the silhouette shows.
        """
        if not self.of_object or alpha is None:
            return image
        background = float(self.scene.background)
        if self.scene.deformer is not None:
            return over(image, alpha, background, self.behind)
        return over(image, alpha, background, object_colors(image, alpha, self.mirror(view), background))

    def at_rest(self, view: int) -> Tensor:
        """Return the coverage of a view before any deformation, [h, w]."""
        return torch.from_numpy(self.scene.fixed.alpha(view)).to(self.device)

    def mirror(self, view: int) -> Tensor:
        """Return mirror_pixels() of the object before any deformation."""
        return torch.from_numpy(self._mirrors[view]).to(self.device)

    def moved(self, view: int, content: Content | None) -> Content | None:
        """Return the content with the photo's colors and edges extended to where the object is now.

        Otherwise, parts that have grown beyond the photo's silhouette would learn the color of the background.
        """
        alpha, background = self.coverage(view), float(self.scene.background)
        if self.scene.deformer is None or not self.of_object or content is None or alpha is None:
            return content
        photo = self.to_device(self.scene.photos[view])
        colors = object_colors(photo, self.at_rest(view), self.mirror(view), background)
        wanted = alpha * colors + (1 - alpha) * self.behind
        return replace(content, colors=cell_colors(wanted), edges=self.objective.edges_of(wanted))


AROUND = 3  # feature positions beyond a moving silhouette: they show what protrudes from it or is missing
# Warm-up steps of the deformation's learning rate. Adam's first steps have no history, and weights of one sign move
# together: the whole scene would shift by a few cells, which a short stylization does not undo.
DEFORM_RAMP = 10


class ViewStep:
    """A step on one view: render it, differentiate its loss, and add to the scene's gradients.

    loss_of_view: returns the loss function for a view's image. to_device: converts an image [h, w, 3] to [3, h, w] on
    the loss's device.
    """

    def __init__(
        self,
        scene: StyledScene[ArfSettings],
        loss_of_view: Callable[[int], ImageLoss],
        to_device: Callable[[np.ndarray], Tensor],
    ) -> None:
        self.scene, self.loss_of_view, self.to_device = scene, loss_of_view, to_device
        self.last_renders: dict[int, np.ndarray] = {}

    def learn(self, generator: np.random.Generator) -> dict[str, float]:
        """Add the gradients of the step's view; return the parts of its loss."""
        scene, settings, view = self.scene, self.scene.settings, self.view_of_step()
        camera = scene.cameras[view]
        pixels = selected_pixels(settings.strategy, camera.height, camera.width, settings.dilation, generator)
        image, record = self.image(view, pixels)
        # Deferred back-propagation (ARF): render without a graph, differentiate the loss with respect to pixels, then
        # render again in chunks and backpropagate. Exact, and the graphs of features and field never coexist in memory.
        gradient, parts = self.gradient(view, image)
        chosen = selected_gradient(gradient, pixels, settings.blur)
        if record is not None:
            scene.geometry.learn(record, chosen, scene.adam.gradients)
            return parts
        # No jitter in stylization: the second pass has the same samples, as the cached gradient requires.
        for at in range(0, len(pixels), PIXELS_AT_ONCE):
            part = slice(at, at + PIXELS_AT_ONCE)
            _, record = scene.geometry.paint(view, pixels[part])
            scene.geometry.learn(record, chosen[part], scene.adam.gradients)
        return parts

    def view_of_step(self) -> int:
        """Return the view of the current step; each epoch visits every shown view once, in a new order."""
        scene = self.scene
        epoch, at = divmod(scene.state.step, len(scene.shown))
        order = np.random.default_rng([scene.problem.seed, 3, epoch]).permutation(len(scene.shown))
        return scene.shown[int(order[at])]

    def image(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, Record | None]:
        """Return premultiplied rgb of the whole view [h*w, 3] and the selected pixels' record (None: render again)."""
        scene, settings = self.scene, self.scene.settings
        camera = scene.cameras[view]
        if len(pixels) == camera.width * camera.height:
            if settings.strategy == "full":
                return scene.geometry.paint(view, pixels)
            return scene.render(view), None
        if not settings.remember:
            self.last_renders[view] = scene.render(view)
        elif view not in self.last_renders:
            self.last_renders[view] = scene.render(view, scene.fixed)
        rendered, record = scene.geometry.paint(view, pixels)
        image = self.last_renders[view]
        if settings.strategy == "dilated":
            # Other pixels change by the interpolated change of the selected ones (decision 0014), which are set below.
            changes = rendered - image[pixels]
            image += spread_over_picture(changes, pixels, camera.height, camera.width, settings.dilation)
        image[pixels] = rendered
        return image, record

    def gradient(self, view: int, premultiplied: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """Return dL/d(image) [h, w, 3] for premultiplied rgb [h*w, 3], and the parts of the loss."""
        scene, camera = self.scene, self.scene.cameras[view]
        rgb = premultiplied.reshape(camera.height, camera.width, 3)
        if not scene.field.opaque_background:
            rgb = rgb + (1 - scene.geometry.alpha(view)[..., None]) * scene.background
        image = self.to_device(rgb).requires_grad_()
        loss, parts = self.loss_of_view(view)(image)
        (gradient,) = torch.autograd.grad(loss, image)
        return gradient.permute(1, 2, 0).contiguous().cpu().numpy(), parts

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays for a checkpoint."""
        return {f"seen.{view}": image.astype(np.float32) for view, image in self.last_renders.items()}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the state from arrays()."""
        self.last_renders = {int(k[5:]): v.copy() for k, v in arrays.items() if k.startswith("seen.")}


class Arf(StyleMethod[ArfSettings]):
    """ARF, or DeSRF if the scene has a deformation."""

    def __init__(self, scene: StyledScene[ArfSettings], extractor: FeatureExtractor) -> None:
        super().__init__(scene)
        self.loss = ViewLoss(scene, extractor, around=0 if scene.deformer is None else AROUND)
        self.view_step = ViewStep(scene, self.loss.of_view, self.loss.to_device)

    def step(self) -> dict[str, float]:
        scene, settings, step = self.scene, self.scene.settings, self.scene.state.step
        parts = self.view_step.learn(np.random.default_rng([scene.problem.seed, 4, step]))
        # Both rates decay together; the deformation's also has a warm-up (decision 0041).
        decay = settings.final_rate**scene.budget.progress
        scene.adam.step(settings.rate * decay)
        if scene.deformer is not None and isinstance(settings, DesrfSettings):
            rate = settings.deform_rate * decay * min(1.0, (step + 1) / DEFORM_RAMP)
            weight, max_slope = settings.displacement_weight, settings.max_slope
            parts["displacement"] = scene.deformer.step(rate, weight, max_slope=max_slope)
        return parts

    def arrays(self) -> dict[str, np.ndarray]:
        return self.view_step.arrays()

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        self.view_step.restore(arrays)
