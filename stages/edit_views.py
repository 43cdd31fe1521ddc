"""Reads and writes edit datasets: dataset.json lists the views, dataset.safetensors holds what they show."""

import json
from pathlib import Path

from schemas.atomic import write_json
from schemas.errors import ArtefactDamaged
from schemas.store import Artefact
from schemas.tensors import load_tensors, save_tensors
from stylerf.editing.views import EditView

DESCRIPTION, NUMBERS = "dataset.json", "dataset.safetensors"
ARRAYS = ("pixels", "x", "along", "directions", "target", "weight", "inside", "depth", "through", "transition", "edges")


def save_edit_views(folder: Path, views: list[EditView], told: dict) -> None:
    """told: what else dataset.json says, such as the views that do not see the region."""
    arrays = {f"{v.view}.{name}": getattr(v, name) for v in views for name in ARRAYS}
    save_tensors(folder / NUMBERS, arrays)
    listed = [{"view": v.view, "width": v.width, "height": v.height, "pixels": len(v)} for v in views]
    write_json(folder / DESCRIPTION, {**told, "views": listed})


def load_edit_views(artefact: Artefact) -> tuple[list[EditView], dict]:
    """The views and what dataset.json says; ArtefactDamaged where the two files do not belong together."""
    artefact.check_sizes()
    arrays, _ = load_tensors(artefact.file(NUMBERS))
    try:
        data = json.loads(artefact.file(DESCRIPTION).read_text())
        views = []
        for item in data["views"]:
            own = {name: arrays[f"{item['view']}.{name}"] for name in ARRAYS}
            views.append(EditView(item["view"], item["width"], item["height"], **own))
            if any(len(array) != item["pixels"] for array in own.values()):
                raise ValueError(f"view {item['view']} is not of one length")
        return views, data
    except (KeyError, TypeError, ValueError) as error:
        raise ArtefactDamaged(f"{artefact.path} does not hold a sound edit dataset ({error}); make it anew") from error
