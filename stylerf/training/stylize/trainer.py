"""What all whole-scene stylizations share: shapes seen once, a new color fitted to the matched photos, pictures
painted with it, the loop, and checkpoints.

The density part stays. A new color part with local detail learns the color-matched photos (refit); then a method
teaches it (its `_step`, in its own phases); at the end colors are matched to the painting once more.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from stylerf.errors import InvalidValue
from stylerf.fields.color_map import ColorMap
from stylerf.fields.gpu.memory import free_on
from stylerf.fields.packed_surface import pixel_cells
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.regions import weights_inside
from stylerf.rendering.ray_registration import SOLID
from stylerf.style.color_matching import match_colors, spread_at_least, spread_at_most, strokes_in
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.style_objective import EVERYTHING, Content, GramObjective, StyleObjective, window_of
from stylerf.training.common.adam import Adam
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.divergence_guard import DivergenceGuard, finite
from stylerf.training.stylize.geometry import FixedGeometry, MovingGeometry
from stylerf.training.stylize.matched_photos import ObjectPhotos, rendered_match
from stylerf.training.stylize.settings import StyleSettings, StyleState

PIXELS_AT_ONCE = 65536
MATCHED_VIEWS = 24  # their colors are those of all
MEMORY = 8e9  # bytes
# Parts of the memory: a march takes seconds to repeat, features about as long, a photo a tenth of that.
SURFACES, CONTENT, PHOTOS = 0.5, 0.35, 0.15
PARTS = 0.05  # beyond these: what belongs to a part of the scene
OBJECTIVES = {"nnfm": StyleObjective, "gram": GramObjective}


class StylizationTrainer:
    """photos: per view [h, w, 3] float32 over the background, sRGB 0..1; read anew where they are not kept.

    background: level of gray behind the field. new_color: the color to learn, from a generator and the cells a side
    that are as wide as a pixel sees (nan: nothing is seen). memory: bytes that surfaces, features and photos may take
    together; those beyond are made anew each time. What lies on a GPU is bounded by what is free there. device: where
    rays are followed; None: by the CPU. The trunk works where it lies.

    within: cells [s, s, s] of the cube whose part of the scene alone is looked at, matched and taught; new_color then
    gives colors over the scene's own, which stand everywhere else. InvalidValue where no view shows it.
    """

    PHASES: tuple[str, ...] = ("refit", "style")
    around = 0  # feature positions beside a silhouette that count too

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
        memory: float = MEMORY,
        device: str | None = None,
        within: np.ndarray | None = None,
    ) -> None:
        self.device, self.memory, self.within = device, memory, within
        weights, strokes = settings.weights, strokes_in(painting, settings.least_spread)
        # A painting that counts as less of a style moves shapes less, too: Adam's steps are as long for a weak loss.
        weights, rate = replace(weights, style=strokes * weights.style), strokes * settings.deform_rate
        settings = replace(settings, weights=weights, deform_rate=rate)
        self.settings, self.seed, self.chunks, self.background = settings, seed, chunks, np.float32(background)
        self._guard = DivergenceGuard(settings)
        self.cameras, self.painting, self.trunk = cameras, painting, trunk
        self._palette = spread_at_least(painting, settings.least_spread)
        threshold = scene.weight_threshold if self.partial else settings.share
        self.field = replace(scene, color_map=None, weight_threshold=threshold)
        self.closed = scene.opaque_background
        self._prepare_shapes()
        self.still = self._fixed_geometry()
        self.geometry: FixedGeometry | MovingGeometry = self.still
        self._parts = BoundedCache(self._part_of, lambda part: part.nbytes, len(cameras), PARTS * memory)
        self.shown = [view for view in range(len(cameras)) if not self.partial or (self._parts[view] > SOLID).any()]
        if not self.shown:
            raise InvalidValue("no training view shows anything of the region")
        self.field.color = new_color(np.random.default_rng([seed, 1]), self._pixel_cells())
        self.still.field.color = self.field.color
        self.adam = self._new_adam()
        least = math.ceil(2 * self.stride / settings.feature_scale * (2 if settings.coarse > 0 else 1))
        self.windows = [
            EVERYTHING if self._all_counts else window_of(self.counted(view), least) for view in range(len(cameras))
        ]
        self.photos = BoundedCache(self._matched(photos), lambda photo: photo.nbytes, len(cameras), PHOTOS * memory)
        self.state = StyleState()
        # Where features are; of a GPU half of what surfaces have left free: steps need room too.
        self.memory_there = free_on("cpu" if trunk is None else trunk.input_scale.device, 2 * memory) / 2
        self._objective: StyleObjective | None = None
        self._content = self._kept_content()
        self.between_steps = True

    # -- what a method decides --------------------------------------------------------------------------------------

    @property
    def stride(self) -> int:
        """Pixels between positions of the deepest features that are looked at."""
        return self.trunk.stride

    def _prepare_shapes(self) -> None:
        """Before the field is first seen."""

    def _step(self) -> dict[str, float]:
        """One step of a phase beyond the refit; the parts of its loss."""
        raise NotImplementedError

    def _phase_begins(self) -> None:
        """state.phase has just been set, or restored."""

    def _own_arrays(self) -> dict[str, np.ndarray]:
        """What a checkpoint needs beside colors and optimizer."""
        return {}

    def _restore_own(self, arrays: dict[str, np.ndarray]) -> None:
        """From _own_arrays(); the phase is set."""

    # -- seeing -----------------------------------------------------------------------------------------------------

    def _fixed_geometry(self) -> FixedGeometry:
        # Its shapes as they now are, for good; its colors go on learning.
        moved = self.field.displacement
        still = replace(self.field, displacement=None if moved is None else moved.copy())
        if self.device is None:
            return FixedGeometry(still, self.cameras, self.settings.share, self.chunks, SURFACES * self.memory)
        from stylerf.training.stylize.geometry_gpu import GpuFixedGeometry

        return GpuFixedGeometry(still, self.cameras, self.settings.share, self.device)

    def _new_adam(self) -> Adam:
        """An optimizer of the colors as they stand, without a past."""
        if self.device is None:
            return Adam(self.field.color.values, self.field.color.groups(), self.chunks, self.settings.clip)
        return self.still.new_adam(self.settings.clip)

    def _collect(self) -> None:
        """Bring what the colors have learned on a device into the field's own array."""
        if self.device is not None:
            self.still.collect()

    def _pixel_cells(self) -> float:
        """Cells a side of the cube as wide as what a pixel sees: the median of up to four views, nan if none sees."""
        chosen = np.unique(np.linspace(0, len(self.cameras) - 1, 4).round().astype(int))
        return pixel_cells(self.still.surface(view) for view in chosen)

    @property
    def partial(self) -> bool:
        """Whether only a part of the scene is stylized."""
        return self.within is not None

    @property
    def _all_counts(self) -> bool:
        return self.closed and not self.partial

    def counted(self, view: int) -> np.ndarray:
        """[h, w]: how much of a pixel is object, or belongs to the part that is stylized."""
        return self._parts[view] if self.partial else self.geometry.alpha(view)

    def _part_of(self, view: int) -> np.ndarray:
        points = self.still.surface(view).samples(np.arange(self.still.alpha(view).size))
        part = np.zeros(len(points.ends), np.float32)
        cells = np.ascontiguousarray(self.within).reshape(-1)
        weights_inside(cells, len(self.within), points, self.chunks, part)
        return np.clip(part, 0, 1).reshape(self.still.alpha(view).shape)

    def _matched(self, photos: Sequence[np.ndarray]) -> Callable[[int], np.ndarray]:
        """The photos in the painting's colors, where that is asked for. Settles which colors those are."""
        if self.settings.match == "none":
            return photos.__getitem__

        def alpha(view: int) -> np.ndarray:
            if self._all_counts:
                return np.ones((self.cameras[view].height, self.cameras[view].width), np.float32)
            return self._parts[view] if self.partial else self.still.alpha(view)

        of_object = ObjectPhotos(photos, alpha, None if self.partial else self.background)
        colors, weights = of_object.colors(self.seed, sum(camera.width * camera.height for camera in self.cameras))
        # Both matches aim at these colors: two that were bounded apart would stretch twice as far.
        self._palette = spread_at_most(self._palette, colors, self.settings.most_gain, weights)
        if self.settings.match == "after":
            return photos.__getitem__
        color_map = match_colors(colors, self._palette.flatten(1).T, weights)
        return lambda view: of_object.mapped(view, color_map)

    def paint_view(self, view: int, geometry: FixedGeometry | None = None) -> np.ndarray:
        """Premultiplied rgb of a whole view, [h*w, 3], in parts of bounded memory; as it stands, or in `geometry`."""
        geometry = geometry or self.geometry
        count = self.cameras[view].width * self.cameras[view].height
        parts = [np.arange(at, min(at + PIXELS_AT_ONCE, count)) for at in range(0, count, PIXELS_AT_ONCE)]
        return np.concatenate([geometry.paint(view, part)[0] for part in parts])

    @property
    def objective(self) -> StyleObjective:
        """The loss as it stands at this step, its features of the painting computed at first use."""
        s = self.settings
        scale = s.feature_scale / 2 if self.progress < s.coarse else s.feature_scale
        if self._objective is None or self._objective.scale != scale:
            self._content = self._kept_content()  # at another scale
            size = (self.cameras[0].height, self.cameras[0].width)
            given = (s.weights, scale, s.style_rows, s.style_basis, s.style_scale, self.seed, s.variation, self.around)
            self._objective = OBJECTIVES[s.loss](self.trunk, self.painting, size, *given)
        return self._objective

    def _content_of(self, view: int) -> Content | None:
        if not self.settings.weights.need_photo:
            return None
        return self._content[view]

    def _kept_content(self) -> BoundedCache:
        """What the views' photos show to the objective as it stands."""

        def content(view: int) -> Content:
            return self.objective.content_of(self._there(self.photos[view]), self.windows[view])

        return BoundedCache(content, lambda made: made.bytes, len(self.cameras), CONTENT * self.memory_there)

    def _there(self, image: np.ndarray) -> torch.Tensor:
        """An image [h, w, 3] as [3, h, w] where the trunk lies."""
        there = torch.from_numpy(np.ascontiguousarray(image)).to(self.trunk.input_scale.device)
        return there.permute(2, 0, 1).contiguous()

    def _alpha_there(self, view: int) -> torch.Tensor | None:
        """counted(view), [h, w], where the trunk lies; None for a whole capture, which fills its pictures."""
        if self._all_counts:
            return None
        return torch.from_numpy(self.counted(view)).to(self.trunk.input_scale.device)

    @property
    def progress(self) -> float:
        """Done share of the present phase, 0..1."""
        s, state = self.settings, self.state
        if state.phase == "refit":
            return min(1.0, state.step / max(1, s.refit_steps))
        return min(1.0, state.step / s.steps if s.steps else state.seconds / s.seconds)

    @property
    def steps_of_phase(self) -> int:
        """Of the present phase; 0 where time decides."""
        return self.settings.refit_steps if self.state.phase == "refit" else self.settings.steps

    def refit_step(self) -> float:
        """One step of colors towards the matched photos; its mean squared error."""
        generator = np.random.default_rng([self.seed, 2, self.state.step])
        view = self.shown[int(generator.integers(len(self.shown)))]
        error = self._learn_image(view, self.photos[view], generator)
        if error is None:
            return 0.0
        self.adam.step(self.settings.refit_rate * 0.1**self.progress)
        return error

    def _learn_image(
        self, view: int, image: np.ndarray, generator: np.random.Generator, weight: float = 1.0
    ) -> float | None:
        """Adds the gradient of `weight` times the mean squared error to an image [h, w, 3] of the view.

        Over `refit_pixels` random pixels of those that count. Returns the error, None where none does.
        """
        lit = np.flatnonzero(self.counted(view).ravel() > 1e-3)
        if len(lit) == 0:
            return None
        pixels = lit[generator.integers(0, len(lit), self.settings.refit_pixels)]
        return self._learn_pixels(view, pixels, image.reshape(-1, 3)[pixels], weight)

    def _learn_pixels(self, view: int, pixels: np.ndarray, wanted: np.ndarray, weight: float = 1.0) -> float:
        """Adds the gradient of the mean squared error of pixels [n] to colors [n, 3] over the background."""
        rgb, kept = self.geometry.paint(view, pixels)
        alpha = self.geometry.alpha(view).ravel()[pixels, None]
        difference = rgb + (1 - alpha) * self.background - wanted
        self.geometry.learn(kept, difference * np.float32(2 * weight / difference.size), self.adam.gradients)
        return float(np.square(difference).mean())

    # -- the loop ---------------------------------------------------------------------------------------------------

    def run(self, on_step: Callable[["StylizationTrainer"], None] = lambda stylizer: None) -> None:
        """All phases; on_step is told after every step."""
        state = self.state
        while state.phase != "done":
            timed = False  # a process's first step of a phase compiles
            while self.progress < 1.0:
                begun, self.between_steps = time.perf_counter(), False
                parts = {"mse": self.refit_step()} if state.phase == "refit" else self._step()
                state.seconds += (time.perf_counter() - begun) * timed
                timed = True
                if not all(math.isfinite(v) for v in parts.values()):
                    self._guard.go_back(self, parts)
                    state = self.state
                    continue
                state.step += 1
                if state.step % 10 == 0:
                    rounded = {k: round(v, 5) for k, v in parts.items()}
                    state.curve.append(
                        {"phase": state.phase, "step": state.step, "seconds": round(state.seconds, 2), **rounded}
                    )
                self._guard.look(self)
                self.between_steps = True
                on_step(self)
            if not finite(self.checkpoint()[1]):  # the last step's own result, which no loss has told of
                self._guard.go_back(self, {"values": math.nan})
                state = self.state
                continue
            self._next_phase()

    def _next_phase(self) -> None:
        state = self.state
        if state.phase != self.PHASES[-1]:
            self.between_steps = False  # half of this change would make a checkpoint of neither phase
            state.phase, state.step, state.seconds = self.PHASES[self.PHASES.index(state.phase) + 1], 0, 0.0
            self._phase_begins()
            self._collect()
            self.adam = self._new_adam()
            self.between_steps = True
            return
        self._collect()
        if self.settings.match in ("after", "both"):
            self.field = replace(self.field, color_map=self.final_match())
        # Last: a checkpoint holds no color map, so one of an interrupted match must not say that all is done.
        state.phase = "done"

    def final_match(self) -> ColorMap:
        """The map from the rendered views' colors to the painting's (ARF's last step), from up to MATCHED_VIEWS."""
        count = len(self.cameras)
        chosen = np.unique(np.linspace(0, count - 1, min(count, MATCHED_VIEWS)).round().astype(int))
        pictures = (
            (self.paint_view(view).reshape(*self.geometry.alpha(view).shape, 3), self.geometry.alpha(view))
            for view in chosen
        )
        return rendered_match(pictures, self._palette, self.seed)

    def checkpoint(self) -> tuple[dict, dict[str, np.ndarray]]:
        """(JSON, arrays) to go on from."""
        self._collect()
        arrays = {"color": self.field.color.values.copy()}
        arrays |= {f"adam.{k}": v.copy() for k, v in self.adam.arrays().items()}
        return {"state": vars(self.state)}, arrays | self._own_arrays()

    def resume(self, data: dict, arrays: dict[str, np.ndarray]) -> None:
        """From checkpoint()."""
        self.state = StyleState(**data["state"])
        self.settings = self._guard.paced(self.settings, self.state)
        self.field.color.values[:] = arrays["color"]
        self.adam = self._new_adam()
        self.adam.restore({k: arrays[f"adam.{k}"] for k in ("first", "second", "steps")})
        if self.state.phase != "refit":
            self._phase_begins()
        self._restore_own(arrays)
        self._guard.look(self)
