"""Decompose: a field with the same density whose colors mix a palette, learned from the photos (PaletteNeRF)."""

import time

import numpy as np
import torch

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import save_palette
from stages.artifacts.field import load_field, save_field
from stages.artifacts.photos import level_of, photo_for
from stages.artifacts.scene import load_scene
from stages.configs.decompose import DecomposeConfig
from stages.run.memory import available_bytes
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import resumed
from stages.stylization.settings import finest_cells, same_named, train
from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import PaletteColor
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.palettenerf import DecompositionWeights, PaletteNerf
from stylerf.training.stylize.scene import StyleProblem
from stylerf.training.stylize.settings import REFIT, STYLE, StyleSettings
from stylerf.training.stylize.trainer import StylizationTrainer

SPEC = Spec(stage="decompose", verb="stylize", revision=5, writes="field")
FINAL_RATE = 0.1  # of the learning rate, at the end
WORKING_BYTES = 1e9  # what a step needs besides the cached views


def run(inputs: dict[str, Artifact], config: DecomposeConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the decomposed field and its palette; return the figures."""
    begun = time.monotonic()
    scene = load_scene(inputs["scene"], inputs["field"])
    field, background = load_field(inputs["field"])
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    views, level = scene.splits["train"], level_of(background)
    if context.device == "cuda":
        context.progress.say("the palette is learned on the CPU: its colors have no GPU kernel")

    def new_color(generator: np.random.Generator, pixel_cells: float, palette: np.ndarray) -> PaletteColor:
        finest = finest_cells(config.finest, pixel_cells)
        return PaletteColor.create(generator, palette, config.levels, finest, 1 << config.table_bits)

    try:
        problem = StyleProblem(
            field=field,
            cameras=[scene.cameras[i] for i in views],
            photos=BoundedCache(lambda at: photo_for(field, scene, views[at], level, threads), len, len(views), 0),
            background=level,
            settings=settings_of(config),
            seed=context.seed,
            threads=threads,
            memory=max(available_bytes(context.memory) - WORKING_BYTES, 0),
        )
        method = PaletteNerf.create(problem, weights_of(config), config.bases, new_color)
    except InvalidValue as error:
        raise BadInput(f"{inputs['field'].path}: {error}") from error
    trainer = StylizationTrainer(method)
    if resumed(trainer, partial, context):
        context.progress.say(f"resuming at step {trainer.state.step} of phase {trainer.state.phase}")
    with compiling_note(context.progress.say):
        train(trainer, "the decomposition", config, partial, context, {REFIT: "new colors", STYLE: "palette"}, begun)
        figures = method.figures()
    state, decomposed = trainer.state, trainer.scene.field
    save_field(partial.path, decomposed, background)
    color, totals = decomposed.color, {key: figures[key] for key in ("sparsity", "palette_variation")}
    if not isinstance(color, PaletteColor):
        raise TypeError(f"a decomposition has palette colors, not {color.kind}")
    save_palette(partial.path, color.palette, color.palette, figures["shares"], totals)
    return {
        **figures,
        "method": config.method,
        "steps": state.step,
        "train_seconds": round(state.seconds, 2),
        "curve_style": state.curve,
        "finest": color.finest,
        "parameters": decomposed.parameters,
        "views": len(views),
        **scene.exposure_figures,
    }


def settings_of(config: DecomposeConfig) -> StyleSettings:
    """The settings of the training; photos keep their colors."""
    return same_named(
        config, StyleSettings, refit_pixels=config.pixels, refit_rate=config.rate, final_rate=FINAL_RATE, match="none"
    )


def weights_of(config: DecomposeConfig) -> DecompositionWeights:
    """Weights of the parts of the loss."""
    names = ("sparsity", "offset", "view", "smooth", "guide", "drift")
    return DecompositionWeights(**{name: getattr(config, f"{name}_weight") for name in names})
