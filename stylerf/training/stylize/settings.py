"""How a scene is stylized, whatever the method; and where a stylization stands."""

from dataclasses import dataclass, field, replace

from stylerf.style.style_objective import StyleWeights


@dataclass(frozen=True)
class StyleSettings:
    """How a scene is stylized. seconds: budget of the style steps; steps: their number if > 0.

    strategy, dilation, blur: see rendering/strategies. remember: unselected pixels are taken from the view's last
    render instead of being rendered anew. match: before, after, both or none. coarse: share of the style steps, the
    first, that see features at half of `feature_scale` (docs/decisions/0013). rates: per step, falling to `final_rate`
    of themselves. deform_rate, displacement_weight, displacement_vertices: see training/deformer. loss: nnfm or gram
    (style/objective). rounds, image_share, image_steps, image_rate: see training/alternating. reference_steps,
    reference_weight, template_weights, late: see training/referenced. rollbacks: see training/guard; clip:
    training/optimizer; least_spread, most_gain: style/color.spread_at_least, strokes_in, spread_at_most.
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
    loss: str = "nnfm"
    template_weights: StyleWeights = field(default_factory=lambda: StyleWeights(1.0, 0.1, 1.0, 5.0))
    rounds: int = 3
    image_share: float = 0.75
    image_steps: int = 5
    image_rate: float = 0.03
    reference_steps: int = 60
    reference_weight: float = 1.0
    late: float = 0.25
    rollbacks: int = 0
    clip: float = 0.0
    least_spread: float = 0.0
    most_gain: float = 4.0

    def slowed(self, times: int) -> "StyleSettings":
        """All rates halved so many times."""
        factor = 0.5**times
        return replace(self, rate=factor * self.rate, refit_rate=factor * self.refit_rate,
                       deform_rate=factor * self.deform_rate, image_rate=factor * self.image_rate)  # fmt: skip


@dataclass
class StyleState:
    """Where the stylization stands. counts: what a method counts beside its steps."""

    phase: str = "refit"
    step: int = 0
    seconds: float = 0.0
    curve: list[dict] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
