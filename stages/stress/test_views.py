"""Test views of a field beside their photos, and the picture that shows the worst of them."""

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact
from stages.artifacts.field import load_field
from stages.artifacts.photos import level_of, photo_for
from stages.artifacts.region import load_region
from stages.artifacts.scene import load_scene
from stages.evaluation.region_masks import SHOWN
from stages.stress.criteria import Seen
from stylerf.kernels.cpu.compiling import set_threads
from stylerf.rendering.view import RenderedView, render_view

OPAQUE = 0.9


def seen_from_tests(scene: Artifact, field: Artifact, threads: int) -> list[Seen]:
    """Every test view of the scene, rendered over the background that the field was fitted on.

    What a mask hides in a capture is as the field shows it: no method is judged by that.
    """
    data = load_scene(scene)
    radiance, background = load_field(field)
    level, chunks = level_of(background), set_threads(threads)
    views = []
    for index in data.splits["test"]:
        camera, photo = data.cameras[index], data.images(index)
        mask = photo[..., 3] > 0.5 if photo.shape[2] == 4 and not radiance.opaque_background else None
        render = _over(render_view(radiance, camera, threads=chunks), level)
        views.append(Seen(camera.name, render, photo_for(radiance, data, index, level, chunks), mask))
    return views


def seen_of_edit(scene: Artifact, before: Artifact, after: Artifact, region: Artifact, threads: int) -> list[Seen]:
    """Every test view of an edited field beside the field before, with what it shows of the region."""
    data = load_scene(scene)
    (plain, background), (edited, _), (cells, _) = load_field(before), load_field(after), load_region(region)
    level, chunks = level_of(background), set_threads(threads)
    views = []
    for camera in (data.cameras[index] for index in data.splits["test"]):
        found = render_view(plain, camera, threads=chunks, regions={"part": cells.edit})
        pictures = _over(render_view(edited, camera, threads=chunks), level), _over(found, level)
        views.append(Seen(camera.name, *pictures, found.masks["part"] > SHOWN))
    return views


def middle_of(scene: Artifact, field: Artifact, threads: int) -> tuple[str, float]:
    """VIEW:X,Y of the pixel nearest to the middle of the first training view that shows something opaque.

    And how far from the camera that is, scene units. BadInput where there is none.
    """
    data = load_scene(scene)
    camera = data.cameras[data.splits["train"][0]]
    found = render_view(load_field(field)[0], camera, threads=set_threads(threads))
    rows, columns = np.nonzero(found.alpha > OPAQUE)
    if not len(rows):
        raise BadInput(f"{field.path}: nothing opaque is seen from {camera.name}")
    nearest = np.argmin(np.hypot(rows - camera.height / 2, columns - camera.width / 2))
    row, column = rows[nearest], columns[nearest]
    return f"{camera.name}:{column},{row}", float(found.ray_distance[row, column])


def _over(found: RenderedView, level: float) -> np.ndarray:
    """[h, w, 3], clipped as a picture file would be; NaN stays, to be judged."""
    return np.clip(found.rgb + (1 - found.alpha[..., None]) * np.float32(level), 0, 1)


def shown_beside(view: Seen) -> np.ndarray:
    """[h, 2 w + 4, 3]: the photo, and the render with magenta where it is not finite."""
    bad = ~np.isfinite(view.render).all(-1)
    render = np.where(bad[..., None], (1.0, 0.0, 1.0), np.nan_to_num(view.render))
    gap = np.ones((len(render), 4, 3))
    return np.concatenate([view.photo, gap, render], 1)
