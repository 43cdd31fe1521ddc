"""The field of a stylization in progress, from its newest checkpoint: to look at while it trains."""

from dataclasses import replace

import numpy as np

from schemas.errors import StylerfError
from schemas.work_folder import WorkFolder
from stages.configs.stylize import StylizeConfig
from stages.run.training_loop import load_checkpoint
from stages.viewing.shown import Source
from stylerf.errors import InvalidValue
from stylerf.fields.hash_grid import HashColor
from stylerf.training.stylize.scene import COLOR, FINEST
from stylerf.validation import LEARNED

BASE_CELLS = 16  # of new colors, a side of the coarsest level; those that the page starts have the stage's own sizes


def half_done(work: WorkFolder, name: str, source: Source) -> Source | None:
    """Return the field that a stylization of `source` has reached; None before its first checkpoint.

    None too where colors are of another kind than those of a whole scene, or a file is damaged or just being replaced.

    Args:
        name: of the field in progress.
    """
    try:
        found = load_checkpoint(work.root / "field" / f".{name}.partial" / "checkpoint", lambda text: None)
    except (OSError, StylerfError):
        return None
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
