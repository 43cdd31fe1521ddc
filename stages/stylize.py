"""Stylise: a field of the same shapes in the colours and strokes of a painting."""

import functools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from schemas.errors import BadInput
from schemas.images import to_uint8, write_png
from schemas.store import Artefact, Partial
from stages.configs.fit import budget_of
from stages.configs.stylize import COLOUR_CELLS, StylizeConfig
from stages.devices import gpu_figures, gpu_of
from stages.fields import (
    load_checkpoint,
    load_deformation,
    load_field,
    save_checkpoint,
    save_deformation,
    save_field,
)
from stages.memory import in_words, room
from stages.paintings import read_painting
from stages.photos import level_of, photo_over
from stages.progress import Context
from stages.runner import Spec
from stages.scenes import SceneData, load_scene
from stages.weights import resolve
from stylerf.errors import Diverged, InvalidValue
from stylerf.fields.hash import HashColour
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.style.objective import StyleWeights
from stylerf.style.trunks import Trunk
from stylerf.training.kept import Kept
from stylerf.training.style_settings import StyleSettings
from stylerf.training.stylize import Stylizer

SPEC = Spec(stage="stylize", verb="stylize", revision=3, writes="field")
WORKING_BYTES = 1.5e9  # what a step takes beside what is kept of the views: pictures at full size, the trunk's graph
KEPT_BYTES = 60  # about, for each pixel of a view: its photo, samples on its surfaces, features at half its size
SMALL_VIEW = 256  # pixels of its longer side
FINER = 1.25  # cells for each pixel's width
# What holds shapes in a capture holds the silhouettes of an object alone so fast that nothing is seen to bend; its
# shapes have nothing around them to tear (docs/decisions/0015).
BENT_OBJECT = {"colour_weight": 1.0, "displacement_weight": 0.0, "coarse": 0.6}
ELSE = {"colour_weight": 10.0, "displacement_weight": 0.003, "coarse": 0.0}
VARIATION = {"arf": ("squared", 1.0), "desrf": ("diagonal", 0.1)}  # DeSRF: 0.5 beside a style weight of 5


def run(inputs: dict[str, Artefact], config: StylizeConfig, partial: Partial, context: Context) -> dict:
    """Writes the stylised field; returns the figures, among them the curve of the loss."""
    scene = load_scene(inputs["scene"])
    field, background = load_field(inputs["field"])
    deformation = load_deformation(inputs["field"]) if config.method == "desrf" else None
    if config.method == "desrf" and deformation is None:
        raise BadInput(f"{inputs['field'].path} has no deformation to move; run `stylerf deform` on it first")
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    resolved = resolve(config.features or None)
    context.progress.say(f"features: {resolved.name}, from {resolved.source}")
    views = scene.splits["train"]
    painting = read_painting(Path(config.style))
    level = level_of(background)
    memory = _room_for(scene, views, context)
    device = gpu_of(context)
    if device and deformation is not None:
        context.progress.say("features and matching run on the GPU, rays through a moving field on the CPU")
    try:
        stylizer = Stylizer(
            field,
            [scene.cameras[i] for i in views],
            Kept(lambda place: photo_over(scene, views[place], level), len, len(views), 0),
            level,
            painting,
            Trunk(resolved.state, config.taps, resolved.kind).to(device or "cpu"),
            settings_of(config, max(max(c.width, c.height) for c in scene.cameras), field.closed),
            context.seed,
            threads,
            functools.partial(new_colour, config),
            deformation,
            memory,
            device,
        )
    except InvalidValue as error:
        raise BadInput(f"{config.style} on {inputs['field'].path}: {error}") from error
    if (saved := load_checkpoint(partial.checkpoint)) is not None:
        stylizer.resume(*saved)
        context.progress.say(f"going on from step {stylizer.state.step} of phase {stylizer.state.phase}")
    with compiling_note(context.progress.say):
        _train(stylizer, config, partial, context)
    save_field(partial.path, stylizer.field, background)
    if deformation is not None:
        save_deformation(partial.path, deformation)
    # The painting stays with what was made from it, for whoever evaluates it later.
    write_png(partial.path / "style.png", to_uint8(painting.permute(1, 2, 0).numpy()))
    state = stylizer.state
    return {
        "method": config.method,
        "steps": state.step,
        "train_seconds": round(state.seconds, 2),
        "curve_style": state.curve,
        "finest": stylizer.field.colour.finest,
        "parameters": stylizer.field.parameters,
        "features": resolved.manifest(),
        "views": len(views),
        **gpu_figures(device),
    }


