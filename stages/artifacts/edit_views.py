"""Reads and writes edit datasets: dataset.json lists the views, dataset.safetensors holds what they show."""

from pathlib import Path

import numpy as np

from schemas.atomic_write import write_json
from schemas.json_numbers import LARGEST_PICTURE, LARGEST_SIDE
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact
from stages.artifacts.validity import sound
from stylerf import validation
from stylerf.editing.extraction import EditView, check_pixels
from stylerf.errors import InvalidValue

DESCRIPTION, NUMBERS = "dataset.json", "dataset.safetensors"
ARRAYS = ("pixels", "x", "along", "directions", "target", "weight", "inside", "depth", "through", "transition", "edges")

WIDE = {"x": 3, "along": 3, "directions": 3, "target": 3, "edges": 2}  # numbers a pixel, where there are several


def save_edit_views(folder: Path, views: list[EditView], details: dict) -> None:
    """Write the views. details: further keys of dataset.json, such as the views that do not see the region."""
    arrays = {f"{v.view}.{name}": getattr(v, name) for v in views for name in ARRAYS}
    save_tensors(folder / NUMBERS, arrays)
    listed = [{"view": v.view, "width": v.width, "height": v.height, "pixels": len(v)} for v in views]
    write_json(folder / DESCRIPTION, {**details, "views": listed})


def load_edit_views(artifact: Artifact) -> tuple[list[EditView], dict]:
    """The views and what dataset.json says; ArtifactDamaged where the two files do not belong together."""
    artifact.check_sizes()
    arrays, _ = artifact.tensors(NUMBERS)
    data = artifact.json(DESCRIPTION)
    with sound(artifact.path, "a sound edit dataset"):
        views = [_view(item, arrays) for item in validation.entry(data, "views", list)]
        if not views or len({one.view for one in views}) < len(views):
            raise InvalidValue("there are no views, or one is repeated")
        return views, data


def _view(item: dict, arrays: dict[str, np.ndarray]) -> EditView:
    view = validation.integer(item, "view", 0, 10**9)
    width, height = (validation.integer(item, side, 1, LARGEST_SIDE) for side in ("width", "height"))
    if width * height > LARGEST_PICTURE:
        raise InvalidValue(f"view {view} has {width}x{height} pixels; at most {LARGEST_PICTURE} can be")
    count = validation.integer(item, "pixels", 1, width * height)
    pixels = validation.array(arrays, f"{view}.pixels", np.int64, (count,))
    check_pixels(pixels, f"{view}.pixels", width, height)
    if not (np.diff(pixels) > 0).all():
        raise InvalidValue(f"the array {view}.pixels is not in ascending order")
    shapes = {name: (count, WIDE[name]) if name in WIDE else (count,) for name in ARRAYS[1:]}
    own = {name: validation.array(arrays, f"{view}.{name}", np.float32, shape) for name, shape in shapes.items()}
    return EditView(view, width, height, pixels, **own)
