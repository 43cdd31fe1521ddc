"""Edit datasets on disk: numbers that cannot be are refused before anything is computed with them."""

import numpy as np
import pytest

from schemas.errors import ArtifactDamaged
from schemas.tensors import load_tensors, save_tensors
from schemas.work_folder import Artifact, WorkFolder
from stages.artifacts.edit import DATASET_NUMBERS, color_name, load_edit_views
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
    with pytest.raises(ArtifactDamaged, match="whose length is not 1"):
        load_edit_views(Artifact(path))


@pytest.mark.parametrize(
    ("color", "name"),
    [
        ("1e3c92", "dark blue"), ("317ccb", "blue"), ("0000ff", "dark blue"), ("800080", "dark violet"),
        ("ff1493", "pink"), ("ffc0cb", "light pink"), ("ff0000", "red"), ("8b4513", "brown"), ("ff8000", "orange"),
        ("ffff00", "light yellow"), ("2e8b57", "green"), ("008080", "cyan"), ("000000", "black"), ("ffffff", "white"),
        ("808080", "gray"),
    ],
)  # fmt: skip
def test_palette_colors_are_called_what_people_call_them(color, name):
    assert color_name(np.frombuffer(bytes.fromhex(color), np.uint8) / 255) == name
