"""A tiny scene to stylize by any method: a fog in a box, three looks at it, a painting, a trunk of few channels."""

import numpy as np

from stylerf.fields.region_color import RegionColor
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.style.style_objective import StyleWeights
from stylerf.training.stylize.settings import StyleSettings
from tests.stylerf.small import field_of, hash_color, vm_color
from tests.stylerf.style.small_trunk import picture, small_trunk

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])
HEIGHT, WIDTH, GRAY, VIEWS = 14, 18, 0.75, 3


def camera(index: int, apart: float = 1.3) -> Camera:
    eye = 2.8 * np.array([np.cos(apart * index), np.sin(apart * index), 0.3])
    pose = look_at(eye, np.zeros(3), np.array([0, 0, 1.0]))
    return Camera(f"s{index}", WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


def settings(**more) -> StyleSettings:
    small = {"steps": 12, "refit_steps": 8, "refit_pixels": 128, "feature_scale": 1.0, "style_basis": 0, "share": 0.1}
    return StyleSettings(**{**small, "weights": StyleWeights(1.0, 0.02, 0.5), **more})


def made(
    kind: type, seed: int = 0, apart: float = 1.3, raw: float = -3.0, more: dict | None = None, painting=None, **given
):
    """A stylization of class `kind`. apart: radians between neighboring looks. raw: of the fog's density.

    more: may tell the cells `within` which colors of their own learn.
    """
    field = field_of(BOX, 3, vm_color(4))
    field.density.values[-1] = raw
    photos = [picture(HEIGHT, WIDTH, 20 + i).permute(1, 2, 0).numpy().copy() for i in range(VIEWS)]
    cameras = [camera(i, apart) for i in range(VIEWS)]

    def new_color(generator, pixel_cells):
        if "within" in (more or {}):
            return RegionColor.create(field.color, more["within"], 16.0, table=4096, levels=4)
        return hash_color(int(generator.integers(1000)))

    painting = picture(20, 24, 9) if painting is None else painting
    args = (field, cameras, photos, GRAY, painting, small_trunk(), settings(**given), seed, 1, new_color)
    return kind(*args, **(more or {}))


def stopping(counts: list[int]):
    """For run(): raises Stopped once so many steps in all have been told, for each of the counts in turn."""
    from tests.stylerf.training.running import Stopped

    told, left = [0], list(counts)

    def on_step(now) -> None:
        told[0] += 1
        if left and told[0] == left[0]:
            left.pop(0)
            raise Stopped

    return on_step
