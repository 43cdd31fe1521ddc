"""Options of `stylerf select`."""

import re
from dataclasses import dataclass

from stages.configs import advanced, option
from stages.configs.view_syntax import depth_of, file_of, pixel_of

GROWING = "growing"


@dataclass(frozen=True)
class SelectConfig:
    """How a region is selected: seeds, how it grows, and other regions to combine it with."""

    at: tuple[str, ...] = option(
        (), metavar="VIEW:X,Y", help="seed: a pixel of a view, from the top left; VIEW is a name, or a number as '#12'"
    )
    scribble: tuple[str, ...] = option(
        (), metavar="VIEW=MASK.png", help="seeds: the bright pixels of a view's mask", digest="files_digest"
    )
    avoid: tuple[str, ...] = option((), metavar="VIEW:X,Y", help="a pixel outside the region")
    mask: tuple[str, ...] = option(
        (), metavar="VIEW=MASK.png", help="everything that most of these masks show; not grown", digest="files_digest"
    )
    box: tuple[float, ...] = option((), metavar="S", help="two corners x y z x y z, scene units; not grown")
    sphere: tuple[float, ...] = option((), metavar="S", help="center and radius x y z r, scene units; not grown")
    color: str = option("", metavar="#RRGGBB", help="everything of this color within --tolerance; not grown")
    depth: str = option(
        "", metavar="VIEW:NEAR,FAR", help="everything a view shows between two depths, scene units; not grown"
    )
    tolerance: float = option(
        18.0, help="largest color difference from the seeds, CIELAB with half the lightness (0: ignore color)"
    )
    reach: float = option(0.0, help="largest distance from the seeds, scene units (0: unlimited)")
    union: tuple[str, ...] = option((), metavar="REGION", help="regions to add")
    subtract: tuple[str, ...] = option((), metavar="REGION", help="regions to remove")
    intersect: tuple[str, ...] = option((), metavar="REGION", help="regions to intersect with")
    preview: tuple[str, ...] = option(
        (), metavar="VIEW", help="views to preview (default: those of the seeds and two more)"
    )
    steps: int = advanced(5, GROWING, help="rounds of growing")
    iterations: int = advanced(200000, GROWING, help="cells examined per round")
    neck: float = advanced(
        0.3, GROWING, help="stop where the object narrows to this fraction of its widest part so far (0: never)"
    )
    fill: int = advanced(2, GROWING, help="fill gaps of up to twice this many cells (0: none)")
    solid: float = advanced(0.02, GROWING, help="minimum opacity of a cell that growing passes through")
    most: float = advanced(0.5, GROWING, help="growing beyond this fraction of all solid cells is a leak")
    transition: int = advanced(2, GROWING, help="width of the transition around the region, cells")
    cells: int = advanced(
        0, GROWING, help="cells per side of the edit grid (0: about 1.5 photo pixels per cell, 64 to 256)"
    )
    files_digest: str = ""  # sha256 of the masks

    def __post_init__(self) -> None:
        for text in (*self.at, *self.avoid):
            pixel_of(text)
        for text in (*self.scribble, *self.mask):
            file_of(text)
        if self.depth:
            depth_of(self.depth)
        if self.color and not re.fullmatch(r"#[0-9a-fA-F]{6}", self.color):
            raise ValueError(f"color {self.color!r} is not written as #rrggbb")
        if self.color and not self.tolerance:
            raise ValueError("--color needs a --tolerance over 0")
        if len(self.box) not in (0, 6) or len(self.sphere) not in (0, 4):
            raise ValueError("a box takes six numbers (two corners), a sphere four (center and radius)")
        if self.sphere and self.sphere[3] <= 0:
            raise ValueError("the radius of a sphere must be over 0")
        seeds = self.at or self.scribble or self.mask or self.box or self.sphere or self.color or self.depth
        if not (seeds or self.union):
            raise ValueError("nothing is selected: give --at, --scribble, --mask, --box, --sphere, --color, --depth")
        if self.avoid and not ((self.at or self.scribble) and self.tolerance):
            raise ValueError(
                "--avoid limits growth from --at or --scribble by color; it needs them and a tolerance over 0"
            )
        if self.steps < 0 or self.iterations < 1 or self.tolerance < 0 or self.reach < 0 or self.transition < 0:
            raise ValueError("steps, tolerance, reach and transition must be at least 0, iterations at least 1")
        if self.fill < 0:
            raise ValueError("fill must be at least 0")
        if self.cells and not 16 <= self.cells <= 512:
            raise ValueError("cells must be 16 to 512, or 0")
        if not 0 <= self.neck <= 1:
            raise ValueError("neck must be in 0..1")
        if not 0 < self.solid < 1 or not 0 < self.most <= 1:
            raise ValueError("solid must be over 0 and under 1, most in (0, 1]")
