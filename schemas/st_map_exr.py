"""EXR files of ST maps: R and G say where each pixel's color comes from (stylerf/geometry/st_maps.py), B is 0."""

from pathlib import Path

import numpy as np
import OpenEXR

from schemas.exr_writing import write_part


def write_st_map(path: Path | str, positions: np.ndarray) -> None:
    """Write positions [h, w, 2] atomically as float32; equal positions give equal bytes.

    Raises:
        ValueError: They are not finite.
        OutOfResources: The disk is full or read-only.
    """
    if positions.ndim != 3 or positions.shape[2] != 2 or not np.isfinite(positions).all():
        raise ValueError(f"an ST map must be finite and of shape [h, w, 2], it is {positions.shape}")
    planes = {"R": positions[..., 0], "G": positions[..., 1], "B": np.zeros(positions.shape[:2])}
    channels = {name: np.ascontiguousarray(plane, dtype=np.float32) for name, plane in planes.items()}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "colorInteropID": "data",  # positions: no color management
        "software": "stylerf",
    }
    write_part(Path(path), header, channels, sum(plane.nbytes for plane in channels.values()))
