"""Decompose: a field of the same shapes whose colors are mixes of a palette, learned from the photos (PaletteNeRF)."""

import numpy as np
import torch

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import save_palette
from stages.artifacts.field import load_field, save_field
from stages.artifacts.photos import level_of, photo_for
from stages.artifacts.scene import load_scene
from stages.artifacts.validity import sound
from stages.configs.decompose import DecomposeConfig
from stages.configs.fit import budget_of
from stages.run.checkpoints import load_checkpoint
from stages.run.memory import available_bytes
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import run_training
from stages.stylization.settings import finest_cells
from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import PaletteColor
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.palettenerf import DecompositionWeights, PaletteNerfTrainer
from stylerf.training.stylize.settings import StyleSettings

SPEC = Spec(stage="decompose", verb="stylize", revision=3, writes="field")
FINAL_RATE = 0.1  # of the learning rate, at the end
WORKING_BYTES = 1e9  # what a step takes beside what is kept of the views


def run(inputs: dict[str, Artifact], config: DecomposeConfig, partial: PartialArtifact, context: Context) -> dict:
    """Writes the decomposed field and its palette; returns the figures."""
    scene = load_scene(inputs["scene"], inputs["field"])
    field, background = load_field(inputs["field"])
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    views, level = scene.splits["train"], level_of(background)
    cameras = [scene.cameras[i] for i in views]
    photos = BoundedCache(lambda place: photo_for(field, scene, views[place], level, threads), len, len(views), 0)
    if context.device == "cuda":
        context.progress.say("a palette is learned on the CPU: its colors have no GPU kernel")

    def new_color(generator: np.random.Generator, pixel_cells: float, palette: np.ndarray) -> PaletteColor:
        finest = finest_cells(config.finest, pixel_cells)
        return PaletteColor.create(generator, palette, config.levels, finest, 1 << config.table_bits)

    memory = max(available_bytes(context.memory) - WORKING_BYTES, 0)
    try:
        settled = settings_of(config), weights_of(config), config.bases, context.seed, threads, new_color, memory
        learner = PaletteNerfTrainer(field, cameras, photos, level, *settled)
    except InvalidValue as error:
        raise BadInput(f"{inputs['field'].path}: {error}") from error
    if (saved := load_checkpoint(partial.checkpoint, context.progress.say)) is not None:
        with sound(partial.checkpoint, "a sound checkpoint"):
            learner.resume(*saved)
        context.progress.say(f"going on from step {learner.state.step} of phase {learner.state.phase}")
    with compiling_note(context.progress.say):
        _train(learner, config, partial, context)
        figures = learner.figures()
    save_field(partial.path, learner.field, background)
    color, told = learner.field.color, {key: figures[key] for key in ("sparsity", "palette_variation")}
    save_palette(partial.path, color.palette, color.palette, figures["shares"], told)
    return {
        **figures,
        "method": config.method,
        "steps": learner.state.step,
        "train_seconds": round(learner.state.seconds, 2),
        "curve_style": learner.state.curve,
        "finest": color.finest,
        "parameters": learner.field.parameters,
        "views": len(cameras),
        **scene.exposure_figures,
    }


def settings_of(config: DecomposeConfig) -> StyleSettings:
    """What the config asks for, in the terms of all methods; photos keep their colors."""
    seconds, steps = budget_of(config.budget)
    return StyleSettings(
        steps=steps,
        seconds=seconds or 1.0,
        refit_steps=config.refit_steps,
        refit_pixels=config.pixels,
        refit_rate=config.rate,
        rate=config.rate,
        final_rate=FINAL_RATE,
        match="none",
    )


def weights_of(config: DecomposeConfig) -> DecompositionWeights:
    """Weights of the parts of the loss."""
    return DecompositionWeights(
        config.sparsity_weight,
        config.offset_weight,
        config.view_weight,
        config.smooth_weight,
        config.guide_weight,
        config.drift_weight,
    )


def _train(learner: PaletteNerfTrainer, config: DecomposeConfig, partial: PartialArtifact, context: Context) -> None:
    shown = ""
    seconds, steps = budget_of(config.budget)

    def tell(now: PaletteNerfTrainer) -> None:
        nonlocal shown
        state, counted = now.state, now.state.phase == "refit" or steps
        if state.phase != shown:
            shown = state.phase
            total = config.refit_steps if shown == "refit" else steps or seconds
            words = {"refit": "new colors", "style": "palette"}[shown]
            context.progress.start(words, total, "step" if counted else "s")
        note = f"squared error {state.curve[-1]['mse']:.4f}" if state.curve else ""
        context.progress.update(state.step if counted else min(state.seconds, now.settings.seconds), note)

    run_training(learner, "the decomposition", config.checkpoint_every_seconds, partial, context, tell)
