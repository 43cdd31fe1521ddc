"""The scene that a method stylizes: its density stays, a new color learns, and perhaps a deformation.

StyleProblem holds what is given; StyledScene holds what changes. Methods render its views and add gradients to it.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.fields.color_map import ColorMap
from stylerf.fields.deformation import Deformation, at_rest
from stylerf.fields.hash_grid import DETAIL, HashColor
from stylerf.fields.packed_surface import pixel_cells
from stylerf.fields.protocol import ColorPart
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.geometry.cameras import Camera, evenly_spaced
from stylerf.kernels.cpu.regions import weights_inside
from stylerf.rendering.ray_registration import SOLID
from stylerf.style.color_matching import (
    SAMPLE,
    in_brightness_of,
    in_colors_of,
    match_colors,
    pixels_of,
    sample_of,
    spread_at_least,
    spread_at_most,
    strokes_in,
)
from stylerf.style.transparency import shown_colors
from stylerf.training.common.adam import Optimizer, moments_of, restore_moments
from stylerf.training.common.bounded_cache import BoundedCache, PerView
from stylerf.training.common.even_draws import drawn_evenly
from stylerf.training.deform.deformer import AnyDeformer, Deformer
from stylerf.training.stylize.geometry import AnyRayGeometry, FixedGeometry, Geometry, MovingGeometry, Surfaces
from stylerf.training.stylize.settings import (
    REFIT,
    ArfSettings,
    DesrfSettings,
    ImageStyleSettings,
    StyleSettings,
    StyleState,
)

COLOR, FINEST = "color", "finest"  # arrays of a checkpoint: the new color's values, cells of its finest level
Settings_co = TypeVar("Settings_co", bound=StyleSettings, covariant=True)


@dataclass(frozen=True, eq=False)
class ObjectPhotos:
    """Photos without their background.

    Attributes:
        photos: [h, w, 3] over the background.
        alpha: Coverage of a view, [h, w], before anything moves.
        background: Gray level; None: a region is covered, and the photos stay as they are beside it.
    """

    photos: PerView[np.ndarray]
    alpha: Callable[[int], np.ndarray]
    background: np.float32 | None

    def __call__(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Premultiplied rgb [h, w, 3] without the background, and its coverage [h, w]."""
        coverage = self.alpha(view)
        behind = (1 - coverage[..., None]) * self._beside(view)
        return np.clip(self.photos[view] - behind, 0, coverage[..., None]), coverage

    def _beside(self, view: int) -> np.ndarray | np.float32:
        return self.photos[view] if self.background is None else self.background

    def colors(self, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
        """A sample of the colors [n, 3] of covered pixels, and their weights [n]."""
        views = range(len(self.photos))
        covered = sum(int((self.alpha(view) > 0).sum()) for view in views)
        return pixels_of((straight_rgba(*self(view)) for view in views), seed=seed, count=covered)

    def mapped(self, view: int, color_map: ColorMap) -> np.ndarray:
        """A photo with the object's colors mapped, [h, w, 3]; the background stays."""
        rgb, coverage = self(view)
        mapped = color_map.premultiplied(torch.from_numpy(rgb), torch.from_numpy(coverage)).numpy()
        level = coverage[..., None]
        return (np.clip(mapped, 0, level) + (1 - level) * self._beside(view)).astype(np.float32)


def straight_rgba(rgb: np.ndarray, coverage: np.ndarray, threshold: float = 0.0) -> torch.Tensor:
    """[4, h, w] float32 of premultiplied rgb [h, w, 3]; alpha 0 where the coverage is at most `threshold`."""
    alpha = coverage[..., None]
    # 1e-3 bounds the quotient where almost nothing is seen; such a pixel hardly weighs in what follows.
    rgba = np.concatenate([rgb / np.maximum(alpha, 1e-3), np.where(alpha > threshold, alpha, 0)], -1)
    return torch.from_numpy(rgba.astype(np.float32)).permute(2, 0, 1)


def rendered_match(
    pictures: Iterable[tuple[np.ndarray, np.ndarray]],  # premultiplied rgb [h, w, 3], alpha [h, w]
    style_image: torch.Tensor,
    seed: int,
    count: int = 1,
) -> ColorMap:
    """The map from renders' colors to the style image's (ARF's last step). count: number of pictures.

    Pixels that are half covered or less do not count, unless there are no others: in haze, or of rods thinner than a
    pixel. Of each picture only a sample is kept.
    """
    generator = torch.Generator().manual_seed(seed)
    solid: list[tuple[Tensor, Tensor]] = []
    hazy: list[tuple[Tensor, Tensor]] = []
    for rgb, alpha in pictures:
        opaque = bool((alpha > SOLID).any())
        # Dividing by a small alpha amplifies noise, which would count as colors.
        rgba = straight_rgba(rgb, alpha, SOLID if opaque else 0)
        (solid if opaque else hazy).append(sample_of(rgba, round(SAMPLE / count), generator))
    colors, weights = (torch.cat(parts) for parts in zip(*(solid or hazy), strict=True))
    return match_colors(colors.clamp(0, 1), style_image.flatten(1).T, weights)


PIXELS_AT_ONCE = 65536
MATCHED_VIEWS = 24  # views whose colors stand for those of all
MEMORY = 8e9  # bytes
# Fractions of the memory. A march takes seconds to repeat, features about as long, a photo a tenth of that.
SURFACES, CONTENT, PHOTOS = 0.5, 0.35, 0.15
REGION_MASKS = 0.05  # beyond these
REFIT_DETAIL_RATE = 0.2  # of the finest colors in the refit, see HashColor: few pixels teach each of them (0065)
COARSEST_STEP = 1 / 128  # cube units; of a deforming field, whose rays are marched again in every step


@dataclass(frozen=True)
class StyleBackend:
    """Makes what differs between CPU and GPU (training/backends.py picks one)."""

    deformer: Callable[..., AnyDeformer]
    fixed_geometry: Callable[..., Surfaces]
    moving_geometry: Callable[..., AnyRayGeometry]


CPU = StyleBackend(Deformer, FixedGeometry, MovingGeometry)


@dataclass(frozen=True, eq=False)
class StyleProblem(Generic[Settings_co]):
    """What a stylization is given.

    Attributes:
        field: The fitted field, whose density stays.
        cameras, photos: Training views: [h, w, 3] float32 sRGB 0..1 over the background; read again where not cached.
        background: Gray level behind the field.
        style_image: [3 or 4, h, w] sRGB 0..1; None if the method has none. A fourth channel is an alpha of 0 or 1.
        deformation: Network that moves the shapes too (DeSRF); None: they stay.
        region: Cells [s, s, s] of the cube; only this part of the scene is shown, matched and stylized, and new_color
            gives colors over the scene's own.
        memory: Bytes that surfaces, features and photos may take; what does not fit is recomputed at each use. On a
            GPU, what is free there bounds it.
        backend: Where rays are marched.
    """

    field: RadianceField
    cameras: list[Camera]
    photos: PerView[np.ndarray]
    background: float
    settings: Settings_co
    seed: int
    threads: int
    style_image: Tensor | None = None
    deformation: Deformation | None = None
    region: np.ndarray | None = None
    memory: float = MEMORY
    backend: StyleBackend = CPU


class PhaseBudget:
    """How far the present phase is."""

    def __init__(self, scene: "StyledScene[StyleSettings]") -> None:
        self.scene = scene

    @property
    def steps(self) -> int:
        """Steps of the present phase; 0 if time limits it."""
        settings = self.scene.settings
        return settings.refit_steps if self.scene.state.phase == REFIT else settings.steps

    @property
    def progress(self) -> float:
        """Fraction of the present phase that is done, 0..1."""
        s, state = self.scene.settings, self.scene.state
        if state.phase == REFIT:
            return min(1.0, state.step / max(1, s.refit_steps))
        return min(1.0, state.step / s.steps if s.steps else state.seconds / s.seconds)


class StyledScene(Generic[Settings_co]):
    """Renders views in the new color and collects gradients of it.

    Args:
        new_color: Makes the color to learn, from a generator and this scene, whose surfaces are known by then.

    Attributes:
        field: The field with its new color.
        fixed: Its surfaces before anything moved.
        geometry: What is rendered: `fixed`, or the deforming field after start_moving().
        shown: Views that show something to stylize.
        photos: The views' photos, in the style image's colors if settings.match says so.
        style_image: Image whose features are matched; None without a style image.
        style_colors: Image whose colors are matched, without what is transparent; None without a style image.
        behind: Color [3] behind a deforming object when it is compared with the style image, whose mean it is.

    Raises:
        InvalidValue: No view shows anything of the region.
    """

    def __init__(
        self,
        problem: StyleProblem[Settings_co],
        new_color: Callable[[np.random.Generator, "StyledScene[Settings_co]"], ColorPart],
    ) -> None:
        self.problem, self.cameras, self.background = problem, problem.cameras, np.float32(problem.background)
        self.state, self.style_image, self.style_colors = StyleState(), problem.style_image, problem.style_image
        self.settings: Settings_co = problem.settings
        min_spread = self.settings.min_spread
        if problem.style_image is not None:
            self.style_colors = shown_colors(problem.style_image)
            self.settings = self.settings.for_style(strokes_in(self.style_colors, min_spread))
            self.style_colors = spread_at_least(self.style_colors, min_spread)
        threshold = problem.field.weight_threshold if self.of_region else self.settings.weight_threshold
        # A region's colors lie over the field's own, which keep the map that they are shown through.
        color_map = problem.field.color_map if self.of_region else None
        self.field = replace(problem.field, color_map=color_map, weight_threshold=threshold)
        self.deformer = self._new_deformer()
        self.fixed = self._fixed_geometry()
        self.geometry: Geometry = self.fixed
        self._moving: AnyRayGeometry | None = None
        views, memory = len(self.cameras), problem.memory
        self._region_masks = BoundedCache(self._region_mask, lambda mask: mask.nbytes, views, REGION_MASKS * memory)
        self.shown = [v for v in range(views) if not self.of_region or (self._region_masks[v] > SOLID).any()]
        if not self.shown:
            raise InvalidValue("no training view shows anything of the region")
        self.field.color = new_color(np.random.default_rng([problem.seed, 1]), self)
        self.fixed.field.color = self.field.color
        self.adam = self.new_adam()
        self.photos = BoundedCache(self._matched(problem.photos), lambda p: p.nbytes, views, PHOTOS * memory)
        self.budget = PhaseBudget(self)
        shown = self.style_colors
        self.behind = np.full(3, self.background) if shown is None else shown.flatten(1).mean(1).numpy()

    def _new_deformer(self) -> AnyDeformer | None:
        p, settings = self.problem, self.settings
        if p.deformation is None:
            return None
        if not isinstance(settings, DesrfSettings):
            raise InvalidValue("a deformation is trained by desrf only")
        at_rest(self.field)  # at the step that its densities were fitted with
        # A march costs by its samples, and its step cannot change later: colors are learned where it samples them.
        self.field.step = max(self.field.step, COARSEST_STEP)
        vertices, clip, anchored = settings.displacement_vertices, settings.gradient_clip, True
        return p.backend.deformer(self.field, p.deformation, p.cameras, vertices, p.seed, p.threads, clip, anchored)

    def _fixed_geometry(self) -> Surfaces:
        # A snapshot of the shapes; the color keeps training.
        moved, p = self.field.displacement, self.problem
        still = replace(self.field, displacement=None if moved is None else moved.copy())
        threshold = self.settings.weight_threshold
        return p.backend.fixed_geometry(still, p.cameras, threshold, p.threads, SURFACES * p.memory)

    def new_adam(self) -> Optimizer:
        """An optimizer of the present colors, its moments at zero."""
        color, side = self.field.color, 1.0  # of its grid, in cube units
        if isinstance(color, RegionColor):
            side, color = color.side, color.own
        if isinstance(color, HashColor):
            color.detail_rate, color.detail, color.broad, narrow = self._rates_by_width()
            # nan if nothing is seen: all levels learn.
            color.narrow = narrow * color.finest / (side * self.pixel_cells()) if narrow else 0.0
        return self.fixed.new_adam(self.settings.gradient_clip)

    def _rates_by_width(self) -> tuple[float, float, float, float]:
        """Return HashColor's detail_rate, detail and broad for the present phase, and ArfSettings.narrow."""
        if self.state.phase == REFIT:
            return REFIT_DETAIL_RATE, DETAIL, math.inf, 0.0
        if isinstance(s := self.settings, ArfSettings):
            return s.detail_rate, s.detail, s.broad, s.narrow
        return 1.0, DETAIL, math.inf, 0.0

    def collect(self) -> None:
        """Copy what a GPU has learned into the field's own arrays."""
        self.fixed.collect()
        if self.deformer is not None:
            self.deformer.collect()

    def start_moving(self) -> None:
        """From now on, render the deforming field; without a deformation, nothing changes."""
        if self.deformer is not None:
            p, threshold = self.problem, self.settings.weight_threshold
            self._moving = self.geometry = p.backend.moving_geometry(
                self.field, p.cameras, threshold, p.threads, self.behind, self.deformer, self.fixed
            )

    # -- views ------------------------------------------------------------------------------------------------------

    def pixel_cells(self) -> float:
        """Cells per side of the cube that are as wide as a pixel: median of four views, nan if nothing is seen."""
        chosen = np.unique(np.linspace(0, len(self.cameras) - 1, 4).round().astype(int))
        return pixel_cells(self.fixed.surface(view) for view in chosen)

    @property
    def of_region(self) -> bool:
        """Whether only a region is stylized."""
        return self.problem.region is not None

    @property
    def fills_views(self) -> bool:
        """Whether every pixel of every view counts: a whole capture, whose background is opaque."""
        return self.field.opaque_background and not self.of_region

    def coverage(self, view: int) -> np.ndarray:
        """How much of each pixel is object, or belongs to the region, [h, w] in 0..1."""
        return self._region_masks[view] if self.of_region else self.geometry.alpha(view)

    def _region_mask(self, view: int) -> np.ndarray:
        points = self.fixed.surface(view).samples(np.arange(self.fixed.alpha(view).size))
        part, region = np.zeros(len(points.ends), np.float32), np.ascontiguousarray(self.problem.region)
        weights_inside(region.reshape(-1), len(region), points, self.problem.threads, part)
        return np.clip(part, 0, 1).reshape(self.fixed.alpha(view).shape)

    def _matched(self, photos: PerView[np.ndarray]) -> Callable[[int], np.ndarray]:
        """Reads a photo, in the style image's colors if it is matched before; sets style_colors."""
        s, p = self.settings, self.problem
        if s.match == "none":
            return photos.__getitem__
        if self.style_colors is None:
            raise InvalidValue("colors can only be matched to those of a style image")

        def alpha(view: int) -> np.ndarray:
            if self.fills_views:
                return np.ones((self.cameras[view].height, self.cameras[view].width), np.float32)
            return self._region_masks[view] if self.of_region else self.fixed.alpha(view)

        of_object = ObjectPhotos(photos, alpha, None if self.of_region else self.background)
        colors, weights = of_object.colors(p.seed)
        if isinstance(s, ImageStyleSettings) and s.keep_colors and self.style_image is not None:
            self.style_colors = shown_colors(in_colors_of(self.style_image, colors, weights))
            self.style_image = in_brightness_of(self.style_image, colors, weights)
            return photos.__getitem__
        # Both matches aim at these colors: two bounds, one after the other, would allow their product.
        self.style_colors = spread_at_most(self.style_colors, colors, s.max_gain, weights)
        if s.match == "after":
            return photos.__getitem__
        color_map = match_colors(colors, self.style_colors.flatten(1).T, weights)
        return lambda view: of_object.mapped(view, color_map)

    def render(self, view: int, geometry: Geometry | None = None) -> np.ndarray:
        """Premultiplied rgb of a view, [h*w, 3], with bounded memory; of `geometry` if given."""
        geometry = geometry or self.geometry
        count = self.cameras[view].width * self.cameras[view].height
        parts = [np.arange(at, min(at + PIXELS_AT_ONCE, count)) for at in range(0, count, PIXELS_AT_ONCE)]
        return np.concatenate([geometry.paint(view, part)[0] for part in parts])

    def render_over(self, view: int) -> np.ndarray:
        """A view over the background, [h, w, 3]."""
        alpha = self.geometry.alpha(view)
        rgb = self.render(view).reshape(*alpha.shape, 3)
        return rgb + (1 - alpha[..., None]) * self.background

    def match_renders(self) -> ColorMap | None:
        """The map from the renders' colors to the style image's (ARF's last step), from up to MATCHED_VIEWS views."""
        if self.style_colors is None:
            return None
        views = evenly_spaced(len(self.cameras), MATCHED_VIEWS)
        images = (
            (self.render(view).reshape(*self.geometry.alpha(view).shape, 3), self.geometry.alpha(view))
            for view in views
        )
        return rendered_match(images, self.style_colors, self.problem.seed, len(views))

    # -- learning ---------------------------------------------------------------------------------------------------

    def refit_step(self) -> dict[str, float]:
        """Take one step of the color towards the photos; its mean squared error."""
        generator = np.random.default_rng([self.problem.seed, 2, self.state.step])
        view = self.shown[int(generator.integers(len(self.shown)))]
        error = self.learn_image(view, self.photos[view], generator)
        if error is None:
            return {"mse": 0.0}
        self.adam.step(self.settings.refit_rate * 0.1**self.budget.progress)
        return {"mse": error}

    def learn_image(
        self, view: int, image: np.ndarray, generator: np.random.Generator, weight: float = 1.0
    ) -> float | None:
        """Add the gradient of `weight` times the mean squared error to an image [h, w, 3] of a view.

        Over `refit_pixels` random pixels of those that count. Returns the error; None if no pixel counts.
        """
        # A pixel without coverage has nothing to learn from: its color is the background's.
        lit = np.flatnonzero(self.coverage(view).ravel() > 1e-3)
        if len(lit) == 0:
            return None
        pixels = lit[drawn_evenly(self.settings.refit_pixels, len(lit), generator)]
        return self.learn_pixels(view, pixels, image.reshape(-1, 3)[pixels], weight)

    def learn_pixels(self, view: int, pixels: np.ndarray, target: np.ndarray, weight: float = 1.0) -> float:
        """Add the gradient of the mean squared error of pixels [n] to colors [n, 3] over the background."""
        rgb, record = self.geometry.paint(view, pixels)
        alpha = self.geometry.alpha(view).ravel()[pixels, None]
        difference = rgb + (1 - alpha) * self.background - target
        # d/dC of weight mean (C - target)^2 over pixels and channels.
        self.geometry.learn(record, difference * np.float32(2 * weight / difference.size), self.adam.gradients)
        return float(np.square(difference).mean())

    # -- checkpoints ------------------------------------------------------------------------------------------------

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays of a checkpoint."""
        self.collect()
        arrays = {COLOR: self.field.color.values.copy()}
        if isinstance(self.field.color, HashColor):
            arrays[FINEST] = np.array([self.field.color.finest])  # for whoever looks at the colors meanwhile
        arrays |= {k: v.copy() for k, v in moments_of({"adam": self.adam}).items()}
        if self.deformer is not None:
            arrays |= {f"deform.{k}": v for k, v in self.deformer.arrays().items()}
        if self._moving is not None:
            arrays |= {f"alpha.{view}": alpha for view, alpha in self._moving.alphas.items()}
        return arrays

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """From arrays(); the state is set."""
        self.field.color.values[:] = arrays[COLOR]
        # After the values: on a GPU new_adam() copies them to the device.
        self.adam = self.new_adam()
        restore_moments({"adam": self.adam}, arrays)
        if self.deformer is None:
            return
        if self.state.phase != REFIT:
            self.start_moving()
        self.deformer.restore({k[7:]: v for k, v in arrays.items() if k.startswith("deform.")})
        if self._moving is not None:
            self._moving.alphas = {int(k[6:]): v.copy() for k, v in arrays.items() if k.startswith("alpha.")}
