"""Blends of small fields that differ in kind of color, color map and threshold, as tests of them share."""

from dataclasses import replace

import numpy as np
import torch

from stylerf.fields.blended_color import BlendedColor, Layer
from stylerf.fields.color_map import ColorMap
from stylerf.fields.radiance_field import RadianceField
from stylerf.rendering.rays import render_rays
from tests.stylerf.small import SPACES, field_of, hash_color, rays_into, vm_color

CELLS = 8
RAYS = rays_into(SPACES["box"], 60, 1)
# Many pixels of it are clamped, at both ends.
STRONG = ColorMap(torch.tensor([[1.6, 0.2, -0.1], [-0.3, 1.8, 0.1], [0.0, 0.3, 1.5]]), torch.tensor([0.1, -0.3, 0.2]))

# It mixes the channels, and no color of 0..1 leaves 0..1.
MILD = ColorMap(torch.tensor([[0.1, 0.6, 0.1], [0.5, 0.1, 0.1], [0.1, 0.1, 0.6]]), torch.tensor([0.1, 0.05, 0.15]))


def fields(space: str = "box") -> dict[str, RadianceField]:
    """A source and three stylizations of it; the last bends it."""
    source = field_of(SPACES[space], 3)
    grid = np.random.default_rng(4).uniform(-0.03, 0.03, (5, 5, 5, 3)).astype(np.float32)
    return {
        "source": source,
        "mapped": replace(source, color=hash_color(5), color_map=STRONG, weight_threshold=0.3),
        "plain": replace(source, color=vm_color(6, degree=2), weight_threshold=0.05),
        "bent": replace(source, color=hash_color(7), displacement=grid),
    }


def corner() -> np.ndarray:
    """[CELLS]^3 bool: a part of the cube that some rays miss."""
    marked = np.zeros((CELLS,) * 3, bool)
    marked[:3, :, :5] = True
    return marked


def layer(field: RadianceField, weight: float, within: np.ndarray | None = None) -> Layer:
    return Layer(field.color, field.color_map, field.weight_threshold, weight, within)


def over(field: RadianceField, *layers: Layer) -> RadianceField:
    """The field with a blend of layers in place of its color."""
    return replace(field, color=BlendedColor(layers), color_map=None)


def picture(field: RadianceField, threads: int = 2) -> np.ndarray:
    """[rays, 5], by the field's own threshold."""
    return render_rays(field, RAYS, threads=threads, weight_threshold=field.weight_threshold).out


def meets(field: RadianceField, marked: np.ndarray) -> np.ndarray:
    """[rays] bool: whether a ray has a sample with weight in marked cells, counted one by one."""
    samples = render_rays(field, RAYS, threads=2).samples
    found = np.zeros(len(samples.ends), bool)
    for ray, (start, end) in enumerate(zip(samples.starts, samples.ends)):
        for k in range(start, end):
            cell = np.clip((samples.x[k] * np.float32(len(marked))).astype(int), 0, len(marked) - 1)
            found[ray] |= bool(samples.weights[k] > 0 and marked[tuple(cell)])
    return found
