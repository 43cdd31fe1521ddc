"""`stylerf stylize`: what is made of a painting is called after it, and replaces nothing without a word."""

import numpy as np
import pytest

from schemas.images import write_png
from schemas.work_folder import WorkFolder
from stages import stylize
from stylerf_cli.main import main
from tests.stages import evaluation_fixture as made


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A scene and its field; what would stylize it writes a file alone."""
    work = WorkFolder(tmp_path / "work")
    made.make_field(work, "fit", "nerf_fit", {"scene": made.make_scene(work, [-0.2, 0.2])})

    def run(inputs, config, partial, context):
        (partial.path / "field.bin").write_bytes(b"")
        return {"steps": 1, "views": 2, "train_seconds": 0.0, "features": {"name": "none"}}

    monkeypatch.setattr(stylize, "run", run)
    return work


def painting(path, level: int):
    """A file of one gray."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.full((16, 16, 3), level, np.uint8))
    return path


def stylized(work, capsys, style, *flags) -> str:
    """What is said on stderr."""
    assert main(["stylize", str(work.root), "--style", str(style), "--of", "fit", *flags]) == 0
    return capsys.readouterr().err


def names(work) -> set[str]:
    return {one.name for one in work.artifacts("field")} - {"fit"}


def test_fields_are_called_after_the_painting_and_the_method(work, tmp_path, capsys):
    for level, name in enumerate(("starry night.jpg.png", "-wave.png", "1889.png")):
        stylized(work, capsys, painting(tmp_path / name, level))
    assert names(work) == {"starry_night.jpg-arf", "wave-arf", "1889-arf"}


def test_paintings_without_a_letter_of_ascii_get_names_apart(work, tmp_path, capsys):
    for level, name in enumerate(("星月夜.png", "神奈川沖浪裏.png")):
        assert "replaced" not in stylized(work, capsys, painting(tmp_path / name, level))
    assert len(names(work)) == 2 and all(name.startswith("style-") for name in names(work))


def test_long_names_are_cut_and_stay_apart(work, tmp_path, capsys):
    long = "The_Shipwreck_of_the_Minotaur_1805_1810_oil_on_canvas_172_x_241_cm_Calouste_Gulbenkian_Museum_Lisbon"
    for level, name in enumerate((f"{long}_a.png", f"{long}_b.png")):
        assert "replaced" not in stylized(work, capsys, painting(tmp_path / name, level))
    assert len(names(work)) == 2 and all(len(name) <= 64 and name.startswith(long[:50]) for name in names(work))


def test_other_weights_make_the_field_again(work, tmp_path, capsys, monkeypatch):
    style = painting(tmp_path / "night.png", 0)
    stylized(work, capsys, style, "--features", "st-vgg16")
    assert "up to date" in stylized(work, capsys, style, "--features", "st-vgg16")
    monkeypatch.setattr("stages.weights.resolve.describe", lambda: [{"name": "st-vgg16", "chosen": True}])
    assert "up to date" in stylized(work, capsys, style)
    monkeypatch.setattr("stages.weights.resolve.describe", lambda: [{"name": "hed-vgg16", "chosen": True}])
    assert "up to date" not in stylized(work, capsys, style)


def test_that_the_field_of_another_painting_is_replaced_is_said(work, tmp_path, capsys):
    one, other = (painting(tmp_path / folder / "night.png", level) for level, folder in enumerate("ab"))
    assert "replaced" not in stylized(work, capsys, one) + stylized(work, capsys, one, "--budget", "9")
    said = stylized(work, capsys, other)
    assert "field night-arf was made with another style image and will be replaced; --name" in said
    assert "replaced" not in stylized(work, capsys, one, "--name", "night-of-a")
    assert names(work) == {"night-arf", "night-of-a"}
    (work.root / "field/night-arf/manifest.json").write_text("{}")  # one that nobody can read is made again
    assert "replaced" not in stylized(work, capsys, one)


def test_edited_fields_are_stylized_by_edited_photos_stylized_ones_never(work, tmp_path, capsys):
    fit, style = work.get("field", "fit"), painting(tmp_path / "night.png", 0)
    photos = made.commit(work, "scene", "vase-red", "distill", {"scene": work.artifacts("scene")[0]}, blank)
    made.make_field(work, "vase-red", "finetune", {"scene": photos, "field": fit})
    for of, scene in (("fit", "wall"), ("vase-red", "vase-red")):
        assert main(["stylize", str(work.root), "--style", str(style), "--of", of, "--name", f"of-{of}"]) == 0
        inputs = {ref.role: ref.name for ref in work.get("field", f"of-{of}").manifest.inputs}
        assert inputs == {"scene": scene, "field": of}
    capsys.readouterr()
    assert main(["stylize", str(work.root), "--style", str(style), "--of", "of-vase-red", "--name", "twice"]) == 2
    assert "the colors of field of-vase-red are not in the photos" in (reported := capsys.readouterr().err)
    assert "Start from --of vase-red," in reported


def blank(folder):
    (folder / "numbers").write_bytes(b"")
