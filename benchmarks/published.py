"""Published figures, and the figure in benchmarks/results that corresponds to each."""

from dataclasses import dataclass

SUPPLEMENT = "LAENeRF, supplement"


@dataclass(frozen=True)
class Published:
    """One published figure.

    better: `lower` or `higher`. ours: (result file, {key: value} that selects its row, key in that row, with dots for
    nested objects); None if nothing comparable was measured. unlike: what differs between the two; empty if nothing.
    judged: whether better or worse is meaningful.
    """

    method: str
    what: str
    value: float
    better: str
    source: str
    ours: tuple[str, dict, str] | None
    unlike: str
    unit: str = ""
    judged: bool = True


def _edit(case: str, key: str) -> tuple[str, dict, str]:
    return "edits.json", {"case": case}, key


def _seconds(stage: str) -> tuple[str, dict, str]:
    return _edit("lego shovel, recolored", f"seconds.{stage}")


def _fit(scene: str, budget: str) -> tuple[str, dict, str]:
    return "fit.json", {"scene": scene, "budget": budget}, "psnr"


TIMES = "theirs: other scenes, an NVIDIA GPU; ours: lego at 400x400, two CPU cores"
SET = "ours: a budget of {}, not a result; " + TIMES
SAME_SCENE = "theirs: 800x800, their own masks; ours: 400x400, the region rendered from the field"
NO_SCENE = "scene and masks not available"
NO_FILM = "videos and RAFT flow not available"
FULL_SIZE = "theirs: {}, hours on a GPU; ours: {}, five minutes on two CPU cores"