def _room_for(scene: SceneData, views: list[int], context: Context) -> float:
    """Bytes for what is kept of the views; says where not all of it will be."""
    left = max(room(context.memory) - WORKING_BYTES, 0)
    needed = KEPT_BYTES * sum(scene.cameras[i].width * scene.cameras[i].height for i in views)
    if needed > left:
        context.progress.say(
            f"{len(views)} views take about {in_words(needed)} to keep, more than the {in_words(left)} of memory left "
            "for them: what does not fit is made anew whenever its view comes up"
        )
    return left


def _train(stylizer: Stylizer, config: StylizeConfig, partial: Partial, context: Context) -> None:
    saved_at, shown = time.monotonic(), ""

    def on_step(now: Stylizer) -> None:
        nonlocal saved_at, shown
        state = now.state
        if state.phase != shown:
            shown = state.phase
            seconds, steps = budget_of(config.budget)
            total = config.refit_steps if shown == "refit" else steps or seconds
            context.progress.start(
                "new colours" if shown == "refit" else "style", total, "step" if shown == "refit" or steps else "s"
            )
        counted = state.phase == "refit" or now.settings.steps
        note = ""
        if state.curve:
            last = state.curve[-1]
            note = f"style distance {last['style']:.3f}" if "style" in last else f"squared error {last['mse']:.4f}"
        context.progress.update(state.step if counted else min(state.seconds, now.settings.seconds), note)
        if time.monotonic() - saved_at > config.checkpoint_every_seconds:
            save_checkpoint(partial.checkpoint, *now.checkpoint())
            saved_at = time.monotonic()

    try:
        stylizer.run(on_step)
    except KeyboardInterrupt:
        if stylizer.between_steps:
            save_checkpoint(partial.checkpoint, *stylizer.checkpoint())
        raise
    except Diverged as error:
        raise BadInput(f"the stylisation does not converge: {error}") from error
    finally:
        context.progress.finish()


def new_colour(config: StylizeConfig, generator: np.random.Generator, pixel_cells: float) -> HashColour:
    """The colour field to learn. pixel_cells: cells a side as wide as what a pixel sees, nan if nothing is seen.

    Finer ones are taught by single views, each its own cell, and what they learn shows as grain from between them.
    """
    least, most = COLOUR_CELLS
    finest = config.finest
    if not finest:
        finest = int(np.clip(round(FINER * pixel_cells / 16) * 16, least, most)) if np.isfinite(pixel_cells) else least
    return HashColour.create(generator, levels=config.levels, finest=finest, table=1 << config.table_bits)


def rays_of(config: StylizeConfig, long_side: int) -> str:
    """Shapes held fast cost little to paint, and so do small views; walked anew, a large one costs more than the trunk.

    Dilated rays leave grain in small views, where a cell of the colour is hardly wider than the gaps: decision 0013.
    """
    if config.rays != "auto":
        return config.rays
    return "dilated" if config.method == "desrf" and long_side > SMALL_VIEW else "deferred"


def settings_of(config: StylizeConfig, long_side: int, closed: bool) -> StyleSettings:
    """closed: whether the field is a capture, rather than an object alone."""
    own = BENT_OBJECT if config.method == "desrf" and not closed else ELSE
    config = replace(config, **{name: value for name, value in own.items() if getattr(config, name) == -1})
    seconds, steps = budget_of(config.budget)
    variation, variation_weight = VARIATION[config.method]
    if config.variation_weight >= 0:
        variation_weight = config.variation_weight
    return StyleSettings(
        steps=steps,
        seconds=seconds or 1.0,
        refit_steps=config.refit_steps,
        rate=config.rate,
        deform_rate=config.deform_rate,
        displacement_weight=config.displacement_weight,
        displacement_vertices=config.displacement_vertices,
        variation=variation,
        strategy=rays_of(config, long_side),
        dilation=config.dilation,
        blur=config.blur,
        remember=config.remember,
        match=config.match,
        weights=StyleWeights(config.style_weight, config.content_weight, variation_weight, config.colour_weight),
        coarse=config.coarse,
        feature_scale=config.feature_scale or min(1.0, max(0.5, 256 / long_side)),
        style_scale=config.style_scale,
        style_rows=config.style_rows,
        style_basis=config.style_basis,
    )
