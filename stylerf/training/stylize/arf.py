"""Stylize a whole scene with one painting: its colors alone (ARF, Zhang et al. 2022) or its shapes too (DeSRF).

The new color is taught the painting one view a step, and with it the deformation, where there is one.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch

from stylerf.fields.deformation import Deformation
from stylerf.fields.displacement_grid import at_rest
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.rendering.ray_selection import selected_gradient, selected_pixels, spread_over_picture
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.training.deform.backend import deformer_on
from stylerf.training.deform.deformer import Deformer
from stylerf.training.stylize.geometry import MovingGeometry
from stylerf.training.stylize.settings import StyleSettings
from stylerf.training.stylize.trainer import MEMORY, PIXELS_AT_ONCE, StylizationTrainer

BESIDE = 3  # feature positions beside a silhouette that may move: what stands out from it shows there, or is missing
COARSEST_STEP = 1 / 128  # cube units; of a field whose rays are walked anew in every step
# Style steps in which the rate of shapes rises. Adam's first steps have no past, and weights of one sign move together:
# the whole scene would slide by some cells, which a short stylization does not undo.
SHAPE_RAMP = 10


class ArfTrainer(StylizationTrainer):
    """deformation: moves the shapes too, from how it stands (DeSRF); None holds them fast (ARF).

    device: where rays are followed, through shapes that move too. The rest: see Repainting.
    """

    def __init__(
        self,
        scene: RadianceField,
        cameras: list[Camera],
        photos: Sequence[np.ndarray],
        background: float,
        painting: torch.Tensor,
        trunk: FeatureExtractor,
        settings: StyleSettings,
        seed: int,
        chunks: int,
        new_color: Callable[[np.random.Generator, float], object],
        deformation: Deformation | None = None,
        memory: float = MEMORY,
        device: str | None = None,
        within: np.ndarray | None = None,
    ) -> None:
        self._deformation: Deformation | None = deformation
        self.deformer: Deformer | None = None
        self.around = BESIDE if deformation is not None else 0
        self._remembered: dict[int, np.ndarray] = {}
        given = scene, cameras, photos, background, painting, trunk, settings, seed, chunks, new_color
        super().__init__(*given, memory, device, within)

    def _prepare_shapes(self) -> None:
        if self._deformation is not None:
            vertices = self.settings.displacement_vertices
            at_rest(self.field)  # by the step that its densities were fitted with
            # A walk costs by its samples, and its step cannot change later: colors are learned where it samples them.
            self.field.step = max(self.field.step, COARSEST_STEP)
            given = self.field, self._deformation, self.cameras, vertices, self.seed, self.chunks
            self.deformer = deformer_on(self.device, *given, self.settings.clip)

    def _phase_begins(self) -> None:
        if self.deformer is not None:
            s = self.settings
            self.geometry = self._moving()(
                self.field, self.cameras, s.share, self.chunks, float(self.background), self.deformer, self.still
            )

    def _moving(self) -> type[MovingGeometry]:
        if self.device is None:
            return MovingGeometry
        from stylerf.training.stylize.geometry_gpu import GpuMovingGeometry

        return GpuMovingGeometry

    def _collect(self) -> None:
        super()._collect()
        if self.deformer is not None:
            self.deformer.collect()

    # -- a step -----------------------------------------------------------------------------------------------------

    def _step(self) -> dict[str, float]:
        return self.style_step()

    def style_step(self) -> dict[str, float]:
        """One view towards the painting; the parts of the loss."""
        settings, view = self.settings, self._view_of_step()
        generator = np.random.default_rng([self.seed, 4, self.state.step])
        camera = self.cameras[view]
        pixels = selected_pixels(settings.strategy, camera.height, camera.width, settings.dilation, generator)
        picture, kept = self._picture(view, pixels)
        gradient, parts = self._gradient(view, picture)
        chosen = selected_gradient(gradient, pixels, settings.blur)
        if kept is not None:
            self.geometry.learn(kept, chosen, self.adam.gradients)
        else:
            for at in range(0, len(pixels), PIXELS_AT_ONCE):
                part = slice(at, at + PIXELS_AT_ONCE)
                _, kept_part = self.geometry.paint(view, pixels[part])
                self.geometry.learn(kept_part, chosen[part], self.adam.gradients)
        parts |= self._also_learn(generator)
        falling = settings.final_rate**self.progress
        self.adam.step(settings.rate * falling)
        if self.deformer is not None:
            weight = settings.displacement_weight
            rising = min(1.0, (self.state.step + 1) / SHAPE_RAMP)
            parts["displacement"] = self.deformer.step(settings.deform_rate * falling * rising, weight)
        return parts

    def _also_learn(self, generator: np.random.Generator) -> dict[str, float]:
        """Adds gradients of what is asked for beside the view's picture; its parts of the loss."""
        return {}

    def _view_of_step(self) -> int:
        """Every view that shows what is stylized once an epoch, in an order drawn anew for each."""
        epoch, at = divmod(self.state.step, len(self.shown))
        return self.shown[int(np.random.default_rng([self.seed, 3, epoch]).permutation(len(self.shown))[at])]

    def _picture(self, view: int, pixels: np.ndarray) -> tuple[np.ndarray, tuple | None]:
        """Premultiplied rgb of the whole view [h*w, 3], and what the selected pixels need to learn (None: repaint)."""
        whole = len(pixels) == self.cameras[view].width * self.cameras[view].height
        if whole:
            if self.settings.strategy == "full":
                return self.geometry.paint(view, pixels)
            return self.paint_view(view), None
        if not self.settings.remember:
            self._remembered[view] = self.paint_view(view)
        elif view not in self._remembered:
            self._remembered[view] = self.paint_view(view, self.still)
        painted, kept = self.geometry.paint(view, pixels)
        picture, settings = self._remembered[view], self.settings
        if settings.strategy == "dilated":
            camera = self.cameras[view]
            changes = painted - picture[pixels]
            picture += spread_over_picture(changes, pixels, camera.height, camera.width, settings.dilation)
        picture[pixels] = painted
        return picture, kept

    def _gradient(self, view: int, premultiplied: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """dL/d(picture) [h, w, 3] and the parts of the loss."""
        camera = self.cameras[view]
        rgb = premultiplied.reshape(camera.height, camera.width, 3)
        if not self.closed:
            rgb = rgb + (1 - self.geometry.alpha(view)[..., None]) * self.background
        picture = self._there(rgb).requires_grad_()
        loss, parts = self._loss(view, picture)
        loss.backward()
        return picture.grad.permute(1, 2, 0).contiguous().cpu().numpy(), parts

    def _loss(self, view: int, picture: torch.Tensor) -> tuple[torch.Tensor, dict[str, float]]:
        """Of a view's picture [3, h, w] over the background: the loss and its parts."""
        return self.objective(picture, self._content_of(view), self._alpha_there(view), self.windows[view])

    # -- checkpoints ------------------------------------------------------------------------------------------------

    def _own_arrays(self) -> dict[str, np.ndarray]:
        arrays = {f"seen.{view}": picture.astype(np.float32) for view, picture in self._remembered.items()}
        if self.deformer is not None:
            arrays |= {f"deform.{k}": v for k, v in self.deformer.arrays().items()}
            if self.state.phase != "refit":
                arrays |= {f"alpha.{view}": alpha for view, alpha in self.geometry.alphas.items()}
        return arrays

    def _restore_own(self, arrays: dict[str, np.ndarray]) -> None:
        self._remembered = {int(k[5:]): v.copy() for k, v in arrays.items() if k.startswith("seen.")}
        if self.deformer is not None:
            self.deformer.restore({k[7:]: v for k, v in arrays.items() if k.startswith("deform.")})
            if self.state.phase != "refit":
                self.geometry.alphas = {int(k[6:]): v.copy() for k, v in arrays.items() if k.startswith("alpha.")}
