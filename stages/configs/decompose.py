"""Options of `stylerf stylize --method palettenerf`: learning a palette, and changing it."""

from dataclasses import dataclass

from stages.configs import advanced, option, part_of
from stages.configs.edit import PaletteConfig
from stages.configs.fit import budget_of
from stages.configs.view_syntax import pixel_of

METHOD = "palettenerf"


LOSS, GRID, STEPS = "loss", "color field", "training"


@dataclass(frozen=True)
class DecomposeConfig:
    """How a scene's colors are decomposed into a palette (PaletteNeRF)."""

    method: str = option(METHOD, choices=(METHOD,), help="palettenerf: an editable palette of the whole scene")
    bases: int = option(4, help="palette colors, 4 to 16 (0: the fewest with an error of at most 5/255)")
    budget: str = option("2m", help="time (60s, 2m) or number of the palette's steps")
    rate: float = option(1e-2, help="learning rate, decaying to a tenth (three times as high for the hash table)")
    sparsity_weight: float = option(2e-3, help="weight against mixing several palette colors (PaletteNeRF: 2e-4)")
    refit_steps: int = advanced(300, STEPS, help="steps that fit the direct color to the photos before the palette")
    pixels: int = advanced(2048, STEPS, help="pixels per step")
    offset_weight: float = advanced(0.03, LOSS, help="weight of the squared offsets from palette colors")
    view_weight: float = advanced(0.1, LOSS, help="weight of the squared view-dependent color")
    smooth_weight: float = advanced(
        4e-3, LOSS, help="weight of differences between the mixes of nearby points of similar color"
    )
    guide_weight: float = advanced(0.05, LOSS, help="initial weight of the mixes that the palette's convex hull gives")
    drift_weight: float = advanced(1e-3, LOSS, help="weight of the palette's distance from the extracted one")
    levels: int = advanced(8, GRID, help="levels of the hash grid")
    finest: int = advanced(0, GRID, help="cells per side of its finest level (0: a little finer than a pixel)")
    table_bits: int = advanced(17, GRID, help="log2 of its table entries per level")
    checkpoint_every_seconds: float = advanced(20.0, STEPS, help="time between checkpoints", incidental=True)

    def __post_init__(self) -> None:
        budget_of(self.budget)
        if self.bases and not 4 <= self.bases <= 16:
            raise ValueError("bases must be 4 to 16, or 0: fewer corners enclose no volume of colors")
        if self.refit_steps < 0 or self.pixels < 1 or self.rate <= 0:
            raise ValueError("refit_steps must be at least 0, pixels at least 1, rate > 0")
        for name in ("sparsity", "offset", "view", "smooth", "guide", "drift"):
            if getattr(self, f"{name}_weight") < 0:
                raise ValueError(f"{name}_weight must be at least 0")
        finest = self.finest == 0 or 16 <= self.finest <= 4096
        if not (1 <= self.levels <= 16 and finest and 10 <= self.table_bits <= 24):
            raise ValueError("the color field takes 1 to 16 levels, 16 to 4096 cells (or 0), 10 to 24 table bits")


@dataclass(frozen=True)
class RecolorConfig(PaletteConfig):
    """Changes of a decomposed field's palette, everywhere or around points; they need no training."""

    offset_scale: float = option(1.0, help="scale the offsets from palette colors (0: flat colors)")
    view_scale: float = option(1.0, help="scale the view-dependent color (0: no gloss)")
    at: tuple[str, ...] = option((), metavar="VIEW:X,Y", help="change only around the surface at this pixel")
    reach: float = option(
        0.0, help="distance at which the change has fallen to 1/e, scene units (0: a tenth of the camera's distance)"
    )
    filter: str = option(
        "",
        choices=("", "none", "space"),
        metavar="none|space",
        help="where the change applies: everywhere, or around --at (default: around --at if given)",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for text in self.at:
            pixel_of(text)
        if self.filter == "space" and not self.at:
            raise ValueError("--filter space needs a point; give --at VIEW:X,Y")
        if not 0 <= self.reach < float("inf") or (self.reach and not self.at):
            raise ValueError("reach must be at least 0, and needs --at VIEW:X,Y")
        for name in ("offset_scale", "view_scale"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"{name} must be at least 0")
        if (self.at or self.filter) and not self:
            raise ValueError("--at and --filter say where to change the palette; say how with --palette")

    def __bool__(self) -> bool:
        return super().__bool__() or self.offset_scale != 1 or self.view_scale != 1

    @property
    def local(self) -> bool:
        """Whether the change applies around points only."""
        return bool(self.at) and self.filter != "none"


@dataclass(frozen=True)
class PaletteFieldConfig(RecolorConfig, DecomposeConfig):
    """Both in one command; two stages, so that a changed palette needs no training."""

    def __post_init__(self) -> None:
        DecomposeConfig.__post_init__(self)
        RecolorConfig.__post_init__(self)

    @property
    def learning(self) -> DecomposeConfig:
        """How the palette is learned."""
        return part_of(self, DecomposeConfig)

    @property
    def changes(self) -> RecolorConfig:
        """How it is changed."""
        return part_of(self, RecolorConfig)
