"""Fine-tune: the field learns the edited photos (LAENeRF, section 3.5)."""

from collections.abc import Iterator
from contextlib import nullcontext

import numpy as np
from scipy.ndimage import binary_dilation

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.field import load_field, save_field
from stages.artifacts.photos import bank_of, level_of
from stages.artifacts.region import region_of_field
from stages.artifacts.scene import EARLIER, SceneData, edit_targets, load_scene
from stages.configs.edit import FinetuneConfig
from stages.configs.fit import NEAR_SCALING, budget_of, smoothness_of
from stages.run.devices import gpu_figures, gpu_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import resumed, run_training
from stylerf.fields.encoded_color import EncodedColor
from stylerf.fields.packed_surface import PackedSurface, pixel_cells
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.protocol import ColorPart
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.training.backends import finetune_engine, style_backend
from stylerf.training.finetune.engine import FineTuneSettings
from stylerf.training.finetune.trainer import EditedPixels, FineTuner

SPEC = Spec(stage="finetune", verb="finetune", revision=7, writes="field", parallel=True)
SEEN = 2e-2  # fraction of a ray's largest weight above which a sample is treated as seen
# Weight of the total variation of a region's own colors: it keeps them from what is around it (decision 0073).
REGION_SMOOTHNESS = 3e-2
MARGIN = 2  # cells: samples in front of a surface, where its color is also looked up


def run(inputs: dict[str, Artifact], config: FinetuneConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the field that shows the edit; return the figures."""
    scene = load_scene(inputs["scene"])
    field, background = load_field(inputs["field"])
    threads = set_threads(context.threads)
    train = scene.splits["train"]
    whole = config.colors == "field"
    if whole and isinstance(field.color, RegionColor):
        raise BadInput(
            f"{inputs['field'].path} contains a local edit that covers its own colors, so these cannot be trained: "
            "leave out --colors field, or use it for the earlier edits too"
        )
    edited, device = edited_pixels(scene, train, earlier=whole), gpu_of(context, field)
    if not whole:
        cameras = [scene.cameras[train[view]] for view in np.unique(edited.views)]
        field.color = _patch(inputs, field, cameras, threads, device)
    seconds, steps = budget_of(config.budget)
    rate, density_factor = config.rates
    settings = FineTuneSettings(
        seconds=seconds or 1.0,
        steps=steps,
        rays=config.rays,
        inside=config.inside,
        beside=config.beside,
        rate=rate,
        density_factor=density_factor,
        depth_weight=config.depth_weight,
        background=level_of(background),
        smoothness=(
            smoothness_of(field.density.kind, scene.layout),
            smoothness_of(kind_of(field.color), scene.layout) if whole else REGION_SMOOTHNESS,
        ),
        near_scaling_distance=NEAR_SCALING[scene.layout],
    )
    bank = bank_of(scene, train, partial.folder, context)
    tuner = FineTuner(field, bank, edited, settings, context.seed, threads, context.processes, finetune_engine(device))
    if resumed(tuner, partial, context):
        context.progress.say(f"resuming at step {tuner.state.step}")
    with nullcontext() if device else compiling_note(context.progress.say):
        _train(tuner, config, partial, context)
    if context.processes.first:
        save_field(partial.path, tuner.field, background)
    state = tuner.state
    return {
        "steps": state.step,
        "train_seconds": round(state.seconds, 2),
        "curve_finetune": state.curve,
        "edited_pixels": len(edited.pixels),
        "parameters": field.parameters,
        **gpu_figures(device),
    }


def _patch(
    inputs: dict[str, Artifact], field: RadianceField, cameras: list[Camera], threads: int, device: str | None
) -> RegionColor:
    """Return colors for the region and MARGIN cells around it, over the field's. cameras: those that see it."""
    otherwise = ", or train the whole field with --colors field"
    region = region_of_field(inputs["region"], inputs["field"], field, otherwise)
    some = [cameras[i] for i in np.unique(np.linspace(0, len(cameras) - 1, 4).round().astype(int))]
    seen = pixel_cells(_surfaces(field, some, threads, device))
    return RegionColor.create(field.color, binary_dilation(region.edit, iterations=MARGIN), seen)


def kind_of(color: ColorPart) -> str:
    """Return the kind (vm, hash, ...) of a color's values."""
    return color.features.kind if isinstance(color, EncodedColor | PaletteColor) else color.kind


def _surfaces(field: RadianceField, cameras: list[Camera], threads: int, device: str | None) -> Iterator[PackedSurface]:
    """Yield each view's surface."""
    geometry = style_backend(device).fixed_geometry(field, cameras, SEEN, threads, 0)
    return (geometry.surface(view) for view in range(len(cameras)))


def edited_pixels(scene: SceneData, train: list[int], earlier: bool) -> EditedPixels:
    """Return the edited pixels of an edited scene's training views, by position in `train`.

    earlier: include those of edits before the last, from which separate colors of the last region cannot learn.
    """
    targets = edit_targets(scene)
    if not targets:
        raise BadInput(f"{scene.folder} contains no edit; give a scene made by `stylerf distill`")
    views: list[np.ndarray] = []
    pixels: list[np.ndarray] = []
    depths: list[np.ndarray] = []
    beside: list[np.ndarray] = []
    edits = ("", EARLIER) if earlier else ("",)
    for place, index in enumerate(train):
        parts = [targets[index, part] for part in edits if (index, part) in targets]
        own = np.concatenate([np.empty(0, np.int64), *(part.pixels for part in parts)])
        if len(own):  # a view may show nothing of it as solid as requested
            views.append(np.full(len(own), place, np.int64))
            pixels.append(own)
            depths.extend(part.depth for part in parts)
            beside.append(_around(own, scene.cameras[index]))
    if not pixels:
        raise BadInput(f"{scene.folder}: no training view shows the edit")
    around = np.concatenate([np.full(len(own), group[0]) for group, own in zip(views, beside)]), np.concatenate(beside)
    return EditedPixels(np.concatenate(views), np.concatenate(pixels), np.concatenate(depths), around)


def _around(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the row-major indices of pixels next to edited ones: within a fiftieth of the picture's longer side."""
    edited = np.zeros((camera.height, camera.width), bool)
    edited.reshape(-1)[pixels] = True
    reach = max(2, max(edited.shape) // 50)
    return np.flatnonzero(binary_dilation(edited, iterations=reach) & ~edited)


def _train(tuner: FineTuner, config: FinetuneConfig, partial: PartialArtifact, context: Context) -> None:
    steps = tuner.settings.steps
    context.progress.start("finetune", steps or tuner.settings.seconds, "step" if steps else "s")

    def report(now: FineTuner) -> None:
        note = ""
        if now.state.curve:
            last = now.state.curve[-1]
            note = f"squared error {last['inside']:.4f} in the edit, {last['outside']:.4f} outside"
        context.progress.update(now.state.step if steps else min(now.state.seconds, now.settings.seconds), note)

    run_training(tuner, "the fine-tuning", config.checkpoint_every_seconds, partial, context, report)
