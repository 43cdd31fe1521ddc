"""The faults that `stylerf stress` makes, and the methods that it makes them for; data alone, nothing is imported."""

from dataclasses import dataclass

SCENE, MADE, STYLE, PALETTE = "scene", "made", "style", "palette"
FITS, STYLIZATIONS, EDITS = "fits", "stylizations", "edits"


@dataclass(frozen=True)
class Fault:
    """of: `scene`, a scene's own photos and cameras changed; `made`, a procedural scene; `style`, a painting;
    `palette`, how one begins or what is asked of it.

    amount: how much of it, in the unit that `words` tells.
    """

    name: str
    of: str
    amount: float
    words: str

    @property
    def told(self) -> str:
        """In words, with its amount."""
        return self.words.format(f"{self.amount:g}")

    @property
    def of_scene(self) -> bool:
        """Whether it makes a scene of its own; the others are put on the scene without a fault."""
        return self.of in (SCENE, MADE)


ALL_FAULTS = (
    Fault("seeds", SCENE, 0, "nothing but the seed"),
    Fault("views-3", SCENE, 3, "{} training views, spread out"),
    Fault("views-8", SCENE, 8, "{} training views, spread out"),
    Fault("pose-noise", SCENE, 0.5, "cameras turned by {} degrees and moved by as many hundredths of their distance"),
    Fault("exposure", SCENE, 0.75, "exposure that drifts from -{0} to {0} stops over the photos"),
    Fault("blur", SCENE, 0.01, "photos out of focus by a Gaussian of {} of their longer side"),
    Fault("jpeg", SCENE, 10, "photos stored as JPEG of quality {}"),
    Fault("hidden", SCENE, 0.5, "training views of one side alone, {} of them"),
    Fault(
        "near-plane", SCENE, 0.5, "a near plane at {} of the cameras' distance; of an object, so much of its box cut"
    ),
    Fault("textureless", MADE, 0, "a still life in plaster"),
    Fault("repeating", MADE, 0, "a still life under one repeating check"),
    Fault("thin", MADE, 0, "rods and rings about a pixel thin"),
    Fault("style-white", STYLE, 256, "a white painting"),
    Fault("style-tiny", STYLE, 16, "a painting of {0} x {0} pixels"),
    Fault("style-huge", STYLE, 4096, "a painting of {0} x {0} pixels"),
    Fault("style-wash", STYLE, 512, "a painting without an edge"),
    Fault("style-extreme", STYLE, 512, "a painting of full red and full blue"),
    Fault("palette-random", PALETTE, 0, "a palette that begins with colors drawn at random"),
    Fault("palette-full", PALETTE, 0, "every palette color made full green"),
    Fault("palette-black", PALETTE, 0, "every palette color made black"),
)
FAULTS = {fault.name: fault for fault in ALL_FAULTS}
CLEAN = "seeds"  # the scene that paintings and palettes with faults are put on
ORDINARY_STYLE = 256  # pixels a side of the painting for scenes with faults: views of 160 ask for 240 of it


@dataclass(frozen=True)
class Method:
    """field: the kind that is fitted first. style: what `stylerf stylize --method` calls it. edit: of a part of the
    scene, `recolor`, `paint` (both LAENeRF's) or `palette` (PaletteNeRF's). Neither: a fit alone."""

    name: str
    field: str = "vm"
    style: str = ""
    edit: str = ""

    @property
    def family(self) -> str:
        """By which criterion it is judged."""
        return EDITS if self.edit else STYLIZATIONS if self.style else FITS

    @property
    def sees_painting(self) -> bool:
        """Whether it is given a painting."""
        return bool(self.style) or self.edit == "paint"

    def faces(self, fault: Fault) -> bool:
        """A fit never sees a painting, nor a palette; that of PaletteNeRF begins with its hull's corners alone."""
        if fault.of == PALETTE:
            return self.edit == "recolor" or (self.edit == "palette" and fault.name != "palette-random")
        return self.sees_painting or fault.of != STYLE


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
