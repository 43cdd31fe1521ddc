"""What `render` writes for compositing programs: EXR views, deep samples, ST maps of the photos' lenses.

Colors are linear light in the chosen color space; masks and mattes are channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.color_spaces import COLOR_SPACES, REC709, matrix_between
from schemas.deep_exr import DeepSamples
from schemas.errors import BadInput
from schemas.exr import ExrView, write_st_map
from schemas.images import linear_from_srgb
from schemas.json_numbers import LARGEST_PICTURE, LARGEST_SIDE
from schemas.scene import Bounds
from stages.artifacts.region import channels_of
from stages.artifacts.scene import SceneData
from stages.configs.render import RenderConfig
from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.geometry.distortion import Distortion
from stylerf.geometry.lens_camera import LensCamera, at_size, through_lens
from stylerf.geometry.st_maps import redistort_map, undistort_map
from stylerf.rendering.deep import DeepView
from stylerf.rendering.view import RenderedView

FOLDER = "st_maps"
_LENS = ("fx", "fy", "cx", "cy")
_TINY = 1e-6


def exr_view(
    rendered: RenderedView, camera: Camera, bounds: Bounds, attributes: Mapping[str, str], config: RenderConfig
) -> ExrView:
    """Convert a view to linear, premultiplied color: divide by alpha, linearize, multiply by alpha."""
    channels = channels_of(rendered.masks)
    alpha = rendered.alpha[..., None]
    straight = np.clip(rendered.rgb / np.maximum(alpha, 1e-6), 0, 1)
    return ExrView(
        rgb=in_space(linear_from_srgb(straight) * alpha, config.colorspace),
        alpha=rendered.alpha,
        z=rendered.z,
        ray_distance=rendered.ray_distance,
        world_from_camera=camera.world_from_camera,
        intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy),
        near=bounds.near,
        far=bounds.far,
        masks={channels[name]: mask for name, mask in rendered.masks.items()},
        attributes=dict(attributes),
        colorspace=config.colorspace,
        mattes=rendered.masks if config.cryptomatte else {},
    )


def in_space(rgb: np.ndarray, colorspace: str) -> np.ndarray:
    """Convert linear Rec.709 [..., 3] to a color space; Rec.709 itself keeps its bits."""
    space = COLOR_SPACES[colorspace]
    return rgb if space == REC709 else (rgb @ matrix_between(REC709, space).T).astype(np.float32)



def deep_samples(deep: DeepView, flat: ExrView) -> DeepSamples:
    """Convert a deep view to linear light of the flat view's color space.

    Fields blend sRGB-encoded colors along a ray, compositors add light: the samples' linear colors are scaled, per
    pixel and channel, so that their sum is the flat pixel's color. The sRGB curve is convex, so the factor is at most 1
    (but for a color map's clipping).
    """
    counts = deep.counts.reshape(-1)
    pixel = np.repeat(np.arange(len(counts)), counts)
    straight = np.clip(deep.rgb / np.maximum(deep.weights[:, None], _TINY), 0, 1)
    light = linear_from_srgb(straight) * deep.weights[:, None]
    target = _in_rec709(flat).reshape(-1, 3)
    alpha = np.maximum(flat.alpha.reshape(-1, 1), _TINY)
    total = np.stack([np.bincount(pixel, light[:, a], len(counts)) for a in range(3)], axis=-1)
    dark = total <= _TINY * alpha  # nothing to scale: every sample gets the pixel's own color
    scale = np.where(dark, 0, target / np.maximum(total, _TINY * _TINY))
    rgb = light * scale[pixel] + deep.weights[:, None] * np.where(dark, target / alpha, 0)[pixel]
    rgb = in_space(rgb.astype(np.float32), flat.colorspace)
    return DeepSamples(deep.counts, deep.z, deep.z_back, rgb, deep.weights)


def _in_rec709(flat: ExrView) -> np.ndarray:
    space = COLOR_SPACES[flat.colorspace]
    return flat.rgb if space == REC709 else flat.rgb @ matrix_between(space, REC709).T


@dataclass(frozen=True)
class StMaps:
    """Paths of the maps of one lens inside the frames."""

    undistort: str
    redistort: str


def plate_camera(scene: SceneData, index: int) -> LensCamera:
    """Return the camera of view `index` at its photo's size, with its lens; BadInput if that is not recorded."""
    view = scene.views[index]
    if (lens := view.lens) is None:
        raise BadInput(
            f"{scene.folder}: the lens of the photo of view {view.name} is not recorded (the scene was imported by an "
            "earlier version); run `stylerf import` again"
        )
    if max(lens.width, lens.height) > LARGEST_SIDE or lens.width * lens.height > LARGEST_PICTURE:
        raise BadInput(
            f"{scene.folder}: the photo of view {view.name} is {lens.width}x{lens.height}; at most {LARGEST_SIDE} "
            f"pixels per side and {LARGEST_PICTURE / 1e6:.0f} million in total can be rendered"
        )
    stored = lens.distortion
    p1, p2 = stored.tangential
    try:
        distortion = Distortion(stored.kind, stored.radial, (p1, p2), stored.denominator, stored.others)
        intrinsics = (lens.fx, lens.fy, lens.cx, lens.cy)
        return through_lens(scene.cameras[index], (lens.width, lens.height), intrinsics, distortion)
    except InvalidValue as error:
        raise BadInput(f"{scene.folder}: the lens of view {view.name} is invalid ({error})") from error


def map_files(scene: SceneData, views: Sequence[int]) -> dict[int, StMaps]:
    """Return each view's lens maps; views that share a lens share its maps."""
    lenses: dict[tuple, int] = {}
    found = {}
    for index in views:
        number = lenses.setdefault(_lens_key(scene, index), len(lenses))
        found[index] = StMaps(*(f"{FOLDER}/lens_{number:03d}_{name}.exr" for name in ("undistort", "redistort")))
    return found


def _lens_key(scene: SceneData, index: int) -> tuple:
    plate, view = plate_camera(scene, index), scene.views[index]
    return (view.lens, *(getattr(at_size(scene.cameras[index], (plate.width, plate.height)), k) for k in _LENS))


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
