"""Stylize: a field of the same shapes in the colors and strokes of a painting."""

import functools
from pathlib import Path

import torch

from schemas.errors import BadInput
from schemas.images import to_uint8, write_png
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.field import load_deformation, load_field, save_deformation, save_field
from stages.artifacts.photos import level_of, photo_for
from stages.artifacts.references import chosen_view, decoded_reference, digest_of, read_references
from stages.artifacts.region import region_of_field
from stages.artifacts.scene import SceneData, load_scene
from stages.artifacts.style_images import read_painting
from stages.artifacts.validity import sound
from stages.configs.fit import budget_of
from stages.configs.stylize import StylizeConfig
from stages.configs.views import file_of
from stages.run.checkpoints import load_checkpoint
from stages.run.devices import gpu_figures, gpu_of, rays_on
from stages.run.memory import available_bytes, in_words
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import run_training
from stages.stylization.settings import coarse_taps, new_color, own_color, painting_taps, settings_of, template_taps
from stages.weights.resolve import ResolvedExtractor, digests_of_files, resolve
from stylerf.editing.edit_grid import Region
from stylerf.errors import InvalidValue
from stylerf.fields.deformation import Deformation
from stylerf.fields.hash_color import HashColor
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.arf import ArfTrainer
from stylerf.training.stylize.refnpr import RefNprTrainer
from stylerf.training.stylize.snerf import SnerfTrainer
from stylerf.training.stylize.trainer import StylizationTrainer


def _outside(config: StylizeConfig) -> dict[str, str]:
    return digests_of_files(config) | ({"references_digest": digest_of(config.reference)} if config.reference else {})


SPEC = Spec(stage="stylize", verb="stylize", revision=8, writes="field", outside=_outside)
WORKING_BYTES = 1.5e9  # what a step takes beside what is kept of the views: pictures at full size, the trunk's graph
KEPT_BYTES = 60  # about, for each pixel of a view: its photo, samples on its surfaces, features at half its size
WORDS = {"refit": "new colors"}  # of phases that are not told by their own name


def run(inputs: dict[str, Artifact], config: StylizeConfig, partial: PartialArtifact, context: Context) -> dict:
    """Writes the stylized field; returns the figures, among them the curve of the loss."""
    scene = load_scene(inputs["scene"], inputs["field"])
    field, background = load_field(inputs["field"])
    region = region_of_field(inputs["region"], inputs["field"], field) if "region" in inputs else None
    deformation = load_deformation(inputs["field"]) if config.method == "desrf" else None
    if config.method == "desrf" and deformation is None:
        raise BadInput(f"{inputs['field'].path} has no deformation to move; run `stylerf deform` on it first")
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    resolved = resolve(config.features or None)
    context.progress.say(f"features: {resolved.name}, from {resolved.source}")
    painting = read_painting(Path(config.style or file_of(config.reference[0])[1]))
    device = gpu_of(context)
    try:
        given = scene, field, level_of(background), painting, resolved, deformation, region
        stylizer = _stylizer(config, *given, context, device)
    except InvalidValue as error:
        raise BadInput(f"{config.style or config.reference[0]} on {inputs['field'].path}: {error}") from error
    if (saved := load_checkpoint(partial.checkpoint, context.progress.say)) is not None:
        with sound(partial.checkpoint, "a sound checkpoint"):
            stylizer.resume(*saved)
        context.progress.say(f"going on from step {stylizer.state.step} of phase {stylizer.state.phase}")
    try:
        with compiling_note(context.progress.say):
            _train(stylizer, config, partial, context)
    except InvalidValue as error:
        raise BadInput(f"{inputs['field'].path}: {error}") from error
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
        "finest": _learned(stylizer.field).finest,
        "parameters": stylizer.field.parameters,
        "features": resolved.manifest(),
        "views": len(stylizer.cameras),
        "rollbacks": state.counts.get("rollbacks", 0),
        **_figures_of_method(stylizer, config, scene, partial),
        **gpu_figures(device),
        **scene.exposure_figures,
    }


def _learned(field: RadianceField) -> HashColor:
    """The colors that were taught."""
    return field.color.own if isinstance(field.color, RegionColor) else field.color


