"""A tiny scene to stylize by any method: a fog in a box, three views of it, a style image, a small extractor."""

from collections.abc import Callable

import numpy as np

from stylerf.fields.region_color import RegionColor
from stylerf.geometry.camera_paths import look_at
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.style.style_loss import StyleWeights
from stylerf.training.stylize.arf import Arf
from stylerf.training.stylize.scene import StyledScene, StyleProblem
from stylerf.training.stylize.settings import ArfSettings, DesrfSettings, StyleSettings
from stylerf.training.stylize.trainer import StylizationTrainer
from tests.stylerf.small import field_of, hash_color, vm_color
from tests.stylerf.style.small_trunk import picture, small_trunk

BOX = SpaceWarp.box([-1, -1, -1], [1, 1, 1])
HEIGHT, WIDTH, GRAY, VIEWS = 14, 18, 0.75, 3


def camera(index: int, apart: float = 1.3) -> Camera:
    eye = 2.8 * np.array([np.cos(apart * index), np.sin(apart * index), 0.3])
    pose = look_at(eye, np.zeros(3), np.array([0, 0, 1.0]))
    return Camera(f"s{index}", WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


def settings(kind: type = ArfSettings, **more) -> StyleSettings:
    small = {"steps": 12, "refit_steps": 8, "refit_pixels": 128, "feature_scale": 1.0, "style_basis": 0}
    return kind(**{**small, "weight_threshold": 0.1, "weights": StyleWeights(1.0, 0.02, 0.5), **more})


def problem(
    given: StyleSettings, seed: int = 0, apart: float = 1.3, raw: float = -3.0, space: SpaceWarp = BOX, **more
) -> StyleProblem:
    """apart: radians between neighboring views. raw: of the fog's density. more: fields of the problem."""
    field = field_of(space, 3, vm_color(4))
    field.density.values[-1] = raw
    photos = [picture(HEIGHT, WIDTH, 20 + i).permute(1, 2, 0).numpy().copy() for i in range(VIEWS)]
    cameras = [camera(i, apart) for i in range(VIEWS)]
    more = {"threads": 1, "style_image": picture(20, 24, 9), **more}
    return StyleProblem(field, cameras, photos, GRAY, given, seed, **more)


def new_color(generator: np.random.Generator, scene: StyledScene):
    if (region := scene.problem.region) is not None:
        return RegionColor.create(scene.problem.field.color, region, 16.0, table=4096, levels=4)
    return hash_color(int(generator.integers(1000)))


def trainer(method: Callable, given: StyleProblem) -> StylizationTrainer:
    """A stylization by `method`, made from the scene."""
    return StylizationTrainer(method(StyledScene(given, new_color)))


def arf(more: dict | None = None, **given) -> StylizationTrainer:
    """ARF; with a deformation in `more`, DeSRF."""
    kind = DesrfSettings if (more or {}).get("deformation") is not None else ArfSettings
    return trainer(lambda scene: Arf(scene, small_trunk()), problem(settings(kind, **given), **(more or {})))


def stopping(counts: list[int]):
    """For run(): raises Stopped once so many steps in all were reported, for each of the counts in turn."""
    from tests.stylerf.training.running import Stopped

    count, left = [0], list(counts)

    def on_step(now) -> None:
        count[0] += 1
        if left and count[0] == left[0]:
            left.pop(0)
            raise Stopped

    return on_step
