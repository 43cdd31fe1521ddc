"""Stylize: a field with the same density, in the colors and strokes of a style image."""

import time
from pathlib import Path

import numpy as np
import torch

from schemas.errors import BadInput, TrainedFurther
from schemas.images import to_uint8, write_png
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.field import load_deformation, load_field, save_deformation, save_field
from stages.artifacts.photos import level_of, photo_for
from stages.artifacts.region import region_of_field
from stages.artifacts.scene import SceneData, load_scene
from stages.artifacts.style_images import (
    at_size_of,
    chosen_view,
    decoded_reference,
    digest_of,
    read_colors,
    read_references,
    read_style_image,
)
from stages.configs.stylize import ArfConfig, DesrfConfig, RefNprConfig, SnerfConfig, StylizeConfig
from stages.configs.view_syntax import file_of
from stages.run.devices import gpu_figures, gpu_of, rays_on
from stages.run.memory import available_bytes, in_words
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import resumed
from stages.stylization.margins import margin_cameras
from stages.stylization.settings import (
    coarse_layers,
    image_layers,
    new_color,
    reference_layers,
    region_color,
    settings_of,
    train,
)
from stages.stylization.view_sizes import resized_cameras
from stages.weights.resolve import ResolvedExtractor, digests_of_files, resolve
from stylerf.editing.edit_grid import Region
from stylerf.errors import InvalidValue
from stylerf.fields.deformation import FARTHEST, Deformation
from stylerf.fields.hash_grid import HashColor
from stylerf.fields.protocol import ColorPart
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.rendering.view import render_view
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.training.backends import style_backend
from stylerf.training.common.bounded_cache import BoundedCache
from stylerf.training.stylize.arf import Arf
from stylerf.training.stylize.refnpr import RefNpr
from stylerf.training.stylize.scene import StyledScene, StyleProblem
from stylerf.training.stylize.settings import REFIT
from stylerf.training.stylize.snerf import Snerf
from stylerf.training.stylize.trainer import StyleMethod, StylizationTrainer


def _outside(config: StylizeConfig) -> dict[str, str]:
    references = {"references_digest": digest_of(config.references)} if config.references else {}
    return digests_of_files(config) | references


SPEC = Spec(stage="stylize", verb="stylize", revision=27, writes="field", outside=_outside)
WORKING_BYTES = 1.5e9  # what a step needs besides the views: full-size images, the extractor's graph
BYTES_PER_PIXEL = 60  # about, of a cached view: its photo, samples on its surfaces, features at half its size


