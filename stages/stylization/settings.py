"""What the options of a stylization decide: the grain of its colors, rays, layers, weights, by method and scene."""

from collections.abc import Mapping

import numpy as np
import torch

from stages.configs.fit import budget_of
from stages.configs.stylize import COLOR_CELLS, StylizeConfig
from stylerf.fields.hash_color import HashColor
from stylerf.fields.protocol import ColorPart
from stylerf.fields.region_color import RegionColor
from stylerf.style.feature_extractor import LAYERS, layers_of
from stylerf.style.style_objective import StyleWeights
from stylerf.training.stylize.settings import StyleSettings

SMALL_VIEW = 256  # pixels of its longer side
FINER = 1.25  # cells for each pixel's width
# What holds shapes in a capture holds the silhouettes of an object alone so fast that nothing is seen to bend; its
# shapes have nothing around them to tear (docs/decisions/0015).
ELSE = {"content_weight": 0.02, "color_weight": 10.0, "displacement_weight": 0.003, "coarse": 0.0}
BENT_OBJECT = ELSE | {"color_weight": 1.0, "displacement_weight": 0.0, "coarse": 0.6}
# Ref-NPR: 5e-3 where ARF has 1e-3 for content, 5 for coarse colors.
BY_REFERENCE = ELSE | {"content_weight": 0.1, "color_weight": 5.0}
VARIATION = {"desrf": ("diagonal", 0.1)}  # DeSRF: 0.5 beside a style weight of 5
# Blocks 1 to 3 (Gram), 2 and 3 (templates) and 4 (coarse matches) of programs that count them from 0.
TAPS = {"nnfm": "conv3", "gram": "conv2,conv3,conv4"}
TEMPLATE_TAPS = "conv3,conv4"
COARSE_BLOCK = "conv5"


def new_color(config: StylizeConfig, generator: np.random.Generator, pixel_cells: float) -> HashColor:
    """The color field to learn. pixel_cells: cells a side as wide as what a pixel sees, nan if nothing is seen.

    Finer ones are taught by single views, each its own cell, and what they learn shows as grain from between them.
    """
    finest = finest_cells(config.finest, pixel_cells)
    return HashColor.create(generator, levels=config.levels, finest=finest, table=1 << config.table_bits)


def own_color(
    config: StylizeConfig, base: ColorPart, cells: np.ndarray, generator: np.random.Generator, pixel_cells: float
) -> RegionColor:
    """As new_color, over `base` in marked cells [s, s, s] of the cube alone; at first it is the base."""
    finest = float(finest_cells(config.finest, pixel_cells))
    return RegionColor.create(base, cells, finest, 1 << config.table_bits, config.levels)


def finest_cells(asked: int, pixel_cells: float) -> int:
    """Cells a side of a new color's finest level: as asked for, or FINER than a pixel, within COLOR_CELLS."""
    least, most = COLOR_CELLS
    if asked:
        return asked
    return int(np.clip(round(FINER * pixel_cells / 16) * 16, least, most)) if np.isfinite(pixel_cells) else least


def rays_of(config: StylizeConfig, long_side: int) -> str:
    """Shapes held fast cost little to paint, and so do small views; walked anew, a large one costs more than the trunk.

    Dilated rays leave grain in small views, where a cell of the color is hardly wider than the gaps: decision 0013.
    """
    if config.rays != "auto":
        return config.rays
    return "dilated" if config.method == "desrf" and long_side > SMALL_VIEW else "deferred"


def painting_loss(config: StylizeConfig) -> str:
    """nnfm or gram: by what views, or pictures, are set against the painting."""
    if config.method == "refnpr":
        return "gram" if config.reference_by == "gram" else "nnfm"
    return config.image_by if config.method == "snerf" else "nnfm"


def painting_taps(config: StylizeConfig, state: Mapping[str, torch.Tensor]) -> str:
    """Layers at which they are."""
    given = "" if config.method == "refnpr" else config.taps
    return given or of_those(TAPS[painting_loss(config)], state)


def template_taps(config: StylizeConfig, state: Mapping[str, torch.Tensor]) -> str:
    """Layers at which a view finds its like in a reference."""
    return config.taps or of_those(TEMPLATE_TAPS, state)


def of_those(taps: str, state: Mapping[str, torch.Tensor]) -> str:
    """The layers that the weights have, of a default; all of them where they have none, to be refused by name."""
    return ",".join(layer for layer in layers_of(taps) if f"{layer}.weight" in state) or taps


def coarse_taps(state: Mapping[str, torch.Tensor]) -> str:
    """What finds coarse matches with a reference: block 5, or the deepest layer of weights that end before it."""
    there = [layer for layer in LAYERS if f"{layer}.weight" in state]
    whole = set(layers_of(COARSE_BLOCK)) <= set(there)
    return COARSE_BLOCK if whole else there[-1]


def match_of(config: StylizeConfig) -> str:
    """Ref-NPR matches no colors. A reference that is painted from a matched photo asks for matched photos, too."""
    if config.match != "auto":
        return config.match
    if config.method != "refnpr":
        return "both"
    return "none" if config.reference or config.reference_by == "adain" else "before"


def settings_of(config: StylizeConfig, long_side: int, closed: bool, region: bool = False) -> StyleSettings:
    """closed: whether the field is a capture, rather than an object alone. region: whether a part of it is stylized.

    Colors over the field's own look as the photos do from the start, unless other colors are asked for.
    """
    own = BENT_OBJECT if config.method == "desrf" and not closed else ELSE
    own = BY_REFERENCE if config.method == "refnpr" else own
    held = {name: value if getattr(config, name) == -1 else getattr(config, name) for name, value in own.items()}
    seconds, steps = budget_of(config.budget)
    variation, variation_weight = VARIATION.get(config.method, ("squared", 1.0))
    if config.variation_weight >= 0:
        variation_weight = config.variation_weight
    weights = StyleWeights(config.style_weight, held["content_weight"], variation_weight, held["color_weight"])
    painting_weights = weights
    if config.method == "refnpr":
        painting_weights = StyleWeights(1.0, ELSE["content_weight"], variation_weight, ELSE["color_weight"])
    return StyleSettings(
        steps=steps,
        seconds=seconds or 1.0,
        refit_steps=1 if region and match_of(config) == "none" else config.refit_steps,
        rate=config.rate,
        deform_rate=config.deform_rate,
        displacement_weight=held["displacement_weight"],
        displacement_vertices=config.displacement_vertices,
        variation=variation,
        strategy=rays_of(config, long_side),
        dilation=config.dilation,
        blur=config.blur,
        remember=config.remember,
        match=match_of(config),
        weights=painting_weights,
        template_weights=weights,
        coarse=held["coarse"],
        feature_scale=config.feature_scale or min(1.0, max(0.5, 256 / long_side)),
        style_scale=config.style_scale,
        style_rows=config.style_rows,
        style_basis=config.style_basis,
        loss=painting_loss(config),
        rounds=config.rounds,
        image_share=config.image_share,
        image_steps=config.image_steps,
        image_rate=config.image_rate,
        reference_steps=config.reference_steps,
        reference_weight=config.reference_weight,
        rollbacks=config.rollbacks,
        clip=config.clip,
        least_spread=config.least_spread,
        most_gain=config.most_gain,
    )