def _stylizer(
    config: StylizeConfig,
    scene: SceneData,
    field: RadianceField,
    level: float,
    painting: torch.Tensor,
    resolved: ResolvedExtractor,
    deformation: Deformation | None,
    region: Region | None,
    context: Context,
    device: str | None,
) -> StylizationTrainer:
    """What `config.method` stylizes with, before its first step."""
    views, moving = scene.splits["train"], deformation is not None

    def trunk(taps: str) -> FeatureExtractor:
        return FeatureExtractor(resolved.state, taps, resolved.kind).to(device or "cpu")

    cameras = [scene.cameras[i] for i in views]
    threads = torch.get_num_threads()
    photos = BoundedCache(lambda place: photo_for(field, scene, views[place], level, threads), len, len(views), 0)
    long_side = max(max(c.width, c.height) for c in scene.cameras)
    settings = settings_of(config, long_side, field.closed, region is not None)
    color = functools.partial(new_color, config)
    if region is not None:
        # In no cell around it: nothing there is asked to stay as it is.
        color = functools.partial(own_color, config, field.color, region.edit)
    given = (
        field,
        cameras,
        photos,
        level,
        painting,
        trunk(painting_taps(config, resolved.state)),
        settings,
        context.seed,
        threads,
        color,
    )
    more = {"memory": _room_for(scene, views, context), "device": rays_on(device, field, context, moving)}
    more["within"] = None if region is None else region.edit
    if config.method == "snerf":
        return SnerfTrainer(*given, **more)
    if config.method == "refnpr":
        references = read_references(scene, config.reference)
        if not references:
            view = chosen_view(scene, field, cameras, config, settings.share, threads, region)
            context.progress.say(f"view {cameras[view].name} is made the reference")
            references = {view: None}
            if config.reference_by == "adain":
                references[view] = decoded_reference(photos[view], painting, config.style_scale, device or "cpu")
        more |= {
            "references": references,
            "template_trunk": trunk(template_taps(config, resolved.state)),
            "coarse_trunk": trunk(coarse_taps(resolved.state)),
        }
        return RefNprTrainer(*given, **more)
    return ArfTrainer(*given, deformation, **more)


def _figures_of_method(
    stylizer: StylizationTrainer, config: StylizeConfig, scene: SceneData, partial: PartialArtifact
) -> dict:
    """What a method tells beside what all tell; references are kept with what was made after them."""
    if isinstance(stylizer, SnerfTrainer):
        return {"rounds": config.rounds, "pictures": stylizer.state.counts.get("pictures", 0)}
    if not isinstance(stylizer, RefNprTrainer):
        return {}
    told = []
    for place, picture in stylizer.references.items():
        index = scene.splits["train"][place]
        file = f"reference-{index}.png"
        write_png(partial.path / file, to_uint8(picture))
        told.append({"view": scene.views[index].name, "file": file, "by": config.reference_by or "nnfm"})
        if config.reference:
            told[-1]["by"] = "file"
    return {"references": told, "registered": round(stylizer.registered_share, 4)}


def _room_for(scene: SceneData, views: list[int], context: Context) -> float:
    """Bytes for what is kept of the views; says where not all of it will be."""
    left = max(available_bytes(context.memory) - WORKING_BYTES, 0)
    needed = KEPT_BYTES * sum(scene.cameras[i].width * scene.cameras[i].height for i in views)
    if needed > left:
        context.progress.say(
            f"{len(views)} views take about {in_words(needed)} to keep, more than the {in_words(left)} of memory left "
            "for them: what does not fit is made anew whenever its view comes up"
        )
    return left


def _train(stylizer: StylizationTrainer, config: StylizeConfig, partial: PartialArtifact, context: Context) -> None:
    shown = ""

    def tell(now: StylizationTrainer) -> None:
        nonlocal shown
        state = now.state
        if state.phase != shown:
            shown = state.phase
            seconds, _ = budget_of(config.budget)
            total = now.steps_of_phase
            context.progress.start(WORDS.get(shown, shown), total or seconds, "step" if total else "s")
        note = ""
        if state.curve:
            last = state.curve[-1]
            note = f"style distance {last['style']:.3f}" if "style" in last else f"squared error {last['mse']:.4f}"
        context.progress.update(state.step if now.steps_of_phase else min(state.seconds, now.settings.seconds), note)

    run_training(stylizer, "the stylization", config.checkpoint_every_seconds, partial, context, tell)
