"""From the options of a stylization to its settings (the meaning of `auto`, 0 and -1) and its training."""

import math
import time
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
import torch

from schemas.work_folder import PartialArtifact
from stages.configs.decompose import DecomposeConfig
from stages.configs.fit import budget_of
from stages.configs.stylize import COLOR_CELLS, ArfConfig, DesrfConfig, RefNprConfig, SnerfConfig, StylizeConfig
from stages.run.progress import Context
from stages.run.training_loop import run_training
from stylerf.fields.hash_grid import DETAIL, HashColor
from stylerf.fields.protocol import ColorPart
from stylerf.fields.region_color import RegionColor
from stylerf.style.feature_extractor import LAYERS, layers_of
from stylerf.style.roughness import roughness
from stylerf.style.style_loss import StyleWeights
from stylerf.training.stylize.settings import (
    ArfSettings,
    DesrfSettings,
    ImageStyleSettings,
    RefNprSettings,
    SnerfSettings,
    StyleSettings,
)
from stylerf.training.stylize.trainer import StylizationTrainer

SMALL_VIEW = 256  # pixels of its longer side
FINER = 1.25  # cells per pixel width
# The finest colors learn at a style image's roughness over ROUGH, within bounds (decision 0057).
ROUGH, DETAIL_RATES = 0.05, (0.1, 1.0)
# In finest cells, where features are taken at full size: wider ones learn slowly (decision 0065).
BROAD = 10.0
NARROW = 1.1  # pixels of the images that features are taken of; narrower cells do not learn (decision 0066)
FEATURE_SIDE = 512  # pixels of the longer side that transport takes features of, if not half of a view is more
PLAIN = {
    "content_weight": 0.02, "color_weight": 10.0, "structure_weight": 0.0, "gram_weight": 0.0, "grain_weight": 0.0,
    "coarse": 0.0,
}  # fmt: skip
# By how views are compared with the style image. Transport needs little to hold a view to its photo, and its first half
# of steps, at half the size, makes strokes that are longer than a feature is wide (decision 0049).
DEFAULTS = {
    "transport": {
        "content_weight": 0.005, "color_weight": 1.0, "structure_weight": 8.0, "gram_weight": 2.0, "grain_weight": 4.0,
        "coarse": 0.5,
    },
    "nnfm": PLAIN,
    "gram": PLAIN,
}  # fmt: skip
# Largest change of a displacement per distance, times --bend: 1 would fold space.
SLOPE, STEEPEST = 0.7, 0.9
DEFORM_RATES = {True: 6e-2, False: 2.4e-2}  # of captures and of objects, whose silhouettes bend them sooner
# The weight that preserves a capture's shapes would preserve an object's silhouettes so firmly that no deformation
# shows; nothing around an object can tear (decision 0015).
DEFORMED_OBJECT = {"content_weight": 0.02, "color_weight": 1.0, "coarse": 0.6}
# Of transport, for captures and for objects: edges that may not move do not bend (decisions 0050, 0054).
DEFORMED_STRUCTURE = {True: 4.0, False: 2.0}
DEFORMED_GRAIN = 1.0  # more takes strokes from shapes that give way (decision 0070)
KEPT_COLORS = {"color_weight": 10.0}  # the photos have the desired colors
# Ref-NPR: content 5e-3 where ARF has 1e-3, coarse colors 5.
# A view follows its reference, not the photo's edges or the style image.
REFERENCE = PLAIN | {"content_weight": 0.1, "color_weight": 5.0}
# Of transport, after the coarse steps, in which conv4_1 lengthens strokes at little cost (decision 0069).
FINE_LAYERS = "conv2_1,conv3_1"
# Blocks 1 to 3 (Gram), 2 and 3 (references) and 4 (coarse matches) of programs that count them from 0.
LAYERS_OF = {"nnfm": "conv3", "transport": f"{FINE_LAYERS},conv4_1", "gram": "conv2,conv3,conv4"}
REFERENCE_LAYERS = "conv3,conv4"
COARSE_BLOCK = "conv5"

SETTINGS: dict[type[StylizeConfig], type[ImageStyleSettings]] = {
    ArfConfig: ArfSettings,
    DesrfConfig: DesrfSettings,
    SnerfConfig: SnerfSettings,
    RefNprConfig: RefNprSettings,
}
Settings = TypeVar("Settings", bound=StyleSettings)


def new_color(config: StylizeConfig, generator: np.random.Generator, pixel_cells: float) -> HashColor:
    """Return the color field to train. pixel_cells: cells per side as wide as a pixel, nan if nothing is seen.

    Finer cells would each be trained by single views, and appear as grain from in between.
    """
    finest = finest_cells(config.finest, pixel_cells)
    return HashColor.create(generator, levels=config.levels, finest=finest, table=1 << config.table_bits)


