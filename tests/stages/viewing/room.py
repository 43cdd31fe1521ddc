"""A small work folder to view: a ball of fog and a palette field of the same density, seen by two cameras."""

from pathlib import Path

import numpy as np

from schemas.work_folder import WorkFolder
from stages.artifacts.edit import save_palette
from stages.artifacts.field import save_field
from stages.viewing.cameras import Pose
from stylerf.fields.palette_color import PaletteColor
from stylerf.geometry.space_warp import SpaceWarp
from tests.stages import evaluation_fixture as made
from tests.stylerf.small import field_of, vm_color

PALETTE = np.float32([[0.8, 0.1, 0.1], [0.1, 0.6, 0.2], [0.1, 0.2, 0.8], [0.9, 0.8, 0.3]])
SHARES = [0.1, 0.4, 0.2, 0.3]
FRONT = Pose((1.0, 0.0, 0.0, 0.0), (0.05, 0.0, 0.0), 0.76, 4 / 3)


def furnished(folder: Path) -> WorkFolder:
    """Fill a work folder: scene `wall`, fields `plain` and `palette`."""
    work = WorkFolder(folder)
    scene = made.make_scene(work, [0.0, 0.3], depth=False, split="train")
    space = SpaceWarp.box([-1, -1, 2], [1, 1, 4])
    color = PaletteColor.create(np.random.default_rng(0), PALETTE, 8, 40, 512, base=3)
    for name, stage, own in (("plain", "nerf_fit", vm_color(1)), ("palette", "decompose", color)):
        field = field_of(space, 3, own)
        field.density.values[-1] = 3.0

        def write(place, field=field, name=name):
            save_field(place, field, "none")
            if name == "palette":
                save_palette(place, color.palette, color.palette, SHARES, {})

        made.commit(work, "field", name, stage, {"scene": scene}, write)
    return work
