"""A field as 3D Gaussian splats: placed on its surfaces, optimized against its renders, measured at held-out views."""

import time
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.errors import ArtifactDamaged, BadInput
from stages.artifacts.field import load_field
from stages.artifacts.photos import level_of, photo_over
from stages.artifacts.provenance import shows_its_pictures
from stages.artifacts.scene import spread
from stages.configs.fit import budget_of
from stages.exporting import splat_files
from stages.exporting.job import ExportedFile, ExportJob
from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.compiling import compiling_note
from stylerf.kernels.cpu.splats import Gaussians
from stylerf.metrics.image_quality import psnr
from stylerf.rendering.view import render_view
from stylerf.splats.optimization import SplatOptimizer
from stylerf.splats.placement import SurfacePoints, on_surfaces, picture_and_points, thinned
from stylerf.splats.rasterizer import splat
from stylerf.splats.similarity import moved_gaussians
from stylerf.splats.views import views_to_learn

COLORS = "spherical harmonics of sRGB-encoded, display-referred colors"
USD_FORMATS = {"usdc", "usda"}  # get a PLY next to them: programs that read USD may not support its splats yet
NEAR = 0.05  # of the scene's nearest depth: centers nearer to a camera are not drawn
FARTHEST = 30.0  # of the scene's farthest depth: where the opaque background of a capture is placed
VIEW_TIME = 0.3  # share of a time budget for rendering the views to learn from
MOST_VIEWS = 60  # of those views; with a budget of steps exactly as many, so that the result is reproducible
FEWEST_VIEWS = 8
MEASURED_VIEWS = 8  # held-out views, at most
ERRORS_SHOWN = 20  # steps that the shown quality is the mean of


@dataclass(frozen=True)
class _View:
    """A camera and what the field shows there: [h, w, 4], premultiplied rgb and alpha."""

    camera: Camera
    picture: np.ndarray


def write(job: ExportJob) -> tuple[list[ExportedFile], dict]:
    """Write the splats in every chosen format; return the files and the figures."""
    if USD_FORMATS & set(job.config.chosen):
        splat_files.check_usd()  # before anything is computed
    splats, figures = splats_of(job)
    names = dict.fromkeys(job.config.chosen) | ({"ply": None} if USD_FORMATS & set(job.config.chosen) else {})
    return [written(job, name, splats) for name in names], figures


def splats_of(job: ExportJob) -> tuple[Gaussians, dict]:
    """Return the field's splats, in scene units, and the figures of their optimization."""
    if job.context.device == "cuda":
        job.say("splats are optimized on the CPU: they have no GPU kernels")
    began = time.monotonic()
    with compiling_note(job.say) if job.context.device == "cpu" else nullcontext():
        views, points = _pictures(job)
        try:
            placed = thinned(points, job.field.space, job.config.splats)
        except InvalidValue as error:
            raise BadInput(f"{job.inputs['field'].path}: {error}") from error
        start = on_surfaces(placed, min(getattr(job.field.color, "degree", 0), 2), job.context.threads)
        job.check_precision(start.centers, np.exp(start.log_scales).max(1))
        optimizer = SplatOptimizer(start, NEAR * job.scene.bounds.near, job.context.threads)
        _optimize(job, optimizer, views, began)
        splats = optimizer.result()
    seconds = time.monotonic() - began
    if not (len(splats.centers) and all(np.isfinite(values).all() for values in splats)):
        raise BadInput(f"{job.inputs['field'].path}: its splats have no finite size; export it with --budget 1")
    figures = {
        "splats": len(splats.centers),
        "placed": len(start.centers),
        "degree": round(splats.harmonics.shape[1] ** 0.5) - 1,
        "views": len(views),
        "steps": optimizer.steps,
        "optimize_seconds": round(seconds, 2),
    }
    return splats, figures | _measured(job, splats)


