"""Options of `stylerf select`."""

import re
from dataclasses import dataclass

from stages.configs import option
from stages.configs.views import depth_of, file_of, pixel_of


@dataclass(frozen=True)
class SelectConfig:
    """How a part of the scene is selected: seeds, what it grows through, and other regions it is joined with."""

    at: tuple[str, ...] = option(
        (),
        metavar="VIEW:X,Y",
        help="seed: a pixel of a view, counted from the upper left of its picture; VIEW is its name, or its number as "
        "'#12' (`stylerf show WORK/scene/main` lists views and pictures)",
    )
    scribble: tuple[str, ...] = option(
        (), metavar="VIEW=MASK.png", help="seeds: the bright pixels of a mask of a view", digest="files_digest"
    )
    avoid: tuple[str, ...] = option((), metavar="VIEW:X,Y", help="a pixel of what does not belong to it")
    mask: tuple[str, ...] = option(
        (),
        metavar="VIEW=MASK.png",
        help="what most of these masks show, of whatever tool made them; not grown",
        digest="files_digest",
    )
    box: tuple[float, ...] = option((), metavar="S", help="two corners x y z x y z, scene units; not grown")
    sphere: tuple[float, ...] = option((), metavar="S", help="center and radius x y z r, scene units; not grown")
    color: str = option("", metavar="#RRGGBB", help="all that has this color within --tolerance; not grown")
    depth: str = option("", metavar="VIEW:NEAR,FAR", help="what a view sees between two depths, scene units; not grown")
    steps: int = option(5, help="rounds of growing")
    iterations: int = option(200000, help="cells looked at in a round")
    neck: float = option(
        0.3, help="grow no further than where the object narrows to this share of its widest so far (0: go on)"
    )
    tolerance: float = option(
        18.0, help="greatest difference of color from the seeds, CIELAB, light counted half (0: grow through anything)"
    )
    fill: int = option(2, help="gaps in what has grown are filled up to twice so many cells (0: never)")
    reach: float = option(0.0, help="greatest distance from the seeds, scene units (0: any)")
    transition: int = option(2, help="width of the growing grid around the region, in cells")
    cells: int = option(0, help="cells a side of the cube (0: about a pixel and a half of the photos, 64 to 256)")
    solid: float = option(0.02, help="opacity across one cell from which growing goes through it")
    most: float = option(0.5, help="share of all that is solid at which growing is taken for having run away")
    union: tuple[str, ...] = option((), metavar="REGION", help="regions that are joined to it")
    subtract: tuple[str, ...] = option((), metavar="REGION", help="regions that are taken from it")
    intersect: tuple[str, ...] = option((), metavar="REGION", help="regions that it must lie in too")
    preview: tuple[str, ...] = option((), metavar="VIEW", help="views to draw it over (default: named ones, two more)")
    files_digest: str = ""

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
            raise ValueError("a color is selected by --tolerance; it must be over 0")
        if len(self.box) not in (0, 6) or len(self.sphere) not in (0, 4):
            raise ValueError("a box takes six numbers (two corners), a sphere four (center and radius)")
        if self.sphere and self.sphere[3] <= 0:
            raise ValueError("the radius of a sphere must be over 0")
        seeds = self.at or self.scribble or self.mask or self.box or self.sphere or self.color or self.depth
        if not (seeds or self.union):
            raise ValueError("nothing is selected; give --at, --scribble, --mask, --box, --sphere, --color, --depth")
        if self.avoid and not ((self.at or self.scribble) and self.tolerance):
            raise ValueError(
                "--avoid bounds what grows from --at or --scribble by its color; tolerance must be over 0"
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
