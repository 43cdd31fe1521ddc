"""Test views of a field beside their photos."""

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact
from stages.artifacts.field import load_field
from stages.artifacts.photos import level_of, photo_for
from stages.artifacts.region import load_region
from stages.artifacts.scene import load_scene
from stages.evaluation.region_masks import REGION_THRESHOLD
from stages.stress.criteria import ViewPair
from stylerf.kernels.cpu.compiling import set_threads
from stylerf.rendering.view import RenderedView, render_view

OPAQUE = 0.9


def view_pairs(scene: Artifact, field: Artifact, threads: int) -> list[ViewPair]:
    """Render every test view over the background that the field was fitted on.

    Pixels that a capture masks out get the field's own colors, so that no method is judged by them.
    """
    data = load_scene(scene)
    radiance, background = load_field(field)
    level, threads = level_of(background), set_threads(threads)
    views = []
    for index in data.splits["test"]:
        camera, photo = data.cameras[index], data.images(index)
        mask = photo[..., 3] > 0.5 if photo.shape[2] == 4 and not radiance.opaque_background else None
        render = _over(render_view(radiance, camera, threads=threads), level)
        views.append(ViewPair(camera.name, render, photo_for(radiance, data, index, level, threads), mask))
    return views


def view_pairs_of_edit(
    scene: Artifact, before: Artifact, after: Artifact, region: Artifact, threads: int
) -> list[ViewPair]:
    """Render every test view of an edited field and of the field before, with the mask of the region."""
    data = load_scene(scene)
    (plain, background), (edited, _), (cells, _) = load_field(before), load_field(after), load_region(region)
    level, threads = level_of(background), set_threads(threads)
    views = []
    for camera in (data.cameras[index] for index in data.splits["test"]):
        found = render_view(plain, camera, threads=threads, regions={"part": cells.edit})
        pictures = _over(render_view(edited, camera, threads=threads), level), _over(found, level)
        views.append(ViewPair(camera.name, *pictures, found.masks["part"] > REGION_THRESHOLD))
    return views


def central_pixel(scene: Artifact, field: Artifact, threads: int) -> tuple[str, float]:
    """Find the opaque pixel nearest the center of the first training view.

    Returns:
        The pixel as VIEW:X,Y, and its distance from the camera, scene units.

    Raises:
        BadInput: the view shows nothing opaque.
    """
    data = load_scene(scene)
    camera = data.cameras[data.splits["train"][0]]
    found = render_view(load_field(field)[0], camera, threads=set_threads(threads))
    rows, columns = np.nonzero(found.alpha > OPAQUE)
    if not len(rows):
        raise BadInput(f"{field.path}: {camera.name} shows nothing opaque")
    nearest = np.argmin(np.hypot(rows - camera.height / 2, columns - camera.width / 2))
    row, column = rows[nearest], columns[nearest]
    return f"{camera.name}:{column},{row}", float(found.ray_distance[row, column])


def _over(found: RenderedView, level: float) -> np.ndarray:
    """Composite over a gray level, clipped to 0..1, [h, w, 3]; NaN stays, to be judged."""
    return np.clip(found.rgb + (1 - found.alpha[..., None]) * np.float32(level), 0, 1)


def side_by_side(view: ViewPair) -> np.ndarray:
    """Return photo and render side by side, [h, 2 w + 4, 3]; non-finite pixels are magenta."""
    bad = ~np.isfinite(view.render).all(-1)
    render = np.where(bad[..., None], (1.0, 0.0, 1.0), np.nan_to_num(view.render))
    gap = np.ones((len(render), 4, 3))
    return np.concatenate([view.photo, gap, render], 1)
