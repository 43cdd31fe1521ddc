"""Edit datasets on disk: numbers that cannot be are refused before anything is computed with them."""

import pytest

from schemas.errors import ArtifactDamaged
from schemas.tensors import load_tensors, save_tensors
from schemas.work_folder import Artifact, WorkFolder
from stages.artifacts.edit import DATASET_NUMBERS, load_edit_views
from tests.resealing import reseal
from tests.stages.every_artifact import every_artifact


def test_directions_that_are_not_of_unit_length_are_refused(tmp_path):
    path = every_artifact(WorkFolder(tmp_path / "work"))["edit-dataset"].artifact.path
    load_edit_views(Artifact(path))
    arrays, _ = load_tensors(path / DATASET_NUMBERS)
    arrays["1.directions"][2] *= 1e30
    (path / DATASET_NUMBERS).unlink()
    save_tensors(path / DATASET_NUMBERS, arrays)
    reseal(path)
    with pytest.raises(ArtifactDamaged, match="not of length 1"):
        load_edit_views(Artifact(path))
