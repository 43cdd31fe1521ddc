"""Fit: a radiance field from a scene's training views."""

import time
from contextlib import nullcontext

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.field import save_field
from stages.artifacts.photos import bank_of
from stages.artifacts.scene import EXPOSURE_STOPS, SceneData, load_scene, space_of, spread
from stages.configs.fit import (
    DISTORTION,
    ENOUGH_PHOTOS,
    FIELD,
    MIN_CELL_WEIGHT,
    NEAR_SCALING,
    OVERSHOOT,
    FitConfig,
    budget_of,
    capacity_of,
    kinds_of,
    smoothness_of,
)
from stages.evaluation.pose_check import pose_metrics, pose_shifts, pose_warning
from stages.run.devices import gpu_figures, gpu_of
from stages.run.memory import in_words
from stages.run.progress import Context
from stages.run.runner import Spec
from stages.run.training_loop import resumed, run_training
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.training.backends import fit_engine
from stylerf.training.fit.fitter import CHECK_EVERY, Fitter
from stylerf.training.fit.settings import (
    LEVELS,
    CapacityLevel,
    FitSettings,
    Kinds,
    capacities_at,
    cells_for,
    first_parts,
    levels_for,
)

SPEC = Spec(stage="nerf_fit", verb="fit", revision=23, writes="field", parallel=True)
GPU_SAMPLES = 262_144  # of a step: smaller ones would leave a GPU waiting for launches
# Peak memory of the fits of benchmarks/results/kinds.json, on two threads: of the program with a batch, of a parameter
# with its gradients, its moments and the copies that a return and a change of size need.
FIT_BYTES, PARAMETER_BYTES = 0.37e9, 94
BRIEF_SECONDS, BRIEF_STEPS = 60.0, 3000  # on a CPU, shorter times are better spent on coarser colors (decision 0067)
FIVE_LEVEL_ENDS = (0.08, 0.17, 0.27, 0.39, 0.55)  # FitSettings.level_ends of five levels
# In a contraction, steps after which levels end at the latest (FitSettings).
LEVEL_MAX_STEPS = (350, 850, 1350, 1900)
ESTIMATED_AFTER_CHECKS = 2  # the first one loads kernels
NEIGHBORS = 4  # of a camera, whose mean distance shows whether it is inside a capture or at its edge
RATE = {"object": 2e-2, "forward": 4e-2, "unbounded": 4e-2}


