"""Reads and writes region artifacts; finds the regions shown as masks in a field's frames, and their EXR channels."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.atomic_write import write_json
from schemas.errors import BadInput
from schemas.safe_reading import sound
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact, WorkFolder
from stages.artifacts.field import DESCRIPTION as FIELD_DESCRIPTION
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
    """Return the region's cells; BadInput if they divide the space of a different field than `of`, which contains
    `field`.

    otherwise: an alternative to suggest in the message.
    """
    found, space = load_region(region)
    if space != field.space:
        raise BadInput(
            f"region {region.name} was selected on a different field than {of.name}; select it again with "
            f"`stylerf select --of {of.name}`{otherwise}"
        )
    return found


def load_region(artifact: Artifact) -> tuple[Region, SpaceWarp]:
    """Return the region and the space whose cube it divides; ArtifactDamaged if the two files are not valid."""
    artifact.check_sizes()
    arrays, _ = artifact.tensors(NUMBERS)
    data = artifact.json(DESCRIPTION)
    with sound(artifact.path, "a valid region"):
        cells = validation.integer(data, "cells", 1, 1024)
        region = Region(*(validation.bits(arrays, name, cells) for name in ("edit", "grow")))
        return region, SpaceWarp.restore(validation.entry(data, "space"))


ROLE = "region."
CHANNEL = "mask."


@dataclass(frozen=True, eq=False)
class Marked:
    """Return the edited cells E [s, s, s] of a region artifact, and the artifact's digest."""

    cells: np.ndarray
    digest: str


def regions_fitting(work: WorkFolder, field: Artifact) -> tuple[dict[str, Artifact], list[str]]:
    """Return the regions of a work folder that divide the field's own space, by role, and the names of all others."""
    regions = work.artifacts("region")
    if not regions:
        return {}, []
    space = _space(field, FIELD_DESCRIPTION)
    fitting = {ROLE + one.name: one for one in regions if _space(one, DESCRIPTION) == space}
    return fitting, [one.name for one in regions if ROLE + one.name not in fitting]


def regions_among(inputs: Mapping[str, Artifact], space: SpaceWarp) -> dict[str, Marked]:
    """Return the regions among a stage's inputs, by name; BadInput if one divides another space than the field's."""
    found = {}
    for artifact in (one for role, one in inputs.items() if role.startswith(ROLE)):
        region, own = load_region(artifact)
        if own != space:
            raise BadInput(
                f"region {artifact.name} was selected on a different field; select it again: stylerf select "
                f"{artifact.path.parent.parent}"
            )
        found[artifact.name] = Marked(region.edit, artifact.digest)
    return found


def channels_of(names: Iterable[str]) -> dict[str, str]:
    """Return what follows `mask.` in each region's channel: its name in letters, digits and `_`, not starting with a
    digit.

    A dot would create a sublayer, and compositors read `+` and `-` as arithmetic. Regions that would share a channel
    are numbered; a region whose name is already a valid channel name keeps it.
    """
    channels: dict[str, str] = {}
    written = {name: re.sub(r"^(?=\d)|[^A-Za-z0-9_]", "_", name) for name in names}
    for name in sorted(written, key=lambda one: (one != written[one], one)):
        channel, number = written[name], 2
        while channel in channels.values():
            channel, number = f"{written[name]}_{number}", number + 1
        channels[name] = channel
    return channels


def _space(artifact: Artifact, description: str) -> SpaceWarp:
    data = artifact.json(description)
    with sound(artifact.path / description, "a valid space"):
        return SpaceWarp.restore(validation.entry(data, "space"))
