"""Stylise a whole scene with one painting: its colours alone (ARF, Zhang et al. 2022) or its shapes too (DeSRF).

The density part stays. A new colour part with local detail is fitted to the colour-matched photos (refit), then taught
the painting one view a step (style), and with it the deformation, where there is one; at the end colours are matched
to the painting once more.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from stylerf.errors import Diverged
from stylerf.fields.deformation import Deformation
from stylerf.fields.field import RadianceField
from stylerf.fields.surface import pixel_cells
from stylerf.geometry.cameras import Camera
from stylerf.rendering.strategies import selected_gradient, selected_pixels, spread_over_picture
from stylerf.style.colour import ColourMap, match_colours, pixels_of
from stylerf.style.objective import EVERYTHING, Content, StyleObjective, StyleWeights, window_of
from stylerf.style.trunks import Trunk
from stylerf.training.deformer import Deformer
from stylerf.training.geometry import FixedGeometry, MovingGeometry
from stylerf.training.kept import Kept
from stylerf.training.optimiser import Adam

PIXELS_AT_ONCE = 65536
MATCHED_VIEWS = 24  # their colours are those of all
BESIDE = 3  # feature positions beside a silhouette that may move: what stands out from it shows there, or is missing
MEMORY = 8e9  # bytes
# Parts of the memory: a march takes seconds to repeat, features about as long, a photo a tenth of that.
SURFACES, CONTENT, PHOTOS = 0.5, 0.35, 0.15
COARSEST_STEP = 1 / 128  # cube units; of a field whose rays are walked anew in every step


@dataclass(frozen=True)
class StyleSettings:
    """How a scene is stylised. seconds: budget of the style steps; steps: their number if > 0.

    strategy, dilation, blur: see rendering/strategies. remember: unselected pixels are taken from the view's last
    render instead of being rendered anew. match: before, after, both or none. coarse: share of the style steps, the
    first, that see features at half of `feature_scale` (docs/decisions/0013). rates: per step, falling to `final_rate`
    of themselves. deform_rate, displacement_weight, displacement_vertices: see training/deformer.
    """

    steps: int = 0
    seconds: float = 120.0
    refit_steps: int = 300
    refit_pixels: int = 8192
    refit_rate: float = 1e-2
    rate: float = 1e-2
    final_rate: float = 0.2
    strategy: str = "deferred"
    dilation: int = 2
    blur: int = 0
    remember: bool = True
    match: str = "both"
    weights: StyleWeights = field(default_factory=StyleWeights)
    share: float = 0.3
    feature_scale: float = 0.5
    coarse: float = 0.0
    style_scale: float = 1.0
    style_rows: int = 4096
    style_basis: int = 96
    variation: str = "squared"
    deform_rate: float = 1e-3
    displacement_weight: float = 0.5
    displacement_vertices: int = 32


@dataclass
class StyleState:
    """Where the stylisation stands."""

    phase: str = "refit"
    step: int = 0
    seconds: float = 0.0
    curve: list[dict] = field(default_factory=list)


class Stylizer:
    """photos: per view [h, w, 3] float32 over the background, sRGB 0..1; read anew where they are not kept.

    background: level of grey behind the field. deformation: moves the shapes too, from how it stands (DeSRF); None
    holds them fast (ARF). new_colour: the colour to learn, from a generator and the cells a side that are as wide as a
    pixel sees (nan: nothing is seen). memory: bytes that surfaces, features and photos may take together; those beyond
    are made anew each time. device: where fixed shapes are painted; None: the CPU's kernels, on which shapes that move
    stay. The trunk works where it lies.
    """

    def __init__(
        self,
        scene: RadianceField,
        cameras: list[Camera],
        photos: Sequence[np.ndarray],
        background: float,
        painting: torch.Tensor,
        trunk: Trunk,
        settings: StyleSettings,
        seed: int,
        chunks: int,
        new_colour: Callable[[np.random.Generator, float], object],
        deformation: Deformation | None = None,
        memory: float = MEMORY,
        device: str | None = None,
    ) -> None:
        self.device, self.memory = device if deformation is None else None, memory
        self.settings, self.seed, self.chunks, self.background = settings, seed, chunks, np.float32(background)
        self.cameras, self.painting, self.trunk = cameras, painting, trunk
        self.field = replace(scene, colour_map=None, share=settings.share)
        self.closed = scene.closed
        self.deformer = None
        if deformation is not None:
            vertices = settings.displacement_vertices
            # A walk costs by its samples, and its step cannot change later: colours are learnt where it samples them.
            self.field.step = max(self.field.step, COARSEST_STEP)
            self.deformer = Deformer(self.field, deformation, cameras, vertices, seed, chunks)
        self.still = self._fixed_geometry()
        self.geometry: FixedGeometry | MovingGeometry = self.still
        self.field.colour = new_colour(np.random.default_rng([seed, 1]), self._pixel_cells())
        self.still.field.colour = self.field.colour
        self.adam = self._new_adam()
        least = math.ceil(2 * trunk.stride / settings.feature_scale * (2 if settings.coarse > 0 else 1))
        self.windows = [
            EVERYTHING if self.closed else window_of(self.geometry.alpha(view), least) for view in range(len(cameras))
        ]
        self.photos = Kept(self._matched(photos), lambda photo: photo.nbytes, len(cameras), PHOTOS * memory)
        self.state = StyleState()
        self._objective: StyleObjective | None = None
        self._content = self._kept_content()
        self._remembered: dict[int, np.ndarray] = {}
        self.between_steps = True

    def _fixed_geometry(self) -> FixedGeometry:
        still = self._at_rest()
        if self.device is None:
            return FixedGeometry(still, self.cameras, self.settings.share, self.chunks, SURFACES * self.memory)
        from stylerf.training.device_geometry import DeviceFixedGeometry

        return DeviceFixedGeometry(still, self.cameras, self.settings.share, self.device)

    def _new_adam(self) -> Adam:
        """An optimiser of the colours as they stand, without a past."""
        if self.device is None:
            return Adam(self.field.colour.values, self.field.colour.groups(), self.chunks)
        return self.still.new_adam()

    def _collect(self) -> None:
        """Bring what the colours have learnt on a device into the field's own array."""
        if self.device is not None:
            self.still.collect()

    def _pixel_cells(self) -> float:
        """Cells a side of the cube as wide as what a pixel sees: the median of up to four views, nan if none sees."""
        chosen = np.unique(np.linspace(0, len(self.cameras) - 1, 4).round().astype(int))
        return pixel_cells(self.still.surface(view) for view in chosen)

    def _at_rest(self) -> RadianceField:
        """The field with its shapes as they now are, for good; its colours go on learning."""
        moved = self.field.displacement
        return replace(self.field, displacement=None if moved is None else moved.copy())

    def _matched(self, photos: Sequence[np.ndarray]) -> Callable[[int], np.ndarray]:
        """The photos in the painting's colours, where that is asked for; the background stays as it is."""
        if self.settings.match not in ("before", "both"):
            return photos.__getitem__
        count = sum(camera.width * camera.height for camera in self.cameras)
        stacked = (self._rgba(photos[view], view) for view in range(len(self.cameras)))
        colours, weights = pixels_of(stacked, seed=self.seed, count=count)
        colour_map = match_colours(colours, self.painting.flatten(1).T, weights)

        def matched(view: int) -> np.ndarray:
            rgba = self._rgba(photos[view], view)
            return self._over(colour_map.image(rgba[:3]).permute(1, 2, 0).numpy(), rgba[3].numpy())

        return matched

    def _rgba(self, photo: np.ndarray, view: int) -> torch.Tensor:
        """[4, h, w]: straight colour of the object and its coverage by the field's own alpha, before anything moves."""
        alpha = np.ones(photo.shape[:2], np.float32) if self.closed else self.still.alpha(view)
        return torch.from_numpy(np.concatenate([photo, alpha[..., None]], -1)).permute(2, 0, 1)

    def _over(self, rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """Straight rgb over the background."""
        return (rgb * alpha[..., None] + (1 - alpha[..., None]) * self.background).astype(np.float32)

    # -- steps ------------------------------------------------------------------------------------------------------

    @property
    def progress(self) -> float:
        """Done share of the present phase, 0..1."""
        s, state = self.settings, self.state
        if state.phase == "refit":
            return min(1.0, state.step / max(1, s.refit_steps))
        return min(1.0, state.step / s.steps if s.steps else state.seconds / s.seconds)

    def refit_step(self) -> float:
        """One step of colours towards the matched photos; its mean squared error."""
        generator = np.random.default_rng([self.seed, 2, self.state.step])
        view = int(generator.integers(len(self.cameras)))
        covered = self.geometry.alpha(view).ravel()
        lit = np.flatnonzero(covered > 1e-3)
        if len(lit) == 0:
            return 0.0
        pixels = lit[generator.integers(0, len(lit), self.settings.refit_pixels)]
        rgb, kept = self.geometry.paint(view, pixels)
        alpha = covered[pixels, None]
        difference = rgb + (1 - alpha) * self.background - self.photos[view].reshape(-1, 3)[pixels]
        self.geometry.learn(kept, difference * np.float32(2 / difference.size), self.adam.gradients)
        self.adam.step(self.settings.refit_rate * 0.1**self.progress)
        return float(np.square(difference).mean())

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
        falling = settings.final_rate**self.progress
        self.adam.step(settings.rate * falling)
        if self.deformer is not None:
            weight = settings.displacement_weight
            parts["displacement"] = self.deformer.step(settings.deform_rate * falling, weight)
        return parts

    def _view_of_step(self) -> int:
        """Every view once an epoch, in an order drawn anew for each."""
        epoch, at = divmod(self.state.step, len(self.cameras))
        return int(np.random.default_rng([self.seed, 3, epoch]).permutation(len(self.cameras))[at])

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

    def paint_view(self, view: int, geometry: FixedGeometry | None = None) -> np.ndarray:
        """Premultiplied rgb of a whole view, [h*w, 3], in parts of bounded memory; as it stands, or in `geometry`."""
        geometry = geometry or self.geometry
        count = self.cameras[view].width * self.cameras[view].height
        parts = [np.arange(at, min(at + PIXELS_AT_ONCE, count)) for at in range(0, count, PIXELS_AT_ONCE)]
        return np.concatenate([geometry.paint(view, part)[0] for part in parts])

    def _gradient(self, view: int, premultiplied: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
        """dL/d(picture) [h, w, 3] and the parts of the loss."""
        camera = self.cameras[view]
        rgb = premultiplied.reshape(camera.height, camera.width, 3)
        alpha = None
        if not self.closed:
            coverage = self.geometry.alpha(view)
            rgb = rgb + (1 - coverage[..., None]) * self.background
            alpha = torch.from_numpy(coverage).to(self.objective.device)
        there = torch.from_numpy(np.ascontiguousarray(rgb)).to(self.objective.device)
        picture = there.permute(2, 0, 1).contiguous().requires_grad_()
        loss, parts = self.objective(picture, self._content_of(view), alpha, self.windows[view])
        loss.backward()
        return picture.grad.permute(1, 2, 0).contiguous().cpu().numpy(), parts

    @property
    def objective(self) -> StyleObjective:
        """The loss as it stands at this step, its features of the painting computed at first use."""
        s = self.settings
        scale = s.feature_scale / 2 if self.progress < s.coarse else s.feature_scale
        if self._objective is None or self._objective.scale != scale:
            self._content = self._kept_content()  # at another scale
            self._objective = StyleObjective(
                self.trunk,
                self.painting,
                (self.cameras[0].height, self.cameras[0].width),
                s.weights,
                scale,
                s.style_rows,
                s.style_basis,
                s.style_scale,
                self.seed,
                s.variation,
                BESIDE if self.deformer is not None else 0,
            )
        return self._objective

    def _content_of(self, view: int) -> Content | None:
        if not self.settings.weights.need_photo:
            return None
        return self._content[view]

    def _kept_content(self) -> Kept:
        """What the views' photos show to the objective as it stands."""

        def content(view: int) -> Content:
            photo = torch.from_numpy(self.photos[view]).to(self.objective.device).permute(2, 0, 1).contiguous()
            return self.objective.content_of(photo, self.windows[view])

        return Kept(content, lambda made: made.bytes, len(self.cameras), CONTENT * self.memory)

    # -- the loop ---------------------------------------------------------------------------------------------------

    def run(self, on_step: Callable[["Stylizer"], None] = lambda stylizer: None) -> None:
        """All phases; on_step is told after every step."""
        state = self.state
        while state.phase != "done":
            while self.progress < 1.0:
                begun, self.between_steps = time.perf_counter(), False
                parts = {"mse": self.refit_step()} if state.phase == "refit" else self.style_step()
                if not all(math.isfinite(v) for v in parts.values()):
                    raise Diverged(f"{state.phase} step {state.step}: the loss left the finite numbers ({parts})")
                state.seconds += time.perf_counter() - begun
                state.step += 1
                if state.step % 10 == 0:
                    rounded = {k: round(v, 5) for k, v in parts.items()}
                    state.curve.append(
                        {"phase": state.phase, "step": state.step, "seconds": round(state.seconds, 2), **rounded}
                    )
                self.between_steps = True
                on_step(self)
            self._next_phase()

    def _next_phase(self) -> None:
        state = self.state
        if state.phase == "refit":
            self.between_steps = False  # half of this change would make a checkpoint of neither phase
            state.phase, state.step, state.seconds = "style", 0, 0.0
            self._let_shapes_move()
            self._collect()
            self.adam = self._new_adam()
            self.between_steps = True
            return
        if self.settings.match in ("after", "both"):
            self.field = replace(self.field, colour_map=self.final_match())
        self._collect()
        # Last: a checkpoint holds no colour map, so one of an interrupted match must not say that all is done.
        state.phase = "done"

    def _let_shapes_move(self) -> None:
        if self.deformer is not None:
            s = self.settings
            self.geometry = MovingGeometry(
                self.field, self.cameras, s.share, self.chunks, float(self.background), self.deformer, self.still
            )

    def final_match(self) -> ColourMap:
        """The map from the rendered views' colours to the painting's (ARF's last step), from up to MATCHED_VIEWS."""
        stacked, count = [], len(self.cameras)
        for view in np.unique(np.linspace(0, count - 1, min(count, MATCHED_VIEWS)).round().astype(int)):
            camera = self.cameras[view]
            rgb = self.paint_view(view).reshape(camera.height, camera.width, 3)
            alpha = self.geometry.alpha(view)[..., None]
            rgba = np.concatenate([rgb / np.maximum(alpha, 1e-3), np.where(alpha > 0.5, alpha, 0)], -1)
            stacked.append(torch.from_numpy(rgba.astype(np.float32)).permute(2, 0, 1))
        colours, weights = pixels_of(stacked, seed=self.seed)
        return match_colours(colours.clamp(0, 1), self.painting.flatten(1).T, weights)

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) to go on from."""
        self._collect()
        arrays = {"colour": self.field.colour.values.copy()}
        arrays |= {f"adam.{k}": v.copy() for k, v in self.adam.arrays().items()}
        arrays |= {f"seen.{view}": picture.astype(np.float32) for view, picture in self._remembered.items()}
        if self.deformer is not None:
            arrays |= {f"deform.{k}": v for k, v in self.deformer.arrays().items()}
            if self.state.phase != "refit":
                arrays |= {f"alpha.{view}": alpha for view, alpha in self.geometry.alphas.items()}
        return {"state": vars(self.state)}, arrays

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """From checkpoint()."""
        self.state = StyleState(**data["state"])
        self.field.colour.values[:] = arrays["colour"]
        self.adam = self._new_adam()
        self.adam.restore({k: arrays[f"adam.{k}"] for k in ("first", "second", "steps")})
        self._remembered = {int(k[5:]): v.copy() for k, v in arrays.items() if k.startswith("seen.")}
        if self.deformer is not None:
            self.deformer.restore({k[7:]: v for k, v in arrays.items() if k.startswith("deform.")})
            if self.state.phase != "refit":
                self._let_shapes_move()
                self.geometry.alphas = {int(k[6:]): v.copy() for k, v in arrays.items() if k.startswith("alpha.")}
