"""Settings of each stylization method, and the state of a run."""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Self

from stylerf.fields.hash_grid import DETAIL
from stylerf.style.style_loss import StyleWeights

REFIT, STYLE = "refit", "style"  # phases that every method has
RATES = ("rate", "refit_rate", "deform_rate", "image_rate")


@dataclass(frozen=True)
class StyleSettings:
    """Settings shared by all methods.

    Attributes:
        steps: Steps after the refit; 0 if limited by `seconds`.
        seconds: Time budget after the refit.
        refit_steps: Steps that fit the new color to the photos.
        refit_pixels: Pixels per step that are compared with a photo.
        refit_rate, rate: Learning rates of the color; `rate` decays by the factor `final_rate`.
        match: Color matching: before (of the photos), after (of the renders), both or none.
        weight_threshold: Fraction of a ray's largest weight below which a sample is not colored.
        rollbacks: Maximum number of rollbacks after divergence (see DivergenceGuard in trainer.py).
        gradient_clip: Clip gradients at this multiple of their running norm; 0: never (see common/adam.py).
        min_spread, max_gain: Bounds of color matching (see style/color_matching.py).
    """

    steps: int = 0
    seconds: float = 120.0
    refit_steps: int = 400
    refit_pixels: int = 8192
    refit_rate: float = 3e-2
    rate: float = 1e-2
    final_rate: float = 0.2
    match: str = "both"
    weight_threshold: float = 0.3
    rollbacks: int = 0
    gradient_clip: float = 0.0
    min_spread: float = 0.0
    max_gain: float = 4.0

    def slowed(self, times: int) -> Self:
        """Return the settings with all learning rates halved `times` times."""
        names = [one.name for one in fields(self) if one.name in RATES]
        return replace(self, **{name: 0.5**times * getattr(self, name) for name in names})

    def for_style(self, strength: float) -> Self:
        """Return the settings for a style image with only `strength` (0..1) of a style."""
        return self


@dataclass(frozen=True)
class ImageStyleSettings(StyleSettings):
    """Settings shared by methods with a style image.

    Attributes:
        loss: transport (see style/transport.py), nnfm (nearest neighbor feature matching) or gram (Gram matrices).
        feature_scale: Size of the image that features are extracted from, relative to the view.
        coarse: Initial fraction of the style steps that use half of `feature_scale` (decision 0013).
        fine_layers: Layers that the other steps use; empty for all.
        style_scale, style_rows, style_basis, variation, diversity, rotations: See style/style_loss.StyleObjective.
        stroke, stroke_by_depth: See stroke_sizes.py.
        keep_colors: Match the style image's colors to the photos' instead of vice versa.
    """

    weights: StyleWeights = field(default_factory=StyleWeights)
    loss: str = "nnfm"
    feature_scale: float = 0.5
    coarse: float = 0.0
    fine_layers: str = ""
    style_scale: float = 1.0
    style_rows: int = 4096
    style_basis: int = 96
    variation: str = "squared"
    diversity: float = 0.5
    stroke: float = 1.0
    stroke_by_depth: bool = False
    rotations: bool = False
    keep_colors: bool = False

    def features_at(self, progress: float) -> tuple[float, str]:
        """Return the scale of the images that features are extracted from, and the layers (empty for all).

        Args:
            progress: Of the style steps, 0..1.
        """
        if progress < self.coarse:
            return self.feature_scale / 2, ""
        return self.feature_scale, self.fine_layers

    def for_style(self, strength: float) -> Self:
        weights = replace(self.weights, style=strength * self.weights.style, grain=strength * self.weights.grain)
        return replace(self, weights=weights)


@dataclass(frozen=True)
class ArfSettings(ImageStyleSettings):
    """ARF.

    Attributes:
        strategy, dilation, blur: See rendering/ray_selection.py.
        remember: Take unselected pixels from the view's last render.
        detail_rate, detail, broad: For the style steps; see HashColor.
        narrow: Width in pixels below which cells do not learn in the style steps.
    """

    strategy: str = "deferred"
    dilation: int = 2
    blur: int = 0
    remember: bool = True
    detail_rate: float = 1.0
    detail: float = DETAIL
    broad: float = math.inf
    narrow: float = 0.0


@dataclass(frozen=True)
class DesrfSettings(ArfSettings):
    """DeSRF: ARF with a deformation (see training/deform/deformer.py)."""

    deform_rate: float = 1e-3
    displacement_weight: float = 0.5
    displacement_vertices: int = 32
    max_slope: float = 0.0

    def for_style(self, strength: float) -> Self:
        # Adam's steps are just as long for a weak loss: rounding errors would move shapes.
        return replace(super().for_style(strength), deform_rate=strength * self.deform_rate)


@dataclass(frozen=True)
class SnerfSettings(ImageStyleSettings):
    """SNeRF. rounds: number of alternations. image_share: fraction of a round spent on images. image_steps, image_rate:
    for the optimization of each image."""

    rounds: int = 3
    image_share: float = 0.75
    image_steps: int = 5
    image_rate: float = 0.03


@dataclass(frozen=True)
class RefNprSettings(ArfSettings):
    """Ref-NPR.

    Attributes:
        reference_steps, image_rate: For the optimization of a reference image.
        reference_scale: Size of the images whose features are matched with references', relative to the view;
            `feature_scale` is for making a reference.
        reference_weight: Weight of the squared error on the references' own rays and on registered rays.
        reference_pixels: Maximum number of each of these per step.
        reference_feature_weights: Weights of the correspondence loss; `weights` are for making a reference.
        late: Final fraction of the style steps, which match renders with renders.
    """

    reference_steps: int = 60
    image_rate: float = 0.03
    reference_scale: float = 0.5
    reference_weight: float = 1.0
    reference_pixels: int = 50_000
    reference_feature_weights: StyleWeights = field(default_factory=lambda: StyleWeights(1.0, 0.1, 1.0, 5.0))
    late: float = 0.25


@dataclass
class StyleState:
    """Progress of a stylization. step, seconds: in the current phase. counts: method-specific counters."""

    phase: str = REFIT
    step: int = 0
    seconds: float = 0.0
    curve: list[dict] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
