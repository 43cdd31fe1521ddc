"""Plates: the photos of a scene's views as they were taken, with the distortion of their lenses."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.json_numbers import LARGEST_PICTURE, LARGEST_SIDE
from schemas.st_map_exr import write_st_map
from stages.artifacts.scene import SceneData
from stylerf.errors import InvalidValue
from stylerf.geometry.distortion import Distortion
from stylerf.geometry.lens_camera import LensCamera, at_size, through_lens
from stylerf.geometry.st_maps import redistort_map, undistort_map

FOLDER = "st_maps"


@dataclass(frozen=True)
class StMaps:
    """Paths of the maps of one lens inside the frames."""

    undistort: str
    redistort: str


def plate_camera(scene: SceneData, index: int) -> LensCamera:
    """The camera of view `index` at its photo's size and with its lens; BadInput where the scene does not know it."""
    view = scene.views[index]
    if (lens := view.lens) is None:
        raise BadInput(
            f"{scene.folder}: the scene does not know the lens of view {view.name}'s photo; scenes imported by "
            "earlier versions lack it: run `stylerf import` again"
        )
    if max(lens.width, lens.height) > LARGEST_SIDE or lens.width * lens.height > LARGEST_PICTURE:
        raise BadInput(
            f"{scene.folder}: the photo of view {view.name} is {lens.width}x{lens.height}; at most {LARGEST_SIDE} "
            f"pixels a side and {LARGEST_PICTURE / 1e6:.0f} million in all can be rendered"
        )
    stored = lens.distortion
    p1, p2 = stored.tangential
    try:
        distortion = Distortion(stored.kind, stored.radial, (p1, p2), stored.denominator, stored.others)
        intrinsics = (lens.fx, lens.fy, lens.cx, lens.cy)
        return through_lens(scene.cameras[index], (lens.width, lens.height), intrinsics, distortion)
    except InvalidValue as error:
        raise BadInput(f"{scene.folder}: the lens of view {view.name} is not sound ({error})") from error


def map_files(scene: SceneData, views: Sequence[int]) -> dict[int, StMaps]:
    """By view, the maps of its lens; views that share a lens share its maps."""
    lenses: dict[tuple, int] = {}
    found = {}
    for index in views:
        number = lenses.setdefault(_lens_key(scene, index), len(lenses))
        found[index] = StMaps(*(f"{FOLDER}/lens_{number:03d}_{name}.exr" for name in ("undistort", "redistort")))
    return found


def _lens_key(scene: SceneData, index: int) -> tuple:
    plate, view = plate_camera(scene, index), scene.views[index]
    return (view.lens, *(getattr(at_size(scene.cameras[index], (plate.width, plate.height)), k) for k in _LENS))


_LENS = ("fx", "fy", "cx", "cy")


def write_st_maps(folder: Path, scene: SceneData, files: dict[int, StMaps]) -> None:
    """Write both maps of every lens, at its photos' size."""
    for maps, index in {maps: index for index, maps in reversed(files.items())}.items():
        plate = plate_camera(scene, index)
        pinhole = at_size(scene.cameras[index], (plate.width, plate.height))
        for path, values in (
            (maps.undistort, undistort_map(plate, pinhole)),
            (maps.redistort, redistort_map(plate, pinhole)),
        ):
            write_st_map(folder / path, np.ascontiguousarray(values))
