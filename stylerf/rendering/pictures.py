"""Buffers as pictures for the eye."""

import numpy as np


def depth_picture(z: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Planar depth [h, w] in a perceptual colour map, near bright, by inverse depth; [h, w, 3] uint8, void black."""
    from matplotlib import colormaps

    seen = (alpha > 0.5) & (z > 0)
    inverse = np.where(seen, 1 / np.maximum(z, 1e-6), 0)
    low, high = np.percentile(inverse[seen], [1, 99]) if seen.any() else (0.0, 1.0)
    level = np.clip((inverse - low) / max(high - low, 1e-9), 0, 1)
    colours = colormaps["viridis"](level)[..., :3] * seen[..., None]
    return (colours * 255 + 0.5).astype(np.uint8)
