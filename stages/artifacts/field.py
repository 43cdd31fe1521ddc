"""Reads and writes field artifacts: field.json says what it is, field.safetensors holds its numbers."""

import json
from pathlib import Path

import numpy as np

from schemas.atomic_write import write_json
from schemas.safe_reading import sound
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact
from stylerf import validation
from stylerf.fields.deformation import Deformation
from stylerf.fields.radiance_field import RadianceField

DESCRIPTION, NUMBERS, DEFORMATION = "field.json", "field.safetensors", "deformation.safetensors"
BACKGROUNDS = ("white", "black", "none")


def save_field(folder: Path, field: RadianceField, background: str) -> None:
    """background: white, black or none: the background of the field's pictures."""
    save_tensors(folder / NUMBERS, field.arrays())
    write_json(folder / DESCRIPTION, {**field.describe(), "background": background})


def load_field(artifact: Artifact) -> tuple[RadianceField, str]:
    """Return the field and its background; ArtifactDamaged if the two files are not a valid field."""
    artifact.check_sizes()
    arrays, _ = artifact.tensors(NUMBERS)
    data = artifact.json(DESCRIPTION)
    with sound(artifact.path, "a valid field"):
        return RadianceField.restore(data, arrays), validation.one_of(data, "background", BACKGROUNDS)


def save_deformation(folder: Path, deformation: Deformation) -> None:
    """Save the network behind a field's displacement grid, for further training."""
    save_tensors(folder / DEFORMATION, {"values": deformation.values}, {"kind": json.dumps(deformation.describe())})


def load_deformation(artifact: Artifact) -> Deformation | None:
    """Return the network behind a field's displacement grid; None for a field without one."""
    if not artifact.has(DEFORMATION):
        return None
    arrays, metadata = artifact.tensors(DEFORMATION)
    with sound(artifact.path / DEFORMATION, "a valid deformation"):
        values = validation.array(arrays, "values", np.float32, (None,), validation.LEARNED)
        return Deformation.restore(json.loads(validation.entry(metadata, "kind", str)), values.copy())
