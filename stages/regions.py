"""Reads and writes region artefacts: region.json tells what was asked for, region.safetensors holds the cells."""

import json
from pathlib import Path

import numpy as np

from schemas.atomic import write_json
from schemas.errors import ArtefactDamaged, BadInput
from schemas.store import Artefact
from schemas.tensors import load_tensors, save_tensors
from stylerf.editing.regions import Region
from stylerf.errors import InvalidValue
from stylerf.fields.field import RadianceField
from stylerf.geometry.space import Space

DESCRIPTION, NUMBERS = "region.json", "region.safetensors"


def save_region(folder: Path, region: Region, space: Space, told: dict) -> None:
    """space: the warp whose cube the cells divide. told: figures for whoever reads the file."""
    packed = {name: np.packbits(grid.reshape(-1)) for name, grid in (("edit", region.edit), ("grow", region.grow))}
    save_tensors(folder / NUMBERS, packed)
    write_json(folder / DESCRIPTION, {**told, "cells": region.cells, "space": space.describe()})


def region_of_field(region: Artefact, of: Artefact, field: RadianceField, otherwise: str = "") -> Region:
    """The region's cells; BadInput where they divide the space of another field than `of`, which holds `field`.

    otherwise: what else could be done, for the message.
    """
    found, space = load_region(region)
    if space != field.space:
        raise BadInput(
            f"region {region.name} divides the space of another field than {of.name}; select it anew with "
            f"`stylerf select --of {of.name}`{otherwise}"
        )
    return found


def load_region(artefact: Artefact) -> tuple[Region, Space]:
    """The region and the space whose cube it divides; ArtefactDamaged where the two files do not make one."""
    artefact.check_sizes()
    arrays, _ = load_tensors(artefact.file(NUMBERS))
    try:
        data = json.loads(artefact.file(DESCRIPTION).read_text())
        cells = int(data["cells"])
        grids = [np.unpackbits(arrays[n], count=cells**3).astype(bool).reshape((cells,) * 3) for n in ("edit", "grow")]
        return Region(*grids), Space.restore(data["space"])
    except (KeyError, TypeError, ValueError, InvalidValue) as error:
        raise ArtefactDamaged(f"{artefact.path} does not hold a sound region ({error}); make it anew") from error
