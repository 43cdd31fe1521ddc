"""Learn the look of a region: a palette and how it mixes, from photos and a style image (LAENeRF, 3.4)."""

import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from schemas.errors import BadInput
from schemas.images import to_uint8, write_png
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import Edit, load_edit_views, save_edit
from stages.artifacts.style_images import read_style_image
from stages.configs.edit import EditConfig
from stages.configs.fit import budget_of
from stages.run.devices import gpu_figures, gpu_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import resumed, run_training
from stages.weights.resolve import digests_of_files, resolve
from stylerf.editing.extraction import EditView
from stylerf.editing.palette_losses import EditWeights
from stylerf.errors import InvalidValue
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.style.color_matching import match_colors
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.transparency import shown_colors
from stylerf.training.backends import edit_engine
from stylerf.training.edit.trainer import EditSettings, EditTrainer, sampled_colors, start_module

SPEC = Spec(stage="edit_learn", verb="stylize", revision=7, writes="edit", outside=digests_of_files)


def run(inputs: dict[str, Artifact], config: EditConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the palette module, its palette and a preview; return the figures."""
    views, _ = load_edit_views(inputs["edit-dataset"])
    shown = max(views, key=len)
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    style_image, extractor, features, device = None, None, None, gpu_of(context)
    if config.style:
        resolved = resolve(config.features or None)
        context.progress.say(f"features: {resolved.name}, from {resolved.source}")
        style_image = read_style_image(Path(config.style), config.keep_frame, context.progress.say, config.crop)
        extractor = FeatureExtractor(resolved.state, config.layers, resolved.kind).to(device or "cpu")
        features = resolved.manifest()
        if config.match and not config.keep_colors:
            views = in_style_colors(views, style_image, context.seed)
    try:
        settings = settings_of(config)
        module = start_module(views, settings, context.seed)
        more = context.seed, threads, edit_engine(device)
        trainer = EditTrainer(views, module, settings, style_image, extractor, *more)
    except InvalidValue as error:
        raise BadInput(f"{inputs['edit-dataset'].path}: {error}") from error
    if resumed(trainer, partial, context):
        context.progress.say(f"resuming at step {trainer.state.step} of phase {trainer.state.phase}")
    with nullcontext() if device else compiling_note(context.progress.say):
        _train(trainer, shown, config, partial, context)
    figures = trainer.figures()
    totals = {"sparsity": figures["sparsity"], "palette_variation": figures["palette_variation"]}
    save_edit(partial.path, Edit(trainer.module, PaletteEdits()), figures["shares"], totals)
    write_png(partial.path / "preview.png", drawn(trainer, shown, threads))
    if style_image is not None:
        write_png(partial.path / "style.png", to_uint8(style_image.permute(1, 2, 0).numpy()))
    return {
        **figures,
        "features": features,
        "views": len(views),
        "curve_edit": trainer.state.curve,
        **gpu_figures(device),
    }


def settings_of(config: EditConfig) -> EditSettings:
    """The trainer's settings."""
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
        stroke=config.stroke,
        keep_colors=config.keep_colors,
        **({} if config.pruned_steps < 0 else pruned),
    )


def in_style_colors(views: list[EditView], style_image: torch.Tensor, seed: int) -> list[EditView]:
    """The views with the style image's mean color and covariance, except where the edit fades out.

    A palette that starts with the region's colors moves only as far as the Gram matrices pull it, and these are nearly
    blind to hue: a yellow shovel got yellow strokes.
    """
    colors = sampled_colors(views, np.random.default_rng([seed, 6]))
    matching = match_colors(torch.from_numpy(colors), shown_colors(style_image).flatten(1).T)
    matched = []
    for view in views:
        new = matching(torch.from_numpy(view.target)).clamp(0, 1).numpy().astype(np.float32)
        own = view.transition[:, None]
        matched.append(replace(view, target=own * view.target + (1 - own) * new))
    return matched


def drawn(trainer: EditTrainer, view: EditView, threads: int) -> np.ndarray:
    """The region in one view, in the photo and as the current module shows it, on gray, [h, 2 w, 3] uint8."""
    found = trainer.evaluator.colors(view.x, view.directions, threads=threads)
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

    def report(now: EditTrainer) -> None:
        nonlocal drawn_at
        last = now.state.curve[-1] if now.state.curve else {}
        note = f"squared error {last['reconstruction']:.4f}" if "reconstruction" in last else now.state.phase
        context.progress.update(round(100 * now.whole_progress, 1), note)
        if config.preview_every and time.monotonic() - drawn_at > config.preview_every:
            target = partial.path.parent / "preview-now.png"
            write_png(target, drawn(now, shown, now.threads))
            context.progress.say(f"preview: {target}")
            drawn_at = time.monotonic()

    run_training(trainer, "the edit", config.checkpoint_every_seconds, partial, context, report)