PUBLISHED = (
    Published("LAENeRF", "extraction of the edit dataset", 16, "lower", f"{SUPPLEMENT}, table 3",
              _seconds("edit-dataset"), TIMES, "s"),
    Published("LAENeRF", "learning the edit", 133, "lower", f"{SUPPLEMENT}, table 3",
              _seconds("edit"), SET.format("400 steps"), "s", judged=False),
    Published("LAENeRF", "distillation", 32, "lower", f"{SUPPLEMENT}, table 3", _seconds("scene"), TIMES, "s"),
    Published("LAENeRF", "fine-tuning", 129, "lower", f"{SUPPLEMENT}, table 3",
              _seconds("field"), SET.format("30 s"), "s", judged=False),
    Published("LAENeRF", "extraction to fine-tuning", 310, "lower", f"{SUPPLEMENT}, table 3",
              _edit("lego shovel, recolored", "seconds_after_selection"), SET.format("400 steps and 30 s"), "s",
              judged=False),
    Published("PaletteNeRF", "palette and decomposition of a scene", 582, "lower", f"{SUPPLEMENT}, table 3",
              ("palettes.json", {"case": "lego shovel", "method": "palettenerf, everywhere"}, "seconds"),
              SET.format("60 s"), "s", judged=False),
    Published("LAENeRF", "lego shovel recolored: palette colors", 5, "lower", f"{SUPPLEMENT}, table 1",
              _edit("lego shovel, recolored", "colors"), SAME_SCENE),
    Published("LAENeRF", "lego shovel recolored: sparsity L_sp", 0.859, "lower", f"{SUPPLEMENT}, table 1",
              _edit("lego shovel, recolored", "sparsity"), SAME_SCENE),
    Published("LAENeRF", "lego shovel recolored: palette TV", 0.107, "lower", f"{SUPPLEMENT}, table 1",
              _edit("lego shovel, recolored", "palette_variation"), SAME_SCENE),
    Published("LAENeRF", "lego shovel stylized: palette colors", 6, "lower", f"{SUPPLEMENT}, table 1",
              _edit("lego shovel, starry_night", "colors"), SAME_SCENE),
    Published("LAENeRF", "lego shovel stylized: sparsity L_sp", 2.129, "lower", f"{SUPPLEMENT}, table 1",
              _edit("lego shovel, starry_night", "sparsity"), SAME_SCENE),
    Published("LAENeRF", "lego shovel stylized: palette TV", 0.029, "lower", f"{SUPPLEMENT}, table 1",
              _edit("lego shovel, starry_night", "palette_variation"), SAME_SCENE),
    Published("LAENeRF", "lego stylized: background MSE", 0.0021, "lower", f"{SUPPLEMENT}, table 4",
              _edit("lego shovel, starry_night", "background_mse"), SAME_SCENE),
    Published("Ref-NPR", "lego stylized: background MSE", 0.0233, "lower", f"{SUPPLEMENT}, table 4",
              ("parts.json", {"case": "lego shovel", "method": "refnpr, of the whole field"}, "background_mse"),
              SAME_SCENE),
    *(
        Published(method, f"{scene} {edit}: background MSE", value, "lower", f"{SUPPLEMENT}, table {table}", None,
                  NO_SCENE)
        for edit, table, rows in (
            ("stylized", 4, (
                ("chair", (("Ref-NPR", 0.0357), ("LAENeRF", 0.0037))),
                ("drums", (("Ref-NPR", 0.0808), ("LAENeRF", 0.0154))),
                ("horns", (("Ref-NPR", 0.0075), ("LAENeRF", 0.0024))),
                ("flower", (("Ref-NPR", 0.0079), ("LAENeRF", 0.0026))),
                ("trex", (("Ref-NPR", 0.0064), ("LAENeRF", 0.0025))),
            )),
            ("recolored", 5, (
                ("horns", (("PaletteNeRF", 0.0195), ("PaletteNeRF, semantic", 0.0028), ("LAENeRF", 0.0010))),
                ("fortress", (("PaletteNeRF", 0.0011), ("PaletteNeRF, semantic", 0.0002), ("LAENeRF", 0.0002))),
                ("flower", (("PaletteNeRF", 0.0076), ("PaletteNeRF, semantic", 0.0022), ("LAENeRF", 0.0007))),
            )),
            ("recolored", 6, (
                ("room", (("PaletteNeRF", 0.0216), ("PaletteNeRF, semantic", 0.0056), ("LAENeRF", 0.0015))),
                ("bonsai", (("PaletteNeRF", 0.0036), ("PaletteNeRF, semantic", 0.0016), ("LAENeRF", 0.0011))),
                ("kitchen", (("PaletteNeRF", 0.0125), ("PaletteNeRF, semantic", 0.0027), ("LAENeRF", 0.0022))),
            )),
        )
        for scene, methods in rows
        for method, value in methods
    ),
    *(
        Published(method, f"consistency of {edit}, {reach}", value, "lower", f"{SUPPLEMENT}, table 2", None, NO_FILM)
        for edit, rows in (
            ("stylizations", (("LAENeRF", 0.0252, 0.1932), ("Ref-NPR", 0.0264, 0.1973))),
            ("recolorings", (("LAENeRF", 0.0167, 0.0934), ("PaletteNeRF, semantic", 0.0164, 0.0925))),
        )
        for method, short, long in rows
        for reach, value in (("short", short), ("long", long))
    ),
    Published("TensoRF VM-192", "lego, held-out PSNR", 36.46, "higher", "TensoRF, per-scene table",
              _fit("lego 400x400", "300s"), FULL_SIZE.format("800x800", "400x400"), "dB"),
    Published("TensoRF", "fern, held-out PSNR", 25.27, "higher", "TensoRF, per-scene table",
              _fit("fern 504x378", "300s"), FULL_SIZE.format("1008x756", "504x378"), "dB"),
    Published("TensoRF", "flower, held-out PSNR", 28.60, "higher", "TensoRF, per-scene table",
              _fit("flower 504x378", "300s"), FULL_SIZE.format("1008x756", "504x378"), "dB"),
    Published("DeSRF", "any figure", float("nan"), "lower", "DeSRF publishes none", None,
              "compares images and a user study only"),
)  # fmt: skip
