"""Change a learnt palette: other colours, more or less of them, nothing trained (LAENeRF, 3.5)."""

import json
import shutil

from schemas.errors import BadInput
from schemas.store import Artefact, Partial
from stages.configs.edit import PaletteConfig, colour_of, number_of
from stages.edits import PALETTE, Edit, load_edit, save_edit, shares_of
from stages.progress import Context
from stages.runner import Spec
from stylerf.editing.edits import PaletteEdits
from stylerf.errors import InvalidValue

SPEC = Spec(stage="edit_palette", verb="stylize", revision=1, writes="edit")


def run(inputs: dict[str, Artefact], config: PaletteConfig, partial: Partial, context: Context) -> dict:
    """Writes the same module with the changes; returns the figures."""
    learnt = inputs["edit"]
    edit = load_edit(learnt)
    changes = changes_of(config)
    try:
        changes.check(len(edit.module.palette))
    except InvalidValue as error:
        raise BadInput(f"{learnt.path}: {error}; see {learnt.path / PALETTE}") from error
    told = json.loads(learnt.file(PALETTE).read_text())
    told.pop("colours")
    save_edit(partial.path, Edit(edit.module, changes), shares_of(learnt), told)
    if (learnt.path / "style.png").is_file():
        shutil.copyfile(learnt.path / "style.png", partial.path / "style.png")
    return {"learnt": learnt.name, "changes": changes.describe(), **told}


def changes_of(config: PaletteConfig) -> PaletteEdits:
    """The changes that a config asks for."""
    return PaletteEdits(
        dict(map(colour_of, config.palette)),
        dict(map(number_of, config.palette_weight)),
        dict(map(number_of, config.palette_bias)),
    )
