"""A stylization in progress: the field of its newest checkpoint, and nothing where there is none to trust."""

import numpy as np
import pytest

from schemas.work_folder import WorkFolder
from stages.run.training_loop import save_checkpoint
from stages.viewing.half_done import BASE_CELLS, half_done, half_learned
from stages.viewing.library import Library
from stylerf.editing.palette_module import PaletteModule
from stylerf.fields.hash_grid import HashColor
from tests.stages.viewing.room import PALETTE, furnished


@pytest.fixture
def library(tmp_path):
    return Library(furnished(tmp_path / "work").root)


def checkpoint(work: WorkFolder, **arrays):
    folder = work.root / "field" / ".new.partial" / "checkpoint"
    folder.mkdir(parents=True, exist_ok=True)
    save_checkpoint(folder, {"state": {}}, arrays)


def test_the_newest_checkpoint_is_shown(library):
    source = library.source("plain")
    assert half_done(library.work, "new", source) is None
    made = [HashColor.create(np.random.default_rng(seed), 8, BASE_CELLS, 256, 1 << 19) for seed in (0, 1)]
    for one in made:
        checkpoint(library.work, color=one.values, finest=np.array([256]))
    shown = half_done(library.work, "new", source)
    assert shown is not None and shown.field.density is source.field.density
    np.testing.assert_array_equal(shown.field.color.values, made[1].values)
    assert (shown.field.color.finest, shown.field.color.base) == (256, BASE_CELLS)


@pytest.mark.parametrize("fault", ["", "nan", "missing"])
def test_a_regions_edit_is_shown_as_it_has_been_learned_so_far(library, fault):
    made = PaletteModule.create(np.random.default_rng(0), PALETTE, np.float32([[0, 0, 0], [1, 1, 1]]))
    made.active = np.array([True, False, True, True])
    arrays = {f"module.{key}": values.copy() for key, values in made.arrays().items()}
    if fault == "nan":
        arrays["module.networks"][2] = np.nan
    elif fault == "missing":
        del arrays["module.table"]
    folder = library.work.root / "edit" / ".new.partial" / "checkpoint"
    folder.mkdir(parents=True)
    assert half_learned(library.work, "new") is None
    save_checkpoint(folder, {"state": {}, "module": made.describe()}, {**arrays, "active": made.active})
    found = half_learned(library.work, "new")
    assert (found is None) == bool(fault)
    if found is not None:
        x, toward = np.random.default_rng(1).random((2, 50, 3)).astype(np.float32)
        np.testing.assert_array_equal(found.module.colors(x, toward), made.colors(x, toward))


@pytest.mark.parametrize("fault", ["nan", "length", "finest", "kind"])
def test_numbers_that_make_no_colors_are_not_shown(library, fault):
    values = HashColor.create(np.random.default_rng(0), 8, BASE_CELLS, 256, 1 << 19).values
    finest = np.array([256])
    if fault == "nan":
        values[3] = np.nan
    elif fault == "length":
        values = values[:-1].copy()
    elif fault == "finest":
        finest = np.array([10**9])
    else:
        values = values.astype(np.float64)
    checkpoint(library.work, color=values, finest=finest)
    assert half_done(library.work, "new", library.source("plain")) is None
