"""Stylize, a region: a palette and where its colors go, by the photos and a painting (LAENeRF, 3.4)."""

import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from schemas.errors import BadInput
from schemas.images import to_uint8, write_png
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import Edit, save_edit
from stages.artifacts.edit_views import load_edit_views
from stages.artifacts.style_images import read_painting
from stages.artifacts.validity import sound
from stages.configs.edit import EditConfig
from stages.configs.fit import budget_of
from stages.run.checkpoints import load_checkpoint
from stages.run.devices import gpu_figures, gpu_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import run_training
from stages.weights.resolve import digests_of_files, resolve
from stylerf.editing.edit_views import EditView
from stylerf.editing.palette_losses import EditWeights
from stylerf.editing.region_style import crop_of
from stylerf.errors import InvalidValue
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.style.color_matching import match_colors
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.training.backends import edit_engine
from stylerf.training.edit.trainer import EditSettings, EditTrainer, sampled_colors, start_module

SPEC = Spec(stage="edit_learn", verb="stylize", revision=4, writes="edit", outside=digests_of_files)


def run(inputs: dict[str, Artifact], config: EditConfig, partial: PartialArtifact, context: Context) -> dict:
    """Writes the palette module, its palette and a preview; returns the figures."""
    views, _ = load_edit_views(inputs["edit-dataset"])
    shown = max(views, key=len)
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    painting, trunk, features, device = None, None, None, gpu_of(context)
    if config.style:
        resolved = resolve(config.features or None)
        context.progress.say(f"features: {resolved.name}, from {resolved.source}")
        painting, trunk = (
            cropped(config),
            FeatureExtractor(resolved.state, config.layers, resolved.kind).to(device or "cpu"),
        )
        features = resolved.manifest()
        if config.match and not config.preserve_color:
            views = in_colors_of_painting(views, painting, context.seed)
    try:
        settings = settings_of(config)
        module = start_module(views, settings, context.seed)
        trainer = EditTrainer(views, module, settings, painting, trunk, context.seed, threads, edit_engine(device))
    except InvalidValue as error:
        raise BadInput(f"{inputs['edit-dataset'].path}: {error}") from error
    if (saved := load_checkpoint(partial.checkpoint, context.progress.say)) is not None:
        with sound(partial.checkpoint, "a sound checkpoint"):
            trainer.resume(*saved)
        context.progress.say(f"going on from step {trainer.state.step} of phase {trainer.state.phase}")
    with nullcontext() if device else compiling_note(context.progress.say):
        _train(trainer, shown, config, partial, context)
    figures = trainer.figures()
    told = {"sparsity": figures["sparsity"], "palette_variation": figures["palette_variation"]}
    save_edit(partial.path, Edit(trainer.module, PaletteEdits()), figures["shares"], told)
    write_png(partial.path / "preview.png", drawn(trainer, shown, threads))
    if painting is not None:
        write_png(partial.path / "style.png", to_uint8(painting.permute(1, 2, 0).numpy()))
    told = {"features": features, "views": len(views), "curve_edit": trainer.state.curve}
    return {**figures, **told, **gpu_figures(device)}


def settings_of(config: EditConfig) -> EditSettings:
    """What the config asks for, in the trainer's terms."""
    pruned = dict.fromkeys(("pruned_steps", "pruned_style_steps"), config.pruned_steps)
    return EditSettings(
        colors=config.colors,
        palette=config.start,
        max_colors=config.max_colors,
        palette_steps=config.palette_steps,
        style_steps=config.style_steps,
        seconds=budget_of(config.budget)[0],
        weights=EditWeights(
            certainty=config.certainty_weight,
            offset=config.offset_weight,
            style=config.style_weight,
            variation=config.variation_weight,
            edges=config.edge_weight,
            smooth=config.smooth_weight,
        ),
        style_side=config.style_side,
        preserve_color=config.preserve_color,
        **({} if config.pruned_steps < 0 else pruned),
    )


def in_colors_of_painting(views: list[EditView], painting: torch.Tensor, seed: int) -> list[EditView]:
    """The views with the painting's mean color and covariance where the edit does not fade into its surroundings.

    A palette that begins with the region's colors moves to the painting's only as far as its Gram matrices pull it,
    which are nearly blind to hue: a yellow shovel came out in yellow strokes.
    """
    colors = sampled_colors(views, np.random.default_rng([seed, 6]))
    matching = match_colors(torch.from_numpy(colors), painting.flatten(1).T)
    matched = []
    for view in views:
        new = matching(torch.from_numpy(view.target)).clamp(0, 1).numpy().astype(np.float32)
        own = view.transition[:, None]
        matched.append(replace(view, target=own * view.target + (1 - own) * new))
    return matched


def cropped(config: EditConfig) -> torch.Tensor:
    """The painting, or the part of it that is asked for, [3, h, w] sRGB 0..1; transparency counts as white."""
    painting = read_painting(Path(config.style))
    try:
        return crop_of(painting, *config.crop) if config.crop else painting
    except InvalidValue as error:
        raise BadInput(f"{config.style}: {error}") from error


def drawn(trainer: EditTrainer, view: EditView, threads: int) -> np.ndarray:
    """[h, 2 w, 3] uint8: the region in one view as the photo has it, and as the module paints it now; gray around."""
    found = trainer.evaluator.colors(view.x, view.directions, chunks=threads)
    pictures = []
    for colors in (view.target, found):
        picture = np.full((view.height * view.width, 3), 0.5, np.float32)
        picture[view.pixels] = colors
        pictures.append(picture.reshape(view.height, view.width, 3))
    return to_uint8(np.concatenate(pictures, 1))


def _train(
    trainer: EditTrainer, shown: EditView, config: EditConfig, partial: PartialArtifact, context: Context
) -> None:
    drawn_at = time.monotonic()
    context.progress.start("edit", 100.0, "%")

    def tell(now: EditTrainer) -> None:
        nonlocal drawn_at
        last = now.state.curve[-1] if now.state.curve else {}
        note = f"squared error {last['reconstruction']:.4f}" if "reconstruction" in last else now.state.phase
        context.progress.update(round(100 * now.whole_progress, 1), note)
        if config.preview_every and time.monotonic() - drawn_at > config.preview_every:
            target = partial.path.parent / "preview-now.png"
            write_png(target, drawn(now, shown, now.threads))
            context.progress.say(f"preview: {target}")
            drawn_at = time.monotonic()

    run_training(trainer, "the edit", config.checkpoint_every_seconds, partial, context, tell)
