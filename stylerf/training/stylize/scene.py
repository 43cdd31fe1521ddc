"""The scene that a method stylizes: fixed density, a new color to be trained and, optionally, a deformation.

StyleProblem holds the inputs, StyledScene everything that changes. Methods render its views and add gradients to it.
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

COLOR, FINEST = "color", "finest"  # checkpoint arrays: the new color's values, cells of its finest level
Settings_co = TypeVar("Settings_co", bound=StyleSettings, covariant=True)


@dataclass(frozen=True, eq=False)
class ObjectPhotos:
    """Photos without their background.

    Attributes:
        photos: [h, w, 3] over the background.
        alpha: Returns a view's coverage [h, w], before any deformation.
        background: Gray level; None: coverage is that of a region, around which photos stay unchanged.
    """

    photos: PerView[np.ndarray]
    alpha: Callable[[int], np.ndarray]
    background: np.float32 | None

    def __call__(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Return premultiplied rgb [h, w, 3] without the background, and its coverage [h, w]."""
        coverage = self.alpha(view)
        behind = (1 - coverage[..., None]) * self._beside(view)
        return np.clip(self.photos[view] - behind, 0, coverage[..., None]), coverage

    def _beside(self, view: int) -> np.ndarray | np.float32:
        return self.photos[view] if self.background is None else self.background

    def colors(self, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return a sample of the colors [n, 3] of covered pixels, and their weights [n]."""
        views = range(len(self.photos))
        covered = sum(int((self.alpha(view) > 0).sum()) for view in views)
        return pixels_of((straight_rgba(*self(view)) for view in views), seed=seed, count=covered)

    def mapped(self, view: int, color_map: ColorMap) -> np.ndarray:
        """Return a photo with the object's colors mapped, [h, w, 3]; the background is unchanged."""
        rgb, coverage = self(view)
        mapped = color_map.premultiplied(torch.from_numpy(rgb), torch.from_numpy(coverage)).numpy()
        level = coverage[..., None]
        return (np.clip(mapped, 0, level) + (1 - level) * self._beside(view)).astype(np.float32)


def straight_rgba(rgb: np.ndarray, coverage: np.ndarray, threshold: float = 0.0) -> torch.Tensor:
    """Return [4, h, w] float32 from premultiplied rgb [h, w, 3]; alpha is 0 where coverage is at most `threshold`."""
    alpha = coverage[..., None]
    # 1e-3 bounds the quotient where almost nothing is visible; such pixels have hardly any weight later.
    rgba = np.concatenate([rgb / np.maximum(alpha, 1e-3), np.where(alpha > threshold, alpha, 0)], -1)
    return torch.from_numpy(rgba.astype(np.float32)).permute(2, 0, 1)


def rendered_match(
    pictures: Iterable[tuple[np.ndarray, np.ndarray]],  # premultiplied rgb [h, w, 3], alpha [h, w]
    style_image: torch.Tensor,
    seed: int,
    count: int = 1,
) -> ColorMap:
    """Return the map from the renders' colors to the style image's (ARF's last step). count: number of pictures.

    Pixels that are at most half covered do not count, unless there are no others, as in haze or with rods thinner than
    a pixel. Only a sample of each picture is kept.
    """
    generator = torch.Generator().manual_seed(seed)
    solid: list[tuple[Tensor, Tensor]] = []
    hazy: list[tuple[Tensor, Tensor]] = []
    for rgb, alpha in pictures:
        opaque = bool((alpha > SOLID).any())
        # Dividing by a small alpha amplifies noise into colors.
        rgba = straight_rgba(rgb, alpha, SOLID if opaque else 0)
        (solid if opaque else hazy).append(sample_of(rgba, round(SAMPLE / count), generator))
    colors, weights = (torch.cat(parts) for parts in zip(*(solid or hazy), strict=True))
    return match_colors(colors.clamp(0, 1), style_image.flatten(1).T, weights)


PIXELS_AT_ONCE = 65536
MATCHED_VIEWS = 24  # views that represent the colors of all
MEMORY = 8e9  # bytes
# Fractions of the memory. Recomputing a surface takes seconds, features about as long, a photo a tenth of that.
SURFACES, CONTENT, PHOTOS = 0.5, 0.35, 0.15
REGION_MASKS = 0.05  # in addition to these
REFIT_DETAIL_RATE = 0.2  # of the finest colors in the refit, see HashColor: few pixels train each of them (0065)
COARSEST_STEP = 1 / 128  # cube units; for a deforming field, whose rays are marched in every step


@dataclass(frozen=True)
class StyleBackend:
    """Constructors of everything that differs between CPU and GPU (selected in training/backends.py)."""

    deformer: Callable[..., AnyDeformer]
    fixed_geometry: Callable[..., Surfaces]
    moving_geometry: Callable[..., AnyRayGeometry]


CPU = StyleBackend(Deformer, FixedGeometry, MovingGeometry)


@dataclass(frozen=True, eq=False)
class StyleProblem(Generic[Settings_co]):
    """The inputs of a stylization.

    Attributes:
        field: The fitted field, whose density is fixed.
        cameras, photos: Training views: [h, w, 3] float32 sRGB 0..1 over the background; reread where not cached.
        background: Gray level behind the field.
        style_image: [3 or 4, h, w] sRGB 0..1; None if the method has none. A fourth channel is an alpha of 0 or 1.
        deformation: Network that also deforms the shapes (DeSRF); None: they are fixed.
        region: Cells [s, s, s] of the cube; only this part of the scene is shown, matched and stylized, and new_color
            creates colors over the scene's own.
        memory: Bytes for surfaces, features and photos; what does not fit is recomputed on every use. On a GPU, its
            free memory is a further limit.
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
    """Progress of the current phase."""

    def __init__(self, scene: "StyledScene[StyleSettings]") -> None:
        self.scene = scene

    @property
    def steps(self) -> int:
        """Steps of the current phase; 0 if it is limited by time."""
        settings = self.scene.settings
        return settings.refit_steps if self.scene.state.phase == REFIT else settings.steps

    @property
    def progress(self) -> float:
        """Completed fraction of the current phase, 0..1."""
        s, state = self.scene.settings, self.scene.state
        if state.phase == REFIT:
            return min(1.0, state.step / max(1, s.refit_steps))
        return min(1.0, state.step / s.steps if s.steps else state.seconds / s.seconds)


class StyledScene(Generic[Settings_co]):
    """Renders views in the new color and accumulates its gradients.

    Args:
        new_color: Creates the color to train from a generator and this scene, whose surfaces are known by then.

    Attributes:
        field: The field with its new color.
        fixed: Its surfaces before any deformation.
        geometry: What is rendered: `fixed`, or the deforming field after start_moving().
        shown: Views that show something to stylize.
        photos: The views' photos, matched to the style image's colors if settings.match says so.
        style_image: Image whose features are matched; None without a style image.
        style_colors: Image whose colors are matched, without transparent pixels; None without a style image.
        behind: Color [3] behind a deforming object when compared with the style image: the style image's mean color.

    Raises:
        InvalidValue: No view shows any part of the region.
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
        # A region's colors are on top of the field's own, which keep their color map.
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
            raise InvalidValue("no training view shows any part of the region")
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
            raise InvalidValue("only desrf trains a deformation")
        at_rest(self.field)  # at the step that its densities were fitted with
        # Marching cost depends on the samples, and the step cannot change later: colors are trained where sampled.
        self.field.step = max(self.field.step, COARSEST_STEP)
        vertices, clip, anchored = settings.displacement_vertices, settings.gradient_clip, True
        return p.backend.deformer(self.field, p.deformation, p.cameras, vertices, p.seed, p.threads, clip, anchored)

    def _fixed_geometry(self) -> Surfaces:
        # A snapshot of the shapes; the color continues to be trained.
        moved, p = self.field.displacement, self.problem
        still = replace(self.field, displacement=None if moved is None else moved.copy())
        threshold = self.settings.weight_threshold
        return p.backend.fixed_geometry(still, p.cameras, threshold, p.threads, SURFACES * p.memory)

    def new_adam(self) -> Optimizer:
        """Return an optimizer for the current colors with zero moments."""
        color, side = self.field.color, 1.0  # of its grid, in cube units
        if isinstance(color, RegionColor):
            side, color = color.side, color.own
        if isinstance(color, HashColor):
            color.detail_rate, color.detail, color.broad, narrow = self._rates_by_width()
            # nan if nothing is visible: all levels learn.
            color.narrow = narrow * color.finest / (side * self.pixel_cells()) if narrow else 0.0
        return self.fixed.new_adam(self.settings.gradient_clip)

    def _rates_by_width(self) -> tuple[float, float, float, float]:
        """Return HashColor's detail_rate, detail and broad for the current phase, and ArfSettings.narrow."""
        if self.state.phase == REFIT:
            return REFIT_DETAIL_RATE, DETAIL, math.inf, 0.0
        if isinstance(s := self.settings, ArfSettings):
            return s.detail_rate, s.detail, s.broad, s.narrow
        return 1.0, DETAIL, math.inf, 0.0

    def collect(self) -> None:
        """Copy values learned on a GPU into the field's own arrays."""
        self.fixed.collect()
        if self.deformer is not None:
            self.deformer.collect()

    def start_moving(self) -> None:
        """Render the deforming field from now on; without a deformation, nothing changes."""
        if self.deformer is not None:
            p, threshold = self.problem, self.settings.weight_threshold
            self._moving = self.geometry = p.backend.moving_geometry(
                self.field, p.cameras, threshold, p.threads, self.behind, self.deformer, self.fixed
            )

    # -- views ------------------------------------------------------------------------------------------------------

    def pixel_cells(self) -> float:
        """Return the number of pixel-sized cells per cube side: median of four views, nan if nothing is visible."""
        chosen = np.unique(np.linspace(0, len(self.cameras) - 1, 4).round().astype(int))
        return pixel_cells(self.fixed.surface(view) for view in chosen)

    @property
    def of_region(self) -> bool:
        """Whether only a region is stylized."""
        return self.problem.region is not None

    @property
    def fills_views(self) -> bool:
        """Whether every pixel of every view counts: a whole capture with an opaque background."""
        return self.field.opaque_background and not self.of_region

    def coverage(self, view: int) -> np.ndarray:
        """Return each pixel's coverage by the object or the region, [h, w] in 0..1."""
        return self._region_masks[view] if self.of_region else self.geometry.alpha(view)

    def _region_mask(self, view: int) -> np.ndarray:
        points = self.fixed.surface(view).samples(np.arange(self.fixed.alpha(view).size))
        part, region = np.zeros(len(points.ends), np.float32), np.ascontiguousarray(self.problem.region)
        weights_inside(region.reshape(-1), len(region), points, self.problem.threads, part)
        return np.clip(part, 0, 1).reshape(self.fixed.alpha(view).shape)

    def _matched(self, photos: PerView[np.ndarray]) -> Callable[[int], np.ndarray]:
        """Return a function that reads a photo, color-matched if settings.match says so; sets style_colors."""
        s, p = self.settings, self.problem
        if s.match == "none":
            return photos.__getitem__
        if self.style_colors is None:
            raise InvalidValue("color matching needs a style image")

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
        # Both matches aim at these colors: two successive bounds would allow their product.
        self.style_colors = spread_at_most(self.style_colors, colors, s.max_gain, weights)
        if s.match == "after":
            return photos.__getitem__
        color_map = match_colors(colors, self.style_colors.flatten(1).T, weights)
        return lambda view: of_object.mapped(view, color_map)

    def render(self, view: int, geometry: Geometry | None = None) -> np.ndarray:
        """Return premultiplied rgb of a view, [h*w, 3], using bounded memory; of `geometry` if given."""
        geometry = geometry or self.geometry
        count = self.cameras[view].width * self.cameras[view].height
        parts = [np.arange(at, min(at + PIXELS_AT_ONCE, count)) for at in range(0, count, PIXELS_AT_ONCE)]
        return np.concatenate([geometry.paint(view, part)[0] for part in parts])

    def render_over(self, view: int) -> np.ndarray:
        """Return a view over the background, [h, w, 3]."""
        alpha = self.geometry.alpha(view)
        rgb = self.render(view).reshape(*alpha.shape, 3)
        return rgb + (1 - alpha[..., None]) * self.background

    def match_renders(self) -> ColorMap | None:
        """Return the map from the renders' colors to the style image's (ARF's last step), from up to MATCHED_VIEWS."""
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
        """Take one step of the color on a photo; return the mean squared error."""
        generator = np.random.default_rng([self.problem.seed, 2, self.state.step])
        view = self.shown[int(generator.integers(len(self.shown)))]
        error = self.learn_image(view, self.photos[view], generator, self.settings.refit_pixels)
        if error is None:
            return {"mse": 0.0}
        self.adam.step(self.settings.refit_rate * 0.1**self.budget.progress)
        return {"mse": error}

    def learn_image(
        self, view: int, image: np.ndarray, generator: np.random.Generator, count: int, weight: float = 1.0
    ) -> float | None:
        """Add the gradient of `weight` times the mean squared error between a view and an image [h, w, 3].

        Over at most `count` random covered pixels. Returns the error, or None if no pixel is covered.
        """
        # Pixels without coverage show only the background, so they are of no use.
        lit = np.flatnonzero(self.coverage(view).ravel() > 1e-3)
        if len(lit) == 0:
            return None
        pixels = lit[drawn_evenly(min(count, len(lit)), len(lit), generator)]
        return self.learn_pixels(view, pixels, image.reshape(-1, 3)[pixels], weight)

    def learn_pixels(self, view: int, pixels: np.ndarray, target: np.ndarray, weight: float = 1.0) -> float:
        """Add the gradient of pixels' [n] mean squared error to colors [n, 3] over the background; return the error."""
        rgb, record = self.geometry.paint(view, pixels)
        alpha = self.geometry.alpha(view).ravel()[pixels, None]
        difference = rgb + (1 - alpha) * self.background - target
        # d/dC of weight mean((C - target)^2) over pixels and channels.
        self.geometry.learn(record, difference * np.float32(2 * weight / difference.size), self.adam.gradients)
        return float(np.square(difference).mean())

    # -- checkpoints ------------------------------------------------------------------------------------------------

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays for a checkpoint."""
        self.collect()
        arrays = {COLOR: self.field.color.values.copy()}
        if isinstance(self.field.color, HashColor):
            arrays[FINEST] = np.array([self.field.color.finest])  # for viewers of an unfinished run
        arrays |= {k: v.copy() for k, v in moments_of({"adam": self.adam}).items()}
        if self.deformer is not None:
            arrays |= {f"deform.{k}": v for k, v in self.deformer.arrays().items()}
        if self._moving is not None:
            arrays |= {f"alpha.{view}": alpha for view, alpha in self._moving.alphas.items()}
        return arrays

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore from arrays(); `state` must already be set."""
        self.field.color.values[:] = arrays[COLOR]
        # After the values: on a GPU, new_adam() copies them to the device.
        self.adam = self.new_adam()
        restore_moments({"adam": self.adam}, arrays)
        if self.deformer is None:
            return
        if self.state.phase != REFIT:
            self.start_moving()
        self.deformer.restore({k[7:]: v for k, v in arrays.items() if k.startswith("deform.")})
        if self._moving is not None:
            self._moving.alphas = {int(k[6:]): v.copy() for k, v in arrays.items() if k.startswith("alpha.")}