def run(inputs: dict[str, Artifact], config: StylizeConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the stylized field; return its figures, including the loss curve."""
    begun = time.monotonic()
    scene = load_scene(inputs["scene"], inputs["field"])
    field, background = load_field(inputs["field"])
    region = region_of_field(inputs["region"], inputs["field"], field) if "region" in inputs else None
    deformation = load_deformation(inputs["field"]) if config.method == "desrf" else None
    if config.method == "desrf" and deformation is None:
        raise BadInput(f"{inputs['field'].path} has no deformation to train; run `stylerf deform` on it first")
    if isinstance(config, DesrfConfig) and deformation is not None:
        deformation.reach = FARTHEST * config.bend
    threads = set_threads(context.threads)
    torch.set_num_threads(threads)
    resolved = resolve(config.features or None)
    context.progress.say(f"features: {resolved.name}, from {resolved.source}")
    style_image = _style_image(config, context)
    device = gpu_of(context)
    try:
        level = level_of(background)
        problem = _problem(config, scene, field, level, style_image, deformation, region, context, device)
        method = _method(config, problem, scene, region, resolved, context, device)
    except InvalidValue as error:
        name = config.style or config.references[0]
        raise BadInput(f"{name} on {inputs['field'].path}: {error}") from error
    trainer = StylizationTrainer(method, config.until)
    if resumed(trainer, partial, context):
        if trainer.passed:
            raise TrainedFurther(
                f"the interrupted run has taken {trainer.state.step} style steps, more than --until {config.until}; "
                f"give --until {trainer.state.step} to end it there, or --force to start over"
            )
        context.progress.say(f"resuming at step {trainer.state.step} of phase {trainer.state.phase}")
    try:
        with compiling_note(context.progress.say):
            train(trainer, "the stylization", config, partial, context, {REFIT: "new colors"}, begun)
    except InvalidValue as error:
        raise BadInput(f"{inputs['field'].path}: {error}") from error
    stylized, state = trainer.scene.field, trainer.state
    save_field(partial.path, stylized, background)
    if deformation is not None:
        save_deformation(partial.path, deformation)
    # The style image stays with the result, for later evaluation.
    write_png(partial.path / "style.png", to_uint8(style_image.permute(1, 2, 0).numpy()))
    return {
        "method": config.method,
        "steps": state.step,
        "train_seconds": round(state.seconds, 2),
        "curve_style": state.curve,
        "finest": _finest(stylized.color),
        "parameters": stylized.parameters,
        "features": resolved.manifest(),
        "views": len(scene.splits["train"]),
        "rollbacks": state.counts.get("rollbacks", 0),
        **_figures_of_method(method, config, scene, partial),
        **gpu_figures(device),
        **scene.exposure_figures,
    }


def _style_image(config: StylizeConfig, context: Context) -> torch.Tensor:
    """Return the style image [3 or 4, h, w], or in its place the first reference [3, h, w]."""
    if config.style:
        return read_style_image(Path(config.style), config.keep_frame, context.progress.say)
    return torch.from_numpy(read_colors(file_of(config.references[0])[1])).permute(2, 0, 1).contiguous()


def _finest(color: ColorPart) -> int | None:
    """Return the cells per side of the finest level of the trained colors."""
    own = color.own if isinstance(color, RegionColor) else color
    return own.finest if isinstance(own, HashColor) else None


def _problem(
    config: StylizeConfig,
    scene: SceneData,
    field: RadianceField,
    level: float,
    style_image: torch.Tensor,
    deformation: Deformation | None,
    region: Region | None,
    context: Context,
    device: str | None,
) -> StyleProblem:
    """Return what every method receives. level: gray of the background."""
    views, threads = scene.splits["train"], torch.get_num_threads()
    photographed = [scene.cameras[i] for i in views]
    cameras = resized_cameras(photographed, config, device)
    long_side = max(max(camera.width, camera.height) for camera in cameras)
    if cameras != photographed:
        context.progress.say(f"learning from views of up to {long_side} pixels a side; --max-side sets another limit")
    if field.opaque_background and region is None and isinstance(config, ArfConfig) and config.margin > 0:
        cameras += margin_cameras(cameras, config.margin)

    def photo(place: int) -> np.ndarray:
        camera = cameras[place]
        if place >= len(views):
            return render_view(field, camera, threads=threads).rgb
        full = photo_for(field, scene, views[place], level, threads)
        return at_size_of(camera, torch.from_numpy(full).permute(2, 0, 1))

    return StyleProblem(
        field=field,
        cameras=cameras,
        photos=BoundedCache(photo, len, len(cameras), 0),
        background=level,
        settings=settings_of(config, long_side, field.opaque_background, region is not None, style_image),
        seed=context.seed,
        threads=threads,
        style_image=style_image,
        deformation=deformation,
        region=None if region is None else region.edit,
        memory=_memory_for_views(cameras, context),
        backend=style_backend(rays_on(device, field, context, deformation is not None)),
    )


def _method(
    config: StylizeConfig,
    problem: StyleProblem,
    scene: SceneData,
    region: Region | None,
    resolved: ResolvedExtractor,
    context: Context,
    device: str | None,
) -> StyleMethod:
    """Return the method before its first step."""

    def extractor(layers: str) -> FeatureExtractor:
        return FeatureExtractor(resolved.state, layers, resolved.kind).to(device or "cpu")

    def color(generator: np.random.Generator, styled: StyledScene) -> ColorPart:
        if region is None:
            return new_color(config, generator, styled.pixel_cells())
        # In no cell around the region: nothing there has to be preserved.
        return region_color(config, problem.field.color, region.edit, styled.pixel_cells())

    own = extractor(image_layers(config, resolved.state))
    if isinstance(config, SnerfConfig):
        return Snerf(StyledScene(problem, color), own)
    if not isinstance(config, RefNprConfig):
        return Arf(StyledScene(problem, color), own)
    references = read_references(scene, config.reference, problem.cameras)
    if not references:
        threshold = problem.settings.weight_threshold
        view = chosen_view(scene, problem.field, problem.cameras, config, threshold, problem.threads, region)
        context.progress.say(f"making view {problem.cameras[view].name} the reference")
        references = {view: None}
        if config.reference_by == "adain" and problem.style_image is not None:
            photo = problem.photos[view]
            references[view] = decoded_reference(
                photo, problem.style_image, config.style_scale, config.stroke, device or "cpu"
            )
    matching = extractor(reference_layers(config, resolved.state))
    coarse = extractor(coarse_layers(resolved.state))
    return RefNpr(StyledScene(problem, color), own, references, matching, coarse)


def _figures_of_method(method: StyleMethod, config: StylizeConfig, scene: SceneData, partial: PartialArtifact) -> dict:
    """Return the figures that only this method has; its references are written next to the result."""
    if isinstance(config, SnerfConfig):
        return {"rounds": config.rounds, "pictures": method.scene.state.counts.get("pictures", 0)}
    if not isinstance(method, RefNpr) or not isinstance(config, RefNprConfig):
        return {}
    by, references = "file" if config.reference else config.reference_by or "features", []
    for place, image in method.references.items():
        if image is None:
            continue
        index = scene.splits["train"][place]
        file = f"reference-{index}.png"
        write_png(partial.path / file, to_uint8(image))
        references.append({"view": scene.views[index].name, "file": file, "by": by})
    return {"references": references, "registered": round(method.registered_share, 4)}


def _memory_for_views(cameras: list[Camera], context: Context) -> float:
    """Return the bytes for caching the views, with a note if they do not all fit."""
    left = max(available_bytes(context.memory) - WORKING_BYTES, 0)
    needed = BYTES_PER_PIXEL * sum(camera.width * camera.height for camera in cameras)
    if needed > left:
        context.progress.say(
            f"caching {len(cameras)} views takes about {in_words(needed)}, more than the {in_words(left)} of memory "
            "left: views that do not fit are recomputed each time"
        )
    return left
