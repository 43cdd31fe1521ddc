"""A table of tiny captures and paintings, quick to run and the same to the byte each time: budgets in steps."""

import json
from pathlib import Path

import numpy as np

from schemas.images import write_png
from tests.stylerf_cli import capture

FIT = {"budget": 40, "capacity": "fixed:32x8x8", "samples": 3000, "checkpoint_every_seconds": 0.1}
STYLIZE = {
    "budget": 2, "refit_steps": 5, "levels": 4, "finest": 64, "table_bits": 12, "checkpoint_every_seconds": 0.1,
}  # fmt: skip
RENDER = {"path": "orbit", "count": 4, "shards": 2}
EVAL = {"path": "orbit", "perceptual": "none"}


def write_captures(folder: Path, scenes: int, styles: int) -> None:
    """capture0/, capture1/, ... with poses, painting0.png, painting1.png, ..., each of its own pixels."""
    for number in range(scenes):
        capture.write_images(folder / f"capture{number}")
        content = capture.transforms()
        for frame in content["frames"]:  # captures of one digest would be one scene to `compare`
            frame["transform_matrix"][0][3] += 0.01 * number
        capture.write_transforms(folder / f"capture{number}", content)
    for number in range(styles):
        pixels = np.random.default_rng(number).integers(0, 256, (64, 64, 3))
        write_png(folder / f"painting{number}.png", pixels.astype(np.uint8))


def write_table(folder: Path, scenes: int, styles: int, seeds: int = 1, **more: object) -> Path:
    """Write captures, paintings and table.yaml, which is JSON and so YAML too; return the table."""
    write_captures(folder, scenes, styles)
    content = {
        "scenes": {f"scene{number}": f"capture{number}" for number in range(scenes)},
        "styles": {f"style{number}": f"painting{number}.png" for number in range(styles)},
        "methods": {"arf": {}, "bold": {"method": "arf", "stroke": 2.0}},
        "seeds": list(range(seeds)),
        "fit": FIT,
        "stylize": STYLIZE,
        "render": RENDER,
        "eval": EVAL,
        "threads": 1,
        **more,
    }
    table = folder / "table.yaml"
    table.write_text(json.dumps(content, indent=1))
    return table


def warming(folder: Path) -> list[list[str]]:
    """The commands of one column of such a table, for the server that runs the others."""
    write_captures(folder, 1, 1)
    fit, stylize = (_flags(options) for options in (FIT, STYLIZE))
    return [
        ["import", str(folder / "capture0"), "work"],
        ["fit", "work", "--no-buffers", *fit],
        ["stylize", "work", "--style", str(folder / "painting0.png"), "--name", "styled", *stylize],
        ["render", "work", "--of", "styled", "--count", "2"],
        ["eval", "work", "--of", "styled", "--path", "orbit", "--perceptual", "none"],
    ]


def _flags(options: dict[str, object]) -> list[str]:
    return [word for key, value in options.items() for word in (f"--{key.replace('_', '-')}", str(value))]