def _pictures(job: ExportJob) -> tuple[list[_View], SurfacePoints]:
    """Render the views to learn from, as many as the budget allows, and sample points on their surfaces."""
    cameras = views_to_learn([job.scene.cameras[i] for i in job.scene.splits["train"]])[:MOST_VIEWS]
    if not cameras:
        raise BadInput(f"{job.scene.folder}: the scene has no training views to place splats from")
    generator = np.random.default_rng(job.context.seed)
    seconds, _ = budget_of(job.config.budget)
    farthest = FARTHEST * job.scene.bounds.far
    views, parts = [], []
    job.context.progress.start("views", len(cameras), "view")
    began = time.monotonic()
    for done, camera in enumerate(cameras, start=1):
        picture, points = picture_and_points(job.field, camera, farthest, generator, job.context.threads)
        if not np.isfinite(picture).all():
            raise ArtifactDamaged(
                f"field {job.inputs['field'].name} renders NaN or infinite values in view {camera.name}; rebuild it"
            )
        views.append(_View(camera, picture))
        parts.append(points)
        job.context.progress.update(done)
        if seconds and done >= FEWEST_VIEWS and time.monotonic() - began > VIEW_TIME * seconds:
            break
    job.context.progress.finish()
    points = SurfacePoints.joined(parts)
    if len(points.centers) < len(views):
        raise BadInput(
            f"{job.inputs['field'].path}: the field shows nothing in {len(views)} views, or less than a pixel in each: "
            "there is no surface to place splats on"
        )
    return views, points


def _optimize(job: ExportJob, optimizer: SplatOptimizer, views: list[_View], began: float) -> None:
    """Take steps on the views, in a new order each round, until the budget is used."""
    seconds, steps = budget_of(job.config.budget)
    generator = np.random.default_rng(job.context.seed)
    start = time.monotonic()
    left = max(seconds - (start - began), 0.0)
    errors: list[float] = []
    queue: list[int] = []
    job.context.progress.start("optimize", steps or left, "step" if steps else "s")
    while True:
        spent = time.monotonic() - start
        progress = optimizer.steps / steps if steps else min(spent / max(left, 1e-9), 1.0)
        if progress >= 1:
            break
        queue = queue or list(generator.permutation(len(views)))
        view = views[queue.pop()]
        errors.append(optimizer.step(view.camera, view.picture, progress))
        quality = -10 * np.log10(max(float(np.mean(errors[-ERRORS_SHOWN:])), 1e-10))
        job.context.progress.update(optimizer.steps if steps else spent, f"{quality:.1f} dB")
    job.context.progress.finish()


def _measured(job: ExportJob, splats: Gaussians) -> dict:
    """PSNR of the splats against the field, and of both against the photos, at held-out views; mean over views."""
    held_out = job.scene.splits["test"]
    if not held_out:
        job.say("the scene has no held-out views: the splats are not measured")
        return {}
    level = level_of(load_field(job.inputs["field"])[1])
    # A fine-tuned field shows the edited photos that it was trained on, not the scene's.
    photos = shows_its_pictures(job.inputs["field"]) and job.inputs["field"].manifest.stage != "finetune"
    found: dict[str, list[float]] = {"psnr_to_field": [], "psnr_to_photos": [], "field_psnr_to_photos": []}
    for index in held_out if len(held_out) <= MEASURED_VIEWS else spread(held_out, MEASURED_VIEWS):
        camera, threads = job.scene.cameras[index], job.context.threads
        drawn = splat(splats, camera, near=NEAR * job.scene.bounds.near, threads=threads).image
        seen = render_view(job.field, camera, threads=threads)
        ours = _over(drawn[..., :3], drawn[..., 3], level)
        theirs = _over(seen.rgb, seen.alpha, level)
        found["psnr_to_field"].append(psnr(ours, theirs))
        if photos:
            photo = photo_over(job.scene, index, level)
            found["psnr_to_photos"].append(psnr(ours, photo))
            found["field_psnr_to_photos"].append(psnr(theirs, photo))
    measured = {name: round(float(np.mean(values)), 3) for name, values in found.items() if values}
    return measured | {"held_out_views": len(found["psnr_to_field"])}


def _over(rgb: np.ndarray, alpha: np.ndarray, level: float) -> np.ndarray:
    return np.clip(rgb + (1 - alpha[..., None]) * np.float32(level), 0, 1)


def written(job: ExportJob, name: str, splats: Gaussians) -> ExportedFile:
    """Write one format. PLY keeps the axes of the units, as 3DGS does; in the other formats y is up."""
    up = "" if name == "ply" else "y"
    to = job.placed(f"splats.{name}", up, colors=COLORS)
    path: Path = job.folder / to.path
    placed = moved_gaussians(splats, to.file_from_scene)
    if name == "ply":
        splat_files.write_ply(path, placed)
    elif name == "spz":
        bits = splat_files.write_spz(path, placed)
        to.notes["position_step"] = 2.0**-bits
        if lost := splat_files.lost_in_spz(placed, bits):
            other = "another format" if job.config.units == "scene" else "--units scene or to another format"
            job.say(f"{to.path} loses precision: {lost}; export {other}")
    elif name == "glb":
        splat_files.write_glb(path, placed)
    else:
        splat_files.write_usd(path, placed, job.config)
    return to
