"""OpenEXR files of rendered views (color, planar depth, ray distance, masks and the camera), and of ST maps.

Channels of a view: R G B A half (linear, premultiplied), Z float32 (along the camera's axis, not along the ray),
rayDistance.Z float32 (along the ray), mask.<name> half, and Cryptomatte's. One scanline part with ZIP compression,
whose checksum detected each of 1,100 flipped bytes.
"""

import errno
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from schemas.atomic_write import refusal_of_disk, replacing
from schemas.color_spaces import COLOR_SPACES
from schemas.cryptomatte import cryptomatte_attributes, cryptomatte_channels
from schemas.errors import BadInput, one_line
from schemas.json_numbers import LARGEST_SIDE
from schemas.native_output import native_output_silenced
from schemas.safe_reading import check_allowance, opened

# Depth where alpha is 0: compositors sort by Z, so a 0 would put empty pixels in front of everything.
FAR_Z = 1e10
LARGEST_HALF = 65504.0
PREFIX = "stylerf:"
_REQUIRED = {"R": "f2", "G": "f2", "B": "f2", "A": "f2", "Z": "f4", "rayDistance.Z": "f4"}
# The EXR standard's camera is left-handed: x right and z forward as OpenCV's, but y up.
_Y_UP = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class ExrView:
    """One rendered view.

    Attributes:
        rgb: [h, w, 3] linear light of `colorspace`, multiplied by alpha.
        alpha: [h, w] 0..1.
        z: [h, w] planar depth, scene units, FAR_Z where alpha is 0.
        ray_distance: [h, w] distance along the ray, likewise.
        world_from_camera: [4, 4], OpenCV axes.
        intrinsics: fx, fy, cx, cy in pixels.
        near, far: Scene units.
        masks: By name, [h, w] 0..1.
        attributes: Provenance, stored as `stylerf:<key>`.
        colorspace: A key of COLOR_SPACES.
        mattes: Coverages to be written as Cryptomatte, by name, [h, w] 0..1; not read back.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    z: np.ndarray
    ray_distance: np.ndarray
    world_from_camera: np.ndarray
    intrinsics: tuple[float, float, float, float]
    near: float
    far: float
    masks: dict[str, np.ndarray] = field(default_factory=dict)
    attributes: dict[str, str] = field(default_factory=dict)
    colorspace: str = "lin_rec709"
    mattes: dict[str, np.ndarray] = field(default_factory=dict)


def world_to_camera(world_from_camera: np.ndarray) -> np.ndarray:
    """Return the EXR attribute worldToCamera [4, 4], which maps row vectors (x, y, z, 1) to (right, up, forward, 1)."""
    return (_Y_UP @ np.linalg.inv(world_from_camera)).T


def world_to_ndc(
    world_from_camera: np.ndarray,
    intrinsics: tuple[float, float, float, float],
    size: tuple[int, int],
    near: float,
    far: float,
) -> np.ndarray:
    """Return the EXR attribute worldToNDC [4, 4], which maps row vectors to (u, v, depth), after division by w.

    (0, 0) is the upper left and (1, 1) the lower right corner of the image; depth is 0 at near and 1 at far.
    """
    fx, fy, cx, cy = intrinsics
    width, height = size
    projection = np.array(
        [
            [fx / width, 0.0, cx / width, 0.0],
            [0.0, fy / height, cy / height, 0.0],
            [0.0, 0.0, far / (far - near), -far * near / (far - near)],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    return (projection @ np.linalg.inv(world_from_camera)).T


def write_exr(path: Path | str, view: ExrView) -> None:
    """Write `view` atomically; equal views give equal bytes.

    Raises:
        ValueError: Arrays differ in size or hold NaN.
        OutOfResources: The disk is full or read-only.
    """
    path = Path(path)
    channels = _channels(view)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **view_attributes(view)}
    if view.mattes:
        header |= cryptomatte_attributes(view.mattes)
    write_part(path, header, channels, sum(array.nbytes for array in channels.values()))


def _channels(view: ExrView) -> dict[str, np.ndarray]:
    planes = {"R": view.rgb[..., 0], "G": view.rgb[..., 1], "B": view.rgb[..., 2], "A": view.alpha}
    planes |= {f"mask.{name}": mask for name, mask in view.masks.items()}
    planes = {name: np.clip(plane, -LARGEST_HALF, LARGEST_HALF).astype(np.float16) for name, plane in planes.items()}
    hit = planes["A"] > 0  # as stored: half precision may round a small alpha to 0
    planes["Z"] = np.where(hit, view.z, FAR_Z).astype(np.float32)
    planes["rayDistance.Z"] = np.where(hit, view.ray_distance, FAR_Z).astype(np.float32)
    if view.mattes:
        planes |= cryptomatte_channels(view.mattes)
    for name, plane in planes.items():
        if plane.shape != view.alpha.shape or plane.ndim != 2 or plane.size == 0:
            raise ValueError(f"EXR channel {name} has shape {plane.shape}, alpha {view.alpha.shape}")
        if not np.isfinite(plane).all():
            raise ValueError(f"EXR channel {name} contains NaN or infinity")
    # OpenEXR silently writes strided arrays wrongly (its issue 1929).
    return {name: np.ascontiguousarray(plane) for name, plane in planes.items()}


def view_attributes(view: ExrView) -> dict[str, Any]:
    """Return the header's entries on color, camera and provenance; ValueError where the camera is invalid."""
    height, width = view.alpha.shape
    fx, fy, cx, cy = view.intrinsics
    pose = np.asarray(view.world_from_camera, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError("the pose of an EXR view must be a finite 4x4 matrix")
    if not (0 < view.near < view.far < np.inf):
        raise ValueError(f"an EXR view needs 0 < near < far, not {view.near} and {view.far}")
    space = COLOR_SPACES[view.colorspace]
    standard = {
        "chromaticities": space.chromaticities,
        "colorInteropID": space.interop_id,
        "pixelAspectRatio": float(fy / fx),
        # The part of the plane at distance 1 that the image covers, y up.
        "screenWindowCenter": np.array([(width / 2 - cx) / fx, (cy - height / 2) / fy], dtype=np.float32),
        "screenWindowWidth": float(width / fx),
        "worldToCamera": _matrix(world_to_camera(pose)),
        "worldToNDC": _matrix(world_to_ndc(pose, view.intrinsics, (width, height), view.near, view.far)),
        "software": "stylerf",
    }
    # The standard attributes are float32, so the exact camera is stored as text too.
    exact = {
        "world_from_camera": _numbers(pose.ravel()),
        "intrinsics": _numbers(view.intrinsics),
        "near": _numbers([view.near]),
        "far": _numbers([view.far]),
        **view.attributes,
    }
    return standard | {PREFIX + key: str(value) for key, value in exact.items()}


def _matrix(matrix: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(matrix, dtype=np.float32)


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def read_channels(path: Path | str, required: tuple[str, ...]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read all channels [h, w] by name, in their stored types, and the header of a single-part, flat EXR.

    Raises:
        BadInput: The file is missing, not an EXR, damaged, deep, multi-part or multi-resolution; lacks a `required`
            channel; has subsampled channels, or a data window other than its display window.
        OutOfResources: It would need more memory than allowed (see schemas.safe_reading).
    """
    path = Path(path)
    try:
        with opened(path):
            pass
    except FileNotFoundError:
        raise BadInput(f"{path}: no such EXR file") from None
    shape = _checked_header(path, required)
    parts = _parts(path, header_only=False)
    if len(parts) != 1:  # OpenEXR drops damaged parts with a mere warning
        raise BadInput(f"{path} is damaged: its pixels cannot be read; make or fetch it again")
    channels = {name: np.array(channel.pixels) for name, channel in parts[0].channels.items()}
    if missing := [name for name in required if name not in channels]:
        raise BadInput(f"{path} is damaged: channel {missing[0]} cannot be read; make or fetch it again")
    if wrong := [name for name, plane in channels.items() if plane.shape != shape]:
        raise BadInput(f"{path}: channel {wrong[0]} has shape {channels[wrong[0]].shape}, expected {shape}")
    return channels, dict(parts[0].header)


def _parts(path: Path, header_only: bool) -> list[Any]:
    try:
        with native_output_silenced():
            OpenEXR.setMaxImageSize(LARGEST_SIDE, LARGEST_SIDE)
            return list(OpenEXR.File(str(path), separate_channels=True, header_only=header_only).parts)
    except (RuntimeError, ValueError, TypeError, MemoryError, OverflowError, UnicodeError, IndexError) as error:
        raise BadInput(f"{path} is not a readable EXR ({one_line(error)}); make or fetch it again") from error


def _checked_header(path: Path, required: tuple[str, ...]) -> tuple[int, int]:
    """Check everything that read_channels requires of a header; return (height, width)."""
    parts = _parts(path, header_only=True)
    if len(parts) != 1:
        raise BadInput(f"{path} is damaged or not a single-part EXR: it has {len(parts)} readable parts, expected 1")
    header = parts[0].header
    listed, tiles = header.get("channels", []), header.get("tiles")
    try:
        names = [channel.name for channel in listed]
    except UnicodeDecodeError:
        raise BadInput(f"{path} is damaged: the name of a channel is not text; make or fetch it again") from None
    if header.get("type") not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise BadInput(f"{path} is a deep EXR, with a list of samples for each pixel; flatten it")
    if tiles is not None and tiles.mode != OpenEXR.ONE_LEVEL:
        raise BadInput(f"{path} is an EXR with mip levels; save it with a single resolution")
    if missing := [name for name in required if name not in names]:
        raise BadInput(f"{path} lacks channels {', '.join(missing)}; it has {', '.join(names[:12]) or 'none'}")
    if thin := [channel.name for channel in listed if (channel.xSampling, channel.ySampling) != (1, 1)]:
        raise BadInput(f"{path}: channel {thin[0]} is subsampled; expected a value for every pixel")
    window, display = (
        [[int(value) for value in corner] for corner in header[key]] for key in ("dataWindow", "displayWindow")
    )
    if window != display:
        raise BadInput(
            f"{path}: its data window {window[0]} to {window[1]} differs from its display window {display[0]} to "
            f"{display[1]}; expected pixels for the whole picture"
        )
    width, height = window[1][0] - window[0][0] + 1, window[1][1] - window[0][1] + 1
    check_allowance(path, width, height, 4 * width * height * len(listed))
    return height, width


def read_exr(path: Path | str) -> ExrView:
    """Read a view that write_exr wrote: float32 arrays and the exact camera.

    Raises:
        BadInput: The file is unreadable, was not written by write_exr, or holds NaN.
    """
    path = Path(path)
    channels, header = read_channels(path, tuple(_REQUIRED))
    for name, code in _REQUIRED.items():
        if channels[name].dtype != np.dtype(code):
            raise BadInput(f"{path}: channel {name} is {channels[name].dtype}, expected {np.dtype(code)}")
    planes = {name: plane.astype(np.float32) for name, plane in channels.items()}
    if bad := [name for name, plane in planes.items() if not np.isfinite(plane).all()]:
        raise BadInput(f"{path}: channel {bad[0]} contains NaN or infinity")
    interop = header.get("colorInteropID")  # none in older files, which are Rec.709
    own = {key.removeprefix(PREFIX): str(value) for key, value in header.items() if key.startswith(PREFIX)}
    try:
        pose = np.array([float(word) for word in own.pop("world_from_camera").split()]).reshape(4, 4)
        fx, fy, cx, cy = (float(word) for word in own.pop("intrinsics").split())
        near, far = float(own.pop("near")), float(own.pop("far"))
    except (KeyError, ValueError) as error:
        raise BadInput(f"{path} was not written by stylerf: its camera attributes are missing ({error})") from error
    return ExrView(
        rgb=np.stack([planes["R"], planes["G"], planes["B"]], axis=-1),
        alpha=planes["A"],
        z=planes["Z"],
        ray_distance=planes["rayDistance.Z"],
        world_from_camera=pose,
        intrinsics=(fx, fy, cx, cy),
        near=near,
        far=far,
        masks={name.removeprefix("mask."): plane for name, plane in planes.items() if name.startswith("mask.")},
        attributes=own,
        colorspace=next((name for name, one in COLOR_SPACES.items() if one.interop_id == interop), "lin_rec709"),
    )


def read_depth(path: Path | str) -> np.ndarray:
    """Read the Z channel of any EXR as float32 [h, w]; BadInput if it is missing or holds NaN."""
    depth = read_channels(path, ("Z",))[0]["Z"].astype(np.float32)
    if np.isnan(depth).any():
        raise BadInput(f"{path}: channel Z contains NaN")
    return depth


def write_part(path: Path, header: dict[str, Any], channels: dict[str, np.ndarray], size: int) -> None:
    """Write a single-part file of any channels atomically; equal arguments give equal bytes.

    Args:
        header: Attributes; `type` and `compression` too.
        channels: [h, w] each, contiguous: OpenEXR silently writes strided arrays wrongly (its issue 1929).
        size: Bytes of the channels, for the message if the disk is full.

    Raises:
        OutOfResources: The disk is full or read-only.
    """
    with replacing(path) as temporary:
        try:
            with native_output_silenced():
                OpenEXR.File(header, dict(channels)).write(str(temporary))  # a copy: OpenEXR replaces its values
        except RuntimeError as error:
            message = f"the EXR writer failed ({one_line(error)})"
            raise refusal_of_disk(path, size) or OSError(errno.EIO, message, str(path)) from error


def write_st_map(path: Path | str, positions: np.ndarray) -> None:
    """Write the positions [h, w, 2] of an ST map (stylerf/geometry/st_maps.py) atomically as R and G, float32; B is 0.

    Raises:
        ValueError: They are not finite.
        OutOfResources: The disk is full or read-only.
    """
    if positions.ndim != 3 or positions.shape[2] != 2 or not np.isfinite(positions).all():
        raise ValueError(f"an ST map must be finite and of shape [h, w, 2], found {positions.shape}")
    planes = {"R": positions[..., 0], "G": positions[..., 1], "B": np.zeros(positions.shape[:2])}
    channels = {name: np.ascontiguousarray(plane, dtype=np.float32) for name, plane in planes.items()}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "colorInteropID": "data",  # positions: no color management
        "software": "stylerf",
    }
    write_part(Path(path), header, channels, sum(plane.nbytes for plane in channels.values()))
