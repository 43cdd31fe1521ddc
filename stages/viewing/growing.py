"""The cells of a selection in progress, and the seeds that clicks in any picture correspond to."""

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact
from stages.artifacts.photos import load_pictures
from stages.artifacts.region import load_region
from stages.artifacts.scene import SceneData
from stages.configs.select import SelectConfig
from stages.pipeline.prerequisites import training_pictures
from stages.region_select import Sight, cells_given, combined_cells, marked_cells
from stages.viewing.library import Library
from stages.viewing.selection import Selection
from stylerf.editing.edit_grid import solid_cells
from stylerf.editing.selection import Look, ends_of_rays
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera

SEEN = 0.5  # alpha from which a ray hits something
SAME_PLACE = 0.03  # relative to the distance from the camera: how far apart two rays to one point may end


def place_of(field: RadianceField, camera: Camera, pixel: int, threads: int) -> np.ndarray:
    """Return where the ray of a pixel ends, [3] scene units; BadInput if it hits nothing."""
    x, alpha = ends_of_rays(field, camera, np.array([pixel]), threads)
    if alpha[0] <= SEEN:
        raise BadInput("that place hits nothing of the field: click where the render shows an object")
    return field.space.unwarp(np.clip(x, 1e-6, 1 - 1e-6))[0]


def seen_at(
    scene: SceneData, field: RadianceField, place: np.ndarray, toward: np.ndarray, threads: int
) -> tuple[str, int, int]:
    """Return (view, x, y): the pixel of a training view that shows a point, as `select --at` expects it.

    Of the views that see it, choose the one whose direction is nearest to that of the click.

    Args:
        place: [3] scene units.
        toward: unit direction [3] in which it was seen.

    Raises:
        BadInput: no training view shows it.
    """
    found = []
    for index in scene.splits["train"]:
        camera = scene.cameras[index]
        pixels, depth = camera.project(place[None])
        x, y = (int(np.floor(v)) for v in pixels[0]) if np.isfinite(pixels).all() else (-1, -1)
        if depth[0] > 0 and 0 <= x < camera.width and 0 <= y < camera.height:
            away = place - camera.center
            found.append((float(away @ toward / max(np.linalg.norm(away), 1e-9)), index, x, y))
    for _, index, x, y in sorted(found, reverse=True):
        camera = scene.cameras[index]
        ends, alpha = ends_of_rays(field, camera, np.array([y * camera.width + x]), threads)
        there = field.space.unwarp(np.clip(ends, 1e-6, 1 - 1e-6))[0]
        far = float(np.linalg.norm(place - camera.center))
        if alpha[0] > SEEN and np.linalg.norm(there - place) <= SAME_PLACE * far:
            return scene.views[index].name, x, y
    raise BadInput("no training view shows this place, so it cannot be a seed; click another")


def box_around(places: np.ndarray) -> tuple[float, ...]:
    """Return two corners around points [n, 3], ignoring a twentieth of them at either end of each axis.

    A tenth of the longest side is added all around: only a surface is seen, which alone would fill no cell.
    """
    low, high = np.percentile(places, [5, 95], axis=0)
    margin = max(float((high - low).max()), 1e-3) / 10
    low, high = low - margin, high + margin
    return tuple(float(f"{value:.4g}") for value in (*low, *high))


class Grower:
    """Computes the cells of selections in one field, as `stylerf select` does.

    What every selection needs is computed once, in steps that threads may share: see prepare().
    """

    def __init__(self, library: Library, field: str, threads: int, say: Callable[[str], None]) -> None:
        artifact = library.work.get("field", field)
        source = library.source(field)
        self._library, self._field, self._threads = library, source.field, threads
        scene = load_pictures(training_pictures(library.work, artifact), artifact, threads)
        self._sights: dict[int, Sight] = {}
        self._first = Sight(scene, source.field, source.level, 0, threads, say)
        self._looks: dict[int, Look] = {}
        self._solid: dict[tuple[int, float], np.ndarray] = {}
        self._step = threading.Lock()

    def prepare(self, wanted: Callable[[], bool] = lambda: True) -> bool:
        """Render the training views, and find the cells that they see and that are solid; return whether all is done.

        Each step is done by one thread, while others wait for it.

        Args:
            wanted: called before each step; False stops.
        """
        first = self._first

        def look(view: int) -> None:
            if view not in self._looks:
                self._looks[view] = first.look(view)

        def see() -> None:
            first.__dict__.setdefault("looks", [self._looks[view] for view in first.looking_views])
            self._sight(0)

        def mark() -> None:
            _ = self._sight(0).seen
            self._solid_cells(0, SelectConfig.solid)

        looks: list[Callable[[], None]] = [partial(look, view) for view in first.looking_views]
        for step in (*looks, see, mark):
            if not wanted():
                return False
            with self._step:
                step()
        return True

    def cells(self, selection: Selection) -> np.ndarray:
        """Return the marked cells [s, s, s] bool of a selection; BadInput if it hits nothing."""
        self.prepare()
        config = selection.config()
        others = {}
        inputs: dict[str, Artifact] = {}
        for how in ("union", "subtract", "intersect"):
            for name in getattr(config, how):
                inputs[f"{how}.{name}"] = self._library.work.get("region", name)
                others[f"{how}.{name}"] = load_region(inputs[f"{how}.{name}"])
        cells = cells_given(config, others)
        marked = marked_cells(self._sight(cells), self._solid_cells(cells, config.solid), config)
        return combined_cells(marked, others, self._field, inputs)

    def _sight(self, cells: int) -> Sight:
        """Return the cells per side; 0: by pixel size."""
        cells = cells or self._first.cells
        if cells not in self._sights:
            sight = replace(self._first, fixed_cells=cells)
            sight.__dict__["looks"] = self._first.looks  # cached: the same for every number of cells
            self._sights[cells] = sight
        return self._sights[cells]

    def _solid_cells(self, cells: int, solid: float) -> np.ndarray:
        key = (self._sight(cells).cells, solid)
        if key not in self._solid:
            self._solid[key] = solid_cells(self._field, key[0], self._threads, solid)
        return self._solid[key]