def region_color(config: StylizeConfig, base: ColorPart, cells: np.ndarray, pixel_cells: float) -> RegionColor:
    """Like new_color, but over `base` only in marked cells [s, s, s] of the cube; initially equal to the base."""
    finest = float(finest_cells(config.finest, pixel_cells))
    return RegionColor.create(base, cells, finest, 1 << config.table_bits, config.levels)


def finest_cells(finest: int, pixel_cells: float) -> int:
    """Return the cells per side of a new color's finest level: `finest`; if 0, FINER than a pixel, in COLOR_CELLS."""
    smallest, largest = COLOR_CELLS
    if finest:
        return finest
    if not np.isfinite(pixel_cells):
        return smallest
    return int(np.clip(round(FINER * pixel_cells / 16) * 16, smallest, largest))


def strategy_of(config: ArfConfig, long_side: int) -> str:
    """Return which rays receive gradients.

    Fixed shapes are cheap to render, and so are small views; marching a large view again costs more than its features.
    Dilated rays leave grain in small views, where a color cell is hardly wider than their gaps (decision 0013).
    """
    if config.rays != "auto":
        return config.rays
    return "dilated" if isinstance(config, DesrfConfig) and long_side > SMALL_VIEW else "deferred"


def image_loss(config: StylizeConfig) -> str:
    """Return how views, or images, are compared with the style image: transport, nnfm or gram."""
    by_gram = isinstance(config, RefNprConfig) and config.reference_by == "gram"
    if by_gram or (isinstance(config, SnerfConfig) and config.image_by == "gram"):
        return "gram"
    return "nnfm" if config.match_by == "nearest" else "transport"


def image_layers(config: StylizeConfig, state: Mapping[str, torch.Tensor]) -> str:
    """Return the layers at which they are compared."""
    return own_layers(config) or available(LAYERS_OF[image_loss(config)], state)


def own_layers(config: StylizeConfig) -> str:
    """Return the layers requested for that; refnpr's are of references."""
    return "" if isinstance(config, RefNprConfig) else config.layers


def reference_layers(config: StylizeConfig, state: Mapping[str, torch.Tensor]) -> str:
    """Return the layers at which a view is matched with a reference."""
    return config.layers or available(REFERENCE_LAYERS, state)


def available(layers: str, state: Mapping[str, torch.Tensor]) -> str:
    """Return the default layers that the weights have; all of them if they have none, to be rejected by name."""
    return ",".join(layer for layer in layers_of(layers) if f"{layer}.weight" in state) or layers


def coarse_layers(state: Mapping[str, torch.Tensor]) -> str:
    """Return the layers of coarse matches: block 5, or the deepest layer of weights that end before it."""
    there = [layer for layer in LAYERS if f"{layer}.weight" in state]
    return COARSE_BLOCK if set(layers_of(COARSE_BLOCK)) <= set(there) else there[-1]


def match_of(config: StylizeConfig) -> str:
    """When colors are matched. Ref-NPR matches none, but a reference made of a matched photo needs matched photos."""
    if config.keep_colors:
        return "after"
    if config.match != "auto":
        return config.match
    if not isinstance(config, RefNprConfig):
        return "both"
    return "before" if config.optimizes_reference else "none"


def same_named(config: Any, kind: type[Settings], **others: Any) -> Settings:
    """Return settings with the values of the config's options of the same names, and `others`."""
    shared = {item.name: getattr(config, item.name) for item in fields(kind) if hasattr(config, item.name)}
    seconds, steps = budget_of(config.budget)
    return kind(**(shared | {"steps": steps, "seconds": seconds or 1.0} | others))


def detail_rate_of(config: ArfConfig, style_image: torch.Tensor | None, long_side: int) -> float:
    """Learning rate of the finest colors relative to coarse ones. long_side: of the views whose features are taken."""
    if config.detail_rate != -1:
        return config.detail_rate
    slowest, full = DETAIL_RATES
    if style_image is None:
        return slowest
    rough = roughness(style_image, round(long_side * config.style_scale), config.stroke)
    return min(max(rough / ROUGH, slowest), full)


def scale_for(side: int, long_side: int) -> float:
    """Return the size, relative to a view, of images that features are taken of: half, or up to `side` pixels."""
    return min(1.0, max(0.5, side / long_side))


def weights_of(style: float, variation: float, others: Mapping[str, float]) -> StyleWeights:
    """Return the weights of the loss terms. others: some of DEFAULTS."""
    named = {name.removesuffix("_weight"): value for name, value in others.items() if name.endswith("_weight")}
    return StyleWeights(style=style, variation=variation, **named)


