"""Reads pictures whose colors count: paintings that a scene or a region is stylized with, references, styles."""

from pathlib import Path

import numpy as np
import torch

from schemas.errors import BadInput
from schemas.images import read_srgb


def read_colors(path: Path) -> np.ndarray:
    """[h, w, 3] float32 sRGB 0..1; transparent parts are white, grays have three channels."""
    pixels = read_srgb(path).pixels
    if pixels.shape[2] == 4:
        return pixels[..., :3] * pixels[..., 3:] + (1 - pixels[..., 3:])
    return np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels


def read_painting(path: Path) -> torch.Tensor:
    """[3, h, w] float32 sRGB 0..1; transparent parts of a painting count as white."""
    pixels = read_colors(path)
    if min(pixels.shape[:2]) < 16:
        raise BadInput(
            f"{path} is {pixels.shape[1]}x{pixels.shape[0]}; a painting of at least 16 pixels a side is needed"
        )
    return torch.from_numpy(np.ascontiguousarray(pixels)).permute(2, 0, 1).contiguous()
