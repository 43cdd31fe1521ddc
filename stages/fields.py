"""Reads and writes field artefacts: field.json says what it is, field.safetensors holds its numbers."""

import json
from pathlib import Path

from schemas.atomic import write_json
from schemas.errors import ArtefactDamaged
from schemas.store import Artefact
from schemas.tensors import load_tensors, save_tensors
from stylerf.errors import InvalidValue
from stylerf.fields.deformation import Deformation
from stylerf.fields.field import RadianceField

DESCRIPTION, NUMBERS, DEFORMATION = "field.json", "field.safetensors", "deformation.safetensors"


def save_field(folder: Path, field: RadianceField, background: str) -> None:
    """background: white, black or none: what stands behind the field in pictures."""
    save_tensors(folder / NUMBERS, field.arrays())
    write_json(folder / DESCRIPTION, {**field.describe(), "background": background})


def load_field(artefact: Artefact) -> tuple[RadianceField, str]:
    """The field and its background; ArtefactDamaged where the two files do not make one."""
    artefact.check_sizes()
    arrays, _ = load_tensors(artefact.file(NUMBERS))
    try:
        data = json.loads(artefact.file(DESCRIPTION).read_text())
        return RadianceField.restore(data, arrays), data["background"]
    except (KeyError, TypeError, ValueError, InvalidValue) as error:
        raise ArtefactDamaged(f"{artefact.path} does not hold a sound field ({error}); make it anew") from error


def save_deformation(folder: Path, deformation: Deformation) -> None:
    """The network behind a field's displacement grid, for whoever moves it further."""
    save_tensors(folder / DEFORMATION, {"values": deformation.values}, {"kind": json.dumps(deformation.describe())})


def load_deformation(artefact: Artefact) -> Deformation | None:
    """The network behind a field's displacement grid; None for a field without one."""
    if not artefact.has(DEFORMATION):
        return None
    arrays, metadata = load_tensors(artefact.file(DEFORMATION))
    try:
        return Deformation.restore(json.loads(metadata["kind"]), arrays["values"].copy())
    except (KeyError, TypeError, ValueError, InvalidValue) as error:
        raise ArtefactDamaged(f"{artefact.path / DEFORMATION} is not sound ({error}); make it anew") from error
