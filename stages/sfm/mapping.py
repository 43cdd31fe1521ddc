"""From matches to poses and points: COLMAP's incremental mapper, then a refinement of the lens.

Incremental, not global: the global mapper was found grossly wrong on two of three databases of the same photos while it
reported all of them registered at half a pixel.
"""

import shutil
from pathlib import Path

from stages.sfm.job import Job, JobProgress
from stages.sfm.photo_copies import COPIES
from stages.sfm.quality import REFUSED_SHARE
from stylerf.environment.colmap import pycolmap

MODELS = "models"
# Parallax required of the first pair, degrees: COLMAP's default, or half of it for few photos, which seldom have so
# much; narrow if too few photos are placed that way. COLMAP itself goes down to a quarter of it, but photos that all
# face forward may have less.
WIDE, MODERATE, NARROW = 16.0, 8.0, 2.0
# Refine a lens beyond its focal length and first coefficient only if this many photos share it.
PHOTOS_TO_REFINE = 20
# Points are kept while their error is under this (pixels of the copies) and their parallax above this (degrees).
LARGEST_ERROR, MIN_PARALLAX = 4.0, 1.5
# A refined principal point further from the center than this share of the side has absorbed errors.
FARTHEST_CENTER = 0.08


def reconstruct(job: Job, database: Path, photos: int, progress: JobProgress) -> list[pycolmap.Reconstruction]:
    """Return all models, the one with the most photos first; none if no pair of photos has enough matches to begin
    with.

    Begins with a pair of wide parallax, or, if that places too few photos, with a narrow one if it places more.
    """
    best: list[pycolmap.Reconstruction] = []
    for angle in (WIDE if photos > 20 else MODERATE, NARROW):
        models = _mapped(job, database, photos, angle, progress)
        models.sort(key=lambda model: (-model.num_reg_images(), -model.num_points3D()))
        best = max(best, models, key=lambda found: found[0].num_reg_images() if found else 0)  # the first of equals
        if best and best[0].num_reg_images() >= REFUSED_SHARE * photos:
            break
    return best


def _mapped(
    job: Job, database: Path, photos: int, angle: float, progress: JobProgress
) -> list[pycolmap.Reconstruction]:
    """Return all models that grow from pairs of photos with `angle` degrees of parallax, in COLMAP's order."""
    folder = Path(job.folder) / MODELS
    shutil.rmtree(folder, ignore_errors=True)  # of an interrupted mapping
    folder.mkdir()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1  # more threads sum residuals in a different order every time
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = job.seed
    options.min_model_size = 3
    options.mapper.init_min_tri_angle = angle
    progress.step("reconstructing", photos, "photo")
    count = 0

    def registered(of_first_pair: int = 1) -> None:
        nonlocal count
        count = 2 if of_first_pair == 2 else count + 1
        progress.done(min(count, photos))

    images = Path(job.folder) / COPIES
    models = pycolmap.incremental_mapping(
        database, images, folder, options,
        initial_image_pair_callback=lambda: registered(2), next_image_callback=registered,
    )  # fmt: skip
    return list(models.values())


def refined(model: pycolmap.Reconstruction, folder: Path) -> tuple[pycolmap.Reconstruction, bool]:
    """Refine the model with a second radial coefficient and a free principal point; return it and whether that was
    done.

    COLMAP refines neither. On phone photos, freeing them brought rotations from 0.6 to 0.2 degrees of reference poses
    and the error down by 5 %. The model is returned unchanged if a lens has few photos, or the result is implausible.
    """
    used = [model.images[number].camera_id for number in model.reg_image_ids()]
    if any(used.count(number) < PHOTOS_TO_REFINE for number in set(used)):
        return model, False
    before = folder / "unrefined"
    shutil.rmtree(before, ignore_errors=True)
    before.mkdir()
    model.write(before)
    old_error = model.compute_mean_reprojection_error()
    for number in set(used):
        camera = model.cameras[number]
        camera.model, camera.params = pycolmap.CameraModelId.RADIAL, [*camera.params, 0.0]
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point, options.print_summary = True, False
    options.ceres.solver_options.num_threads = 1
    pycolmap.bundle_adjustment(model, options)
    model.update_point_3d_errors()
    sound = all(_is_lens(model.cameras[number]) for number in set(used))
    if not sound or model.compute_mean_reprojection_error() > old_error:
        return pycolmap.Reconstruction(before), False
    pycolmap.ObservationManager(model).filter_all_points3D(LARGEST_ERROR, MIN_PARALLAX)
    model.update_point_3d_errors()
    return model, True


def _is_lens(camera: pycolmap.Camera) -> bool:
    f, cx, cy, k1, k2 = camera.params
    off_center = max(abs(cx / camera.width - 0.5), abs(cy / camera.height - 0.5))
    return 0.2 < f / max(camera.width, camera.height) < 10 and off_center < FARTHEST_CENTER and abs(k1) + abs(k2) < 1
