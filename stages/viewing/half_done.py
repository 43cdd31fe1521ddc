"""A stylization in progress, from its newest checkpoint: its current look and its steps."""

from dataclasses import replace
from typing import Any

import numpy as np

from schemas.errors import StylerfError
from schemas.work_folder import WorkFolder
from stages.artifacts.edit import Edit
from stages.configs.stylize import StylizeConfig
from stages.run.training_loop import load_checkpoint
from stages.viewing.shown import Source
from stylerf.editing.palette_module import PaletteModule
from stylerf.errors import InvalidValue
from stylerf.fields.hash_grid import HashColor
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.training.stylize.scene import COLOR, FINEST
from stylerf.training.stylize.settings import STYLE
from stylerf.validation import LEARNED, entry

BASE_CELLS = 16  # cells per side of the coarsest level of new colors; runs started by the page use the stage's sizes


def half_done(work: WorkFolder, name: str, source: Source) -> Source | None:
    """Return the field that a stylization of `source` has reached; None before its first checkpoint.

    Also None if the colors are not of the kind used for whole scenes, or a file is damaged or being replaced.

    Args:
        name: of the field in progress.
    """
    found = _checkpoint(work, name, "field")
    if found is None or not {COLOR, FINEST} <= found[1].keys():
        return None
    values, finest = found[1][COLOR], found[1][FINEST]
    sound = values.dtype == np.float32 and values.ndim == 1 and finest.shape == (1,) and 16 <= finest[0] <= 4096
    if not sound or not np.isfinite(values).all() or np.abs(values).max(initial=0) > LEARNED:
        return None
    try:
        color = HashColor(
            StylizeConfig.levels, BASE_CELLS, int(finest[0]), 1 << StylizeConfig.table_bits, values.copy()
        )
    except InvalidValue:
        return None
    return replace(source, field=replace(source.field, color=color, color_map=None))


def half_learned(work: WorkFolder, name: str) -> Edit | None:
    """Return the edit that the stylization of a region has reached; None without a valid checkpoint.

    Args:
        name: of the edit in progress.
    """
    found = _checkpoint(work, name, "edit")
    if found is None:
        return None
    arrays = {key.removeprefix("module."): values for key, values in found[1].items() if key.startswith("module.")}
    try:
        return Edit(PaletteModule.restore(entry(found[0], "module"), arrays), PaletteEdits())
    except (InvalidValue, ValueError, KeyError, TypeError):
        return None


def steps_done(work: WorkFolder, name: str) -> int | None:
    """Return the number of style steps of an interrupted stylization of a whole scene; None before the first."""
    found = _checkpoint(work, name, "field")
    state = found[0].get("state") if found is not None else None
    if not isinstance(state, dict) or state.get("phase") != STYLE:
        return None
    step = state.get("step")
    return step if isinstance(step, int) and step > 0 else None


def _checkpoint(work: WorkFolder, name: str, kind: str) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Return the newest checkpoint of an artifact in progress; None without one, or if it cannot be read."""
    try:
        return load_checkpoint(work.root / kind / f".{name}.partial" / "checkpoint", lambda text: None)
    except (OSError, StylerfError):
        return None
