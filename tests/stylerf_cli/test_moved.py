"""Photos and paintings that lie elsewhere, or were written again, are the same: what was made of them stands."""

import shutil

import numpy as np

from schemas.images import read_image, to_uint8, write_png
from schemas.work_folder import WorkFolder
from stages.pipeline.demo_scene import PAINTING
from stylerf_cli.main import main
from tests.stylerf_cli.conftest import STYLIZE


def digests(work) -> dict[str, str]:
    return {f"{one.kind} {one.name}": one.digest for one in WorkFolder(work).artifacts()}


def test_what_was_made_of_photos_stands_where_they_are_moved(work, photos, tmp_path, capsys):
    before, moved = digests(work), tmp_path / "another mount" / "photos"
    shutil.copytree(photos, moved, copy_function=shutil.copyfile)  # which copies no times
    (moved / "import.json").write_text("{}")
    write_png(moved / "sketch.png", np.zeros((8, 8, 3), np.uint8))
    assert main(["import", str(moved), str(work)]) == 0
    assert "scene main is up to date" in capsys.readouterr().err
    assert main(["stylize", str(work), "--style", str(moved / PAINTING), *STYLIZE]) == 0
    notes = capsys.readouterr().err
    assert "field painting-arf is up to date" in notes and "stylerf fit" not in notes
    assert digests(work) == before
    photo = moved / "train" / "train_000.png"
    write_png(photo, to_uint8(read_image(photo).pixels * [0.5, 1, 1, 1]))
    assert main(["import", str(moved), str(work)]) == 0
    assert "is up to date" not in capsys.readouterr().err
    assert digests(work)["scene main"] != before["scene main"]
