"""Rendered views as EXR: linear light in the chosen color space, masks and mattes by channel."""

from collections.abc import Mapping

import numpy as np

from schemas.color_spaces import COLOR_SPACES, REC709, matrix_between
from schemas.exr import ExrView
from schemas.images import linear_from_srgb
from schemas.scene import Bounds
from stages.artifacts.region import channels_of
from stages.configs.render import RenderConfig
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import RenderedView


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
