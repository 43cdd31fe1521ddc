"""Change the colors and weights of a learned palette, without training (LAENeRF, 3.5)."""

import shutil

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import (
    PALETTE,
    Edit,
    by_column,
    changes_of,
    columns_and_shares,
    kept_details,
    load_edit,
    save_edit,
)
from stages.configs.edit import PaletteConfig
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.errors import InvalidValue

SPEC = Spec(stage="edit_palette", verb="stylize", revision=3, writes="edit")


def run(inputs: dict[str, Artifact], config: PaletteConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the same module with the changes; return the figures."""
    learned = inputs["edit"]
    edit = load_edit(learned)
    columns, shares = columns_and_shares(learned, len(edit.module.palette))
    changes = changes_of(config, edit.module.palette[columns], np.array(shares)[columns])
    try:
        changes.check(len(columns))
    except InvalidValue as error:
        raise BadInput(f"{learned.path}: {error}; see {learned.path / PALETTE}") from error
    totals = kept_details(learned, changes)
    save_edit(partial.path, Edit(edit.module, by_column(changes, columns)), shares, totals)
    if learned.has("style.png"):
        shutil.copyfile(learned.file("style.png"), partial.path / "style.png")
    return {"learned": learned.name, "changes": changes.describe(), **totals}
