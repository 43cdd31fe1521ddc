"""Test views of a field beside their photos, and the picture that shows the worst of them."""

import numpy as np

from schemas.store import Artefact
from stages.fields import load_field
from stages.photos import level_of, photo_over
from stages.scenes import load_scene
from stages.stress.criteria import Seen
from stylerf.kernels.cpu.compiling import set_threads
from stylerf.rendering.view import render_view


def seen_from_tests(scene: Artefact, field: Artefact, threads: int) -> list[Seen]:
    """Every test view of the scene, rendered over the background that the field was fitted on."""
    data = load_scene(scene)
    radiance, background = load_field(field)
    level, chunks = level_of(background), set_threads(threads)
    views = []
    for index in data.splits["test"]:
        camera, photo = data.cameras[index], data.images(index)
        found = render_view(radiance, camera, chunks=chunks)
        # Clipped as a picture file would be; NaN stays, to be judged.
        render = np.clip(found.rgb + (1 - found.alpha[..., None]) * np.float32(level), 0, 1)
        mask = photo[..., 3] > 0.5 if photo.shape[2] == 4 else None
        views.append(Seen(camera.name, render, photo_over(data, index, level), mask))
    return views


def shown_beside(view: Seen) -> np.ndarray:
    """[h, 2 w + 4, 3]: the photo, and the render with magenta where it is not finite."""
    bad = ~np.isfinite(view.render).all(-1)
    render = np.where(bad[..., None], (1.0, 0.0, 1.0), np.nan_to_num(view.render))
    gap = np.ones((len(render), 4, 3))
    return np.concatenate([view.photo, gap, render], 1)