def run(inputs: dict[str, Artifact], config: FitConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write field.json and field.safetensors; return the figures, including the curve of quality over time."""
    scene = load_scene(inputs["scene"])
    threads = set_threads(context.threads)
    space, reason = space_of(scene, config.space)
    context.progress.say(f"space: {space.kind}, {reason}")
    train = scene.splits["train"]
    if len(train) < 2:
        raise BadInput(
            f"{inputs['scene'].path}: only {len(train)} of {len(scene.views)} views "
            f"{'is' if len(train) == 1 else 'are'} for training, but a fit needs at least 2; import more photos, or "
            "hold none out for tests with --test-every 0"
        )
    held_out = _held_out(scene, config.held_out)
    order = [i for i in train if i not in held_out] + held_out
    bank = bank_of(scene, order, partial.folder, context)
    report_ineffective_options(config, scene.layout, space.kind, bank.channels == 4, context)
    device = gpu_of(context)
    settings = fit_settings(config, scene, space, device)
    if context.memory and device is None:
        report_memory(settings, space, context)
    engine = fit_engine(device, settings.samples, config.gradient_clip)
    say, processes = context.progress.say, context.processes
    fitter = Fitter(space, bank, len(held_out), settings, context.seed, threads, say, processes, engine)
    if resumed(fitter, partial, context):
        context.progress.say(f"resuming at step {fitter.state.step}, {fitter.state.seconds:.0f} s into the fit")
    with nullcontext() if device else compiling_note(context.progress.say):
        _train(fitter, config, partial, context)
    if settings.force_growth and fitter.state.level < len(settings.levels) - 1:
        why = f"{fitter.state.step} steps were too few"
        if fitter.state.growth_ended:
            why = "quality fell, so the fit went back to a coarser level"
        fitter.state.decisions.append(f"--capacity {config.capacity} was not reached: {why}")
        context.progress.say(fitter.state.decisions[-1])
    context.progress.say(fitter.search.summary(fitter.field.parameters))
    if processes.first:
        background = "none" if fitter.field.opaque_background else shown_background(settings.background)
        save_field(partial.path, fitter.field, background)
    shifts = pose_shifts(fitter)
    if line := pose_warning(shifts):
        context.progress.say(line)
    return _figures(fitter, held_out, reason) | {"pose_shift_px": pose_metrics(shifts)} | gpu_figures(device)


def report_ineffective_options(config: FitConfig, layout: str, space: str, cut_out: bool, context: Context) -> None:
    """Report options for objects that were set but have no effect here. cut_out: some photo has alpha."""
    works = {
        "opacity_weight": layout == "object",
        "coverage_weight": layout == "object" and cut_out,
        "visual_hull": space == "box" and cut_out,
        "background": cut_out,
    }
    idle = [name for name, used in works.items() if not used and getattr(config, name) != getattr(FitConfig, name)]
    if idle:
        flags = ", ".join("--" + name.replace("_", "-") for name in idle)
        context.progress.say(
            f"no effect: {flags} (only for objects cut out by transparency); here layout {layout}, space {space}, "
            f"photos {'with' if cut_out else 'without'} transparency"
        )


def report_memory(settings: FitSettings, space: SpaceWarp, context: Context) -> None:
    """Report if the limit is below what fitting the largest field needs; for voxels, the first level: how many finer
    ones are kept is not known in advance."""
    kinds, finest = settings.kinds, settings.levels[-1].resolution
    # The last level may have fewer parameters than the one before.
    levels = settings.levels[:1] if "voxel" in (kinds.density, kinds.color) else settings.levels[-2:]

    def parameters(level: CapacityLevel) -> int:
        capacities = capacities_at(level, finest, kinds.hash_levels, space, degree=settings.degree)
        return sum(len(part.values) for part in first_parts(kinds, *capacities, np.random.default_rng(0)))

    most, level = max(((parameters(level), level) for level in levels), key=lambda found: found[0])
    # A gradient buffer a thread: PARAMETER_BYTES has those of two.
    needed = FIT_BYTES + (PARAMETER_BYTES + 4 * max(0, context.threads - 2)) * most
    if context.memory < needed:
        context.progress.say(
            f"--memory {in_words(context.memory)} is less than fitting a field of {level.resolution}^3 needs, about "
            f"{in_words(needed)} besides its photos: the limit will be exceeded if the field grows that large"
        )


def _train(fitter: Fitter, config: FitConfig, partial: PartialArtifact, context: Context) -> None:
    steps, estimated, begun = fitter.settings.steps, False, time.monotonic()
    if not steps:
        context.progress.say(time_beside_training(config, fitter))
    context.progress.start("fit", steps or fitter.settings.seconds, "step" if steps else "s")

    def report(now: Fitter) -> None:
        nonlocal estimated
        if not steps and not estimated and now.checks == ESTIMATED_AFTER_CHECKS:
            estimated = True
            context.progress.say(estimated_total(config, now, time.monotonic() - begun))
        if now.state.step % 10 == 0:
            last, note = now.state.curve[-1] if now.state.curve else {}, ""
            if last:
                note = f"{last['psnr']:.1f} dB {'held out' if last['held_out'] else 'on training views'}"
            done = now.state.step if steps else min(now.state.seconds, now.settings.seconds)
            context.progress.update(done, f"{note}, {now.parameters / 1e6:.2f} M parameters")

    run_training(fitter, "the fit", config.checkpoint_every_seconds, partial, context, report)


def time_beside_training(config: FitConfig, fitter: Fitter) -> str:
    """Describe what a time budget does not include."""
    checks = f"loading kernels and {round(1 / CHECK_EVERY)} checks on held-out or training views"
    views = ", then views to EXR and PNG (not with --no-buffers)" if config.buffers else ""
    return f"{fitter.settings.seconds:.0f} s of training, plus {checks}{views}"


def estimated_total(config: FitConfig, fitter: Fitter, elapsed: float) -> str:
    """Estimate the total time from the last check: rays take as long in other checks, and in views rendered afterwards.

    elapsed: seconds since kernels began to load. Larger fields, and tried prunings, take longer.
    """
    budget, each = fitter.settings.seconds, fitter.check_seconds
    checks = each / CHECK_EVERY
    pixels = sum(camera.width * camera.height for camera in fitter.dataset.cameras)
    views = pixels * each / len(fitter.held_out_rays.rays[0]) if config.buffers else 0.0
    loading = max(0.0, elapsed - fitter.state.seconds - fitter.checks * each)
    parts = [f"{budget:.0f} s of training", f"{loading:.0f} s of loading", f"{checks:.0f} s of checks"]
    parts += [f"{views:.0f} s of rendering {len(fitter.dataset.cameras)} views"] if config.buffers else []
    return f"about {budget + loading + checks + views:.0f} s or more in total: {', '.join(parts)}"


def fit_settings(config: FitConfig, scene: SceneData, space: SpaceWarp, device: str | None = None) -> FitSettings:
    """Return the settings of a fit of this scene, with defaults that depend on its layout and space."""
    seconds, steps = budget_of(config.budget)
    fixed = capacity_of(config.capacity)
    if scene.background == "none":
        background = "none"
    elif scene.background in ("white", "black"):
        background = scene.background
    else:
        background = "white" if config.background == "auto" else config.background
    kinds = Kinds(*kinds_of(FIELD[scene.layout] if config.field == "auto" else config.field), config.head)
    near = config.near_scaling_distance
    return FitSettings(
        seconds=seconds or 1.0,
        steps=steps,
        kinds=kinds,
        samples=config.samples or (GPU_SAMPLES if device else _cpu_samples(seconds)),
        rate=config.rate or RATE[scene.layout],
        smoothness=_smoothness(config, scene, kinds),
        near_scaling_distance=NEAR_SCALING[scene.layout] if near < 0 else near,
        degree=config.degree,
        min_gain=config.min_gain,
        background=background,
        force_growth=fixed is not None,
        visual_hull=config.visual_hull,
        # In a capture, with its opaque background, every ray is opaque anyway.
        opacity=config.opacity_weight if scene.layout == "object" else 0.0,
        coverage=config.coverage_weight if scene.layout == "object" else 0.0,
        distortion=DISTORTION[scene.layout] if config.distortion_weight < 0 else config.distortion_weight,
        least_weight=MIN_CELL_WEIGHT[scene.layout] if config.least_weight < 0 else config.least_weight,
        overshoot=_overshoot(config, scene.layout),
        # Each point of a capture is seen from about one direction, so its harmonics contain much of its mean color:
        # dropping them loses 5 to 12 dB, which says nothing about a field trained without them.
        prunings=tuple(name for name in FitSettings.prunings if name != "degree" or scene.layout == "object"),
        # An object is lit differently from side to side anyway.
        exposure="off" if config.exposure == "auto" and scene.layout == "object" else config.exposure,
        **_levels_of(fixed, kinds, space, scene, brief=not device and _is_brief(seconds, steps)),
    )


def _overshoot(config: FitConfig, layout: str) -> tuple[float, float]:
    """Return the factors of the distortion and of the least weight; a given weight holds as it is."""
    distortion, least = config.distortion_weight, config.least_weight
    return 1.0 if distortion >= 0 else OVERSHOOT[layout], 1.0 if least >= 0 else OVERSHOOT[layout]


def _smoothness(config: FitConfig, scene: SceneData, kinds: Kinds) -> tuple[float, float]:
    """Return the weights of the total variation (density, color).

    Few photos of one side say little about what is between them.
    """
    if config.smoothness >= 0:
        return config.smoothness, config.smoothness
    few = ENOUGH_PHOTOS / len(scene.splits["train"]) if scene.layout == "forward" else 1.0
    density, color = (smoothness_of(kind, scene.layout) * max(1.0, few) for kind in (kinds.density, kinds.color))
    return density, color


def _is_brief(seconds: float, steps: int) -> bool:
    return seconds < BRIEF_SECONDS if seconds else steps < BRIEF_STEPS


def _cpu_samples(seconds: float) -> int:
    """Samples per step: many small steps for a short time, large ones against noise for a long one (decision 0059).

    Budgets in steps (0 seconds) get the most.
    """
    return int(np.clip(1000 * seconds, 30_000, 90_000)) if seconds else 90_000


def _levels_of(
    fixed: tuple[int, int, int] | None, kinds: Kinds, space: SpaceWarp, scene: SceneData, brief: bool
) -> dict:
    """Return the settings of the capacity levels. brief: there is no time for the finest colors of a capture."""
    contraction, four = space.kind == "contraction", FitSettings.level_ends
    # In a contraction, a coarse grid trained longer learns wrong geometry; elsewhere it overfits less.
    more = {"level_max_steps": LEVEL_MAX_STEPS if contraction else ()}
    if fixed is not None:
        levels = _fixed_levels(*fixed, first_color=16 if kinds.head == "linear" else fixed[2])
        levels = cells_for(levels, space.kind)
        return {"levels": levels, "level_ends": four[: len(levels) - 1], **more}
    pixels = max(max(camera.width, camera.height) for camera in scene.cameras)
    levels = cells_for(levels_for(kinds, space.kind, pixels, brief), space.kind)
    return {"levels": levels, "level_ends": four if len(levels) == len(four) else FIVE_LEVEL_ENDS, **more}


def _fixed_levels(resolution: int, density: int, color: int, first_color: int) -> tuple[CapacityLevel, ...]:
    """Return levels that lead to one capacity, which is reached sooner than by starting there."""
    coarser = [n for n in (64, 128, 192) if n < resolution]
    return tuple(
        CapacityLevel(
            n,
            min(density, 8) if n == 64 else density,
            min(color, first_color) if n == 64 else color,
            table_bits=_table_bits(n),
        )
        for n in coarser
    ) + (CapacityLevel(resolution, density, color, table_bits=_table_bits(resolution)),)


def _table_bits(resolution: int) -> int:
    return max([LEVELS[0].table_bits] + [level.table_bits for level in LEVELS if level.resolution <= resolution])


def _held_out(scene: SceneData, wanted: int) -> list[int]:
    """The training views that decide on capacity."""
    train = scene.splits["train"]
    count = min(4, len(train) // 10) if wanted < 0 else wanted
    if count >= len(train) - 1:
        raise BadInput(f"{count} of {len(train)} training views cannot be held out; lower --held-out")
    if scene.layout == "object" or 2 * count > len(train):
        return spread(train, count)
    # At the edge of a capture a finer field gains little: what a view shows there, no other view has seen (0064).
    inner = surrounded(np.array([scene.cameras[view].center for view in train]))
    return spread([train[place] for place in inner], count)


def surrounded(centers: np.ndarray) -> list[int]:
    """Return the half of the cameras [n, 3], n > 1, whose nearest neighbors are closest, in order: those inside a
    capture.

    More than half if several are equally close, as along an even path.
    """
    from scipy.spatial import cKDTree  # takes half a second, which no other verb needs

    nearest, _ = cKDTree(centers).query(centers, min(1 + NEIGHBORS, len(centers)))  # each one's first is itself
    apart = nearest[:, 1:].mean(1)
    return np.flatnonzero(apart <= np.median(apart) * (1 + 1e-6)).tolist()


def shown_background(background: str) -> str:
    """Background of the field in images: the one it was trained over, white if that was random."""
    return background if background in ("black", "none") else "white"


def _figures(fitter: Fitter, held_out: list[int], reason: str) -> dict:
    state = fitter.state
    level, kinds = fitter.search.level, fitter.settings.kinds
    density, color = fitter.field.density, fitter.field.color
    return {
        "steps": state.step,
        "train_seconds": round(state.seconds, 2),
        "parameters": fitter.field.parameters,
        "held_out_psnr": state.quality.get("held out"),
        "training_psnr": state.quality.get("trained on"),
        "curve": state.curve,
        "decisions": state.decisions,
        "capacity": fitter.search.summary(fitter.field.parameters),
        "sizes": state.sizes,
        "kinds": [kinds.density, kinds.color, kinds.head],
        "resolution": level.resolution,
        "density_rank": getattr(density, "rank", None),
        "color_rank": getattr(getattr(color, "features", color), "rank", None),
        "degree": getattr(color, "degree", None),
        "table_bits": level.table_bits if "hash" in (kinds.density, kinds.color) else None,
        "occupied_share": round(fitter.field.occupancy.share, 4),
        "rollbacks": state.rollbacks,
        "ended_at": state.ended_at,
        EXPOSURE_STOPS: {c.name: round(s, 3) for c, s in zip(fitter.dataset.cameras, state.stops or [])},
        "held_out_views": len(held_out),
        "space": fitter.space.kind,
        "space_reason": reason,
    }
