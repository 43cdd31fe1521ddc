"""Faults that scenes and style images can have, the methods tried under them, and the options of a scene with one."""

from dataclasses import dataclass, field

SCENE, MADE, STYLE, PALETTE = "scene", "made", "style", "palette"
FITS, STYLIZATIONS, EDITS = "fits", "stylizations", "edits"


@dataclass(frozen=True)
class Fault:
    """A fault.

    of: `scene`, changes photos and cameras of a scene; `made`, a procedural scene; `style`, a style image; `palette`,
    the start of a palette or a change to it. amount: in the unit of `words`, where it replaces {}.
    """

    name: str
    of: str
    amount: float
    words: str

    @property
    def description(self) -> str:
        """The fault with its amount."""
        return self.words.format(f"{self.amount:g}")

    @property
    def of_scene(self) -> bool:
        """Whether the fault makes a scene of its own; other faults use the scene without a fault."""
        return self.of in (SCENE, MADE)


ALL_FAULTS = (
    Fault("seeds", SCENE, 0, "no fault, only another seed"),
    Fault("views-3", SCENE, 3, "{} training views, spread out"),
    Fault("views-8", SCENE, 8, "{} training views, spread out"),
    Fault("pose-noise", SCENE, 0.5, "cameras rotated by {} degrees and moved by as many hundredths of their distance"),
    Fault("exposure", SCENE, 0.75, "exposure drifting from -{0} to {0} stops over the photos"),
    Fault("blur", SCENE, 0.01, "photos blurred by a Gaussian of {} of their longer side"),
    Fault("jpeg", SCENE, 10, "photos as JPEG of quality {}"),
    Fault("hidden", SCENE, 0.5, "training views of one side only, {} of them"),
    Fault(
        "near-plane",
        SCENE,
        0.5,
        "a near plane at {} of the cameras' distance; for an object, that much of its box cut off",
    ),
    Fault("textureless", MADE, 0, "a still life in plaster"),
    Fault("repeating", MADE, 0, "a still life in one repeating check"),
    Fault("thin", MADE, 0, "rods and rings about a pixel wide"),
    Fault("style-white", STYLE, 256, "a white style image"),
    Fault("style-tiny", STYLE, 16, "a style image of {0} x {0} pixels"),
    Fault("style-huge", STYLE, 4096, "a style image of {0} x {0} pixels"),
    Fault("style-wash", STYLE, 512, "a style image without edges"),
    Fault("style-extreme", STYLE, 512, "a style image of pure red and blue"),
    Fault("palette-random", PALETTE, 0, "a palette that starts from random colors"),
    Fault("palette-full", PALETTE, 0, "every palette color made pure green"),
    Fault("palette-black", PALETTE, 0, "every palette color made black"),
)
FAULTS = {fault.name: fault for fault in ALL_FAULTS}
CLEAN = "seeds"  # the scene for faults of style images and palettes
ORDINARY_STYLE = 256  # side of the style image for faults of scenes, pixels; views of 160 need 240


@dataclass(frozen=True)
class Method:
    """A method under test.

    field: kind of the field that is fitted first. style: its name in `stylerf stylize --method`. edit: of a region,
    `recolor` or `paint` (LAENeRF), or `palette` (PaletteNeRF). Without style and edit: a fit alone.
    """

    name: str
    field: str = "vm"
    style: str = ""
    edit: str = ""

    @property
    def family(self) -> str:
        """The criterion that applies."""
        return EDITS if self.edit else STYLIZATIONS if self.style else FITS

    @property
    def takes_style(self) -> bool:
        """Whether it takes a style image."""
        return bool(self.style) or self.edit == "paint"

    def faces(self, fault: Fault) -> bool:
        """Whether a fault can affect the method. PaletteNeRF starts from a hull, never from random colors."""
        if fault.of == PALETTE:
            return self.edit == "recolor" or (self.edit == "palette" and fault.name != "palette-random")
        return self.takes_style or fault.of != STYLE


ALL_METHODS = (
    Method("fit"),
    Method("fit-hash", field="hash"),
    Method("fit-voxel", field="voxel"),
    *(Method(name, style=name) for name in ("arf", "desrf", "snerf", "refnpr")),
    Method("laenerf-recolor", edit="recolor"),
    Method("laenerf-paint", edit="paint"),
    Method("palettenerf", edit="palette"),
)
METHODS = {method.name: method for method in ALL_METHODS}


@dataclass(frozen=True)
class CorruptSceneConfig:
    """One fault of one scene.

    fault: its name, see docs/how-to/stress.md. amount: how much of it. side: longer side of the photos, pixels; larger
    ones are downscaled. views: training views of a procedural scene. tests: test views, which have no fault. source:
    folder of the scene to corrupt, empty for a procedural one. source_digest: its digest.
    """

    fault: str = "seeds"
    amount: float = 0.0
    side: int = 160
    views: int = 24
    tests: int = 4
    source: str = field(default="", metadata={"digest": "source_digest"})
    source_digest: str = ""
