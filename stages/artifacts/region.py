"""Reads and writes region artifacts: region.json holds the selection's options, region.safetensors the cells."""

from pathlib import Path

import numpy as np

from schemas.atomic_write import write_json
from schemas.errors import BadInput
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact
from stages.artifacts.validity import sound
from stylerf import validation
from stylerf.editing.edit_grid import Region
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.space_warp import SpaceWarp

DESCRIPTION, NUMBERS = "region.json", "region.safetensors"


def save_region(folder: Path, region: Region, space: SpaceWarp, details: dict) -> None:
    """Write a region. space: the warp whose cube the cells divide. details: further keys of region.json."""
    packed = {name: np.packbits(grid.reshape(-1)) for name, grid in (("edit", region.edit), ("grow", region.grow))}
    save_tensors(folder / NUMBERS, packed)
    write_json(folder / DESCRIPTION, {**details, "cells": region.cells, "space": space.describe()})


def region_of_field(region: Artifact, of: Artifact, field: RadianceField, otherwise: str = "") -> Region:
    """The region's cells; BadInput where they divide the space of another field than `of`, which holds `field`.

    otherwise: what else could be done, for the message.
    """
    found, space = load_region(region)
    if space != field.space:
        raise BadInput(
            f"region {region.name} was selected on a different field than {of.name}; select it again with "
            f"`stylerf select --of {of.name}`{otherwise}"
        )
    return found


def load_region(artifact: Artifact) -> tuple[Region, SpaceWarp]:
    """The region and the space whose cube it divides; ArtifactDamaged where the two files do not make one."""
    artifact.check_sizes()
    arrays, _ = artifact.tensors(NUMBERS)
    data = artifact.json(DESCRIPTION)
    with sound(artifact.path, "a sound region"):
        cells = validation.integer(data, "cells", 1, 1024)
        region = Region(*(validation.bits(arrays, name, cells) for name in ("edit", "grow")))
        return region, SpaceWarp.restore(validation.entry(data, "space"))