def settings_of(
    config: StylizeConfig,
    long_side: int,
    opaque_background: bool,
    region: bool = False,
    style_image: torch.Tensor | None = None,
) -> ImageStyleSettings:
    """The settings of a stylization.

    Args:
        long_side: Longest side of the views, pixels.
        opaque_background: The field is a capture, not an object alone.
        region: Only a region is stylized; its colors equal the photos' from the start unless they are matched.
        style_image: [3 or 4, h, w]; None is treated as smooth.
    """
    loss, match, kind = image_loss(config), match_of(config), SETTINGS[type(config)]
    defaults = of_image = DEFAULTS[loss]
    if isinstance(config, DesrfConfig) and not opaque_background:
        defaults = defaults | DEFORMED_OBJECT
    if isinstance(config, DesrfConfig) and loss == "transport":
        structure = DEFORMED_STRUCTURE[opaque_background]
        defaults = defaults | {"structure_weight": structure, "grain_weight": DEFORMED_GRAIN}
    if isinstance(config, RefNprConfig):
        defaults = defaults | REFERENCE | {"coarse": of_image["coarse"] if config.optimizes_reference else 0.0}
    if config.keep_colors:
        defaults = defaults | KEPT_COLORS
    chosen = {name: getattr(config, name, -1) for name in defaults}
    found = {name: default if chosen[name] == -1 else chosen[name] for name, default in defaults.items()}
    # DeSRF: 0.5 beside a style weight of 5.
    variation, variation_weight = ("diagonal", 0.1) if isinstance(config, DesrfConfig) else ("squared", 1.0)
    if config.variation_weight >= 0:
        variation_weight = config.variation_weight
    weights = weights_of(config.style_weight, variation_weight, found)
    feature_scale = config.feature_scale or scale_for(FEATURE_SIDE if loss == "transport" else SMALL_VIEW, long_side)
    own: dict[str, Any] = {}
    if loss == "transport" and not own_layers(config):
        own["fine_layers"] = FINE_LAYERS
    if isinstance(config, ArfConfig):
        own["strategy"] = strategy_of(config, long_side)
        own["detail_rate"] = detail_rate_of(config, style_image, round(long_side * feature_scale))
        # Strokes are as fine relative to a small picture as to a large one (decision 0052).
        small = min(1.0, long_side / FEATURE_SIDE)
        own["detail"] = DETAIL * small
        if not isinstance(config, RefNprConfig):
            own["narrow"] = NARROW * small / feature_scale
            own["broad"] = BROAD / feature_scale if loss == "transport" else math.inf
    if isinstance(config, DesrfConfig):
        own["max_slope"] = min(STEEPEST, SLOPE * config.bend)
        own["deform_rate"] = DEFORM_RATES[opaque_background] if config.deform_rate == -1 else config.deform_rate
    if isinstance(config, RefNprConfig):  # references are made as ARF stylizes
        own["reference_feature_weights"] = weights
        own["reference_scale"] = config.feature_scale or scale_for(SMALL_VIEW, long_side)
        weights = weights_of(1.0, variation_weight, of_image)
    return same_named(
        config,
        kind,
        refit_steps=1 if region and match == "none" else config.refit_steps,
        match=match,
        weights=weights,
        loss=loss,
        variation=variation,
        coarse=found["coarse"],
        feature_scale=feature_scale,
        **own,
    )


def train(
    trainer: StylizationTrainer,
    what: str,
    config: StylizeConfig | DecomposeConfig,
    partial: PartialArtifact,
    context: Context,
    labels: Mapping[str, str],
    begun: float,
) -> None:
    """Train to the end, and report how long that takes in total.

    Args:
        what: Its name in errors.
        labels: Of phases, if they are not the phases' names.
        begun: When the stage began, time.monotonic().
    """
    shown, final = "", trainer.phases[-1]
    seconds, _ = budget_of(config.budget)
    if seconds:
        context.progress.say(f"{seconds:.0f} s of training, plus loading and creating new colors for the scene")

    def report(now: StylizationTrainer) -> None:
        nonlocal shown
        state, total = now.state, now.scene.budget.steps
        if state.phase != shown:
            shown = state.phase
            if seconds and shown == final:
                spent, left = time.monotonic() - begun, now.settings.seconds - state.seconds
                context.progress.say(f"about {spent + left:.0f} s or more in total, {spent:.0f} s of it already spent")
            context.progress.start(labels.get(shown, shown), total or seconds, "step" if total else "s")
        last, note = state.curve[-1] if state.curve else {}, ""
        if last:
            note = f"style distance {last['style']:.3f}" if "style" in last else f"squared error {last['mse']:.4f}"
        context.progress.update(state.step if total else min(state.seconds, now.settings.seconds), note)

    run_training(trainer, what, config.checkpoint_every_seconds, partial, context, report)
