"""Deform init: a fitted field with a deformation that starts at zero and is trained on the photos."""

import numpy as np
import torch

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.field import load_field, save_deformation, save_field
from stages.artifacts.photos import bank_of, level_of
from stages.artifacts.scene import load_scene, spread
from stages.configs.deform import DeformConfig
from stages.run.devices import gpu_figures, gpu_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import resumed, run_training
from stylerf.errors import InvalidValue
from stylerf.fields.deformation import Deformation
from stylerf.fields.radiance_field import RadianceField
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.training.backends import deform_backend
from stylerf.training.deform.fitter import DeformationFitter, DeformSettings

SPEC = Spec(stage="deform_init", verb="deform", revision=5, writes="field")


def run(inputs: dict[str, Artifact], config: DeformConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the field with its displacement grid, and the network behind it; return the figures."""
    scene = load_scene(inputs["scene"], inputs["field"])
    field, background = load_field(inputs["field"])
    if field.displacement is not None:
        raise BadInput(f"{inputs['field'].path} is already deformed; give the field it was made from")
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    generator = np.random.default_rng([context.seed, 8])
    deformation = Deformation.create(generator, config.frequencies, config.width)
    settings = DeformSettings(
        steps=config.steps,
        rays=config.rays,
        rate=config.rate,
        smoothness=config.smoothness,
        vertices=config.vertices,
        background=level_of(background),
        patience=config.patience_db,
        gate=config.gate,
    )
    train = scene.splits["train"]
    aside = held_out(train) if config.gate > 0 else []
    bank = bank_of(scene, [i for i in train if i not in aside] + aside, partial.folder, context)
    device = gpu_of(context, field, moving=True)
    with compiling_note(context.progress.say):
        try:
            more = context.seed, threads, len(aside), deform_backend(device)
            fitter = DeformationFitter(field, deformation, bank, settings, *more)
        except InvalidValue as error:
            raise BadInput(f"{inputs['field'].path}: {error}") from error
        if resumed(fitter, partial, context):
            context.progress.say(f"resuming at step {fitter.state.step}")
        _train(fitter, config, partial, context)
    if fitter.dropped:
        gained = fitter.state.best - fitter.state.before
        judges = "held-out views gain" if aside else "the only training view gains"
        context.progress.say(f"the deformation is discarded: {judges} {gained:.2f} dB, less than {config.gate:g}")
    save_field(partial.path, field, background)
    save_deformation(partial.path, deformation)
    state = fitter.state
    return {
        "steps": state.step,
        "train_seconds": round(state.seconds, 2),
        "curve": state.curve,
        "psnr_before": round(state.before, 3),
        "psnr_after": round(state.before if fitter.dropped else state.best, 3),
        "dropped": fitter.dropped,
        "displacement_rms": _rms(field),
        "parameters": field.parameters + len(deformation.values),
        **gpu_figures(device),
        **scene.exposure_figures,
    }


def _rms(field: RadianceField) -> float:
    """Root mean square of the displacement, in cubes two units wide."""
    if field.displacement is None:
        return 0.0
    return float(np.sqrt(np.square(2 * field.displacement).sum(-1).mean()))


def _train(fitter: DeformationFitter, config: DeformConfig, partial: PartialArtifact, context: Context) -> None:
    context.progress.start("deform", config.steps, "step")

    def report(now: DeformationFitter) -> None:
        if now.state.step % 10 == 0:
            context.progress.update(now.state.step, f"{now.state.best:.2f} dB on the photos")

    run_training(fitter, "the deformation", config.checkpoint_every_seconds, partial, context, report)


def held_out(train: list[int]) -> list[int]:
    """Return the training views that the gate judges by; none of a single view, which then serves both purposes."""
    return spread(train, min(4, max(1, len(train) // 10))) if len(train) > 1 else []
