"""Every kind of field through every stage: fit, stylize, a local edit from selection to fine-tuning, pictures."""

import json
from pathlib import Path

import numpy as np
import pytest

from schemas.images import read_image
from schemas.work_folder import WorkFolder
from stages.artifacts.field import load_field
from stages.artifacts.scene import load_scene
from stages.pipeline.demo_scene import PAINTING
from stylerf_cli.main import main
from tests.stylerf_cli.conftest import STYLIZE

PALETTE = ("--palette-steps", "40", "--pruned-steps", "10", "--colors", "3", "--max-colors", "2")
FIELDS = {
    "vm": ("vm", "linear"),
    "hash": ("hash", "linear"),
    "voxel": ("voxel", "linear"),
    "vm+hash with a network": ("vm+hash", "mlp"),
}


def said(capsys, *arguments: object) -> dict:
    """The --json object of one command that must succeed."""
    assert main([*map(str, arguments), "--json", "--quiet"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def fitted(capsys, photos: Path, work: Path, field: str, head: str, budget: int) -> dict:
    said(capsys, "import", photos, work)
    return said(capsys, "fit", work, "--field", field, "--head", head, "--budget", budget, "--no-buffers",
                "--capacity", "fixed:32x8x8", "--samples", "8000")  # fmt: skip


def rendered(capsys, work: Path, name: str) -> np.ndarray:
    """[views, h, w, channels]: the test views of a field."""
    said(capsys, "render", work, "--of", name, "--path", "test")
    folder = work / "frames" / f"{name}-test" / "png"
    return np.stack([read_image(path).pixels for path in sorted(folder.glob("*.png"))])


def middle_of(work: Path) -> str:
    """VIEW:X,Y of the most saturated pixel in the middle of the first training view: one of the objects."""
    scene = load_scene(WorkFolder(work).artifacts("scene")[0])
    view = scene.splits["train"][0]
    rgb = scene.images(view)[..., :3]
    saturation = (rgb.max(2) - rgb.min(2))[9:23, 9:23]
    row, column = np.unravel_index(saturation.argmax(), saturation.shape)
    return f"{scene.views[view].name}:{column + 9},{row + 9}"


def test_a_hash_field_is_fitted_reported_about_and_rendered(photos, tmp_path, capsys):
    work = tmp_path / "work"
    result = fitted(capsys, photos, work, "hash", "linear", 40)
    assert result["figures"]["kinds"] == ["hash", "hash", "linear"] and result["figures"]["density_rank"] is None
    assert len(rendered(capsys, work, "fit")) == 2
    field, _ = load_field(WorkFolder(work).get("field", "fit"))
    assert (field.density.kind, field.color.features.kind) == ("hash", "hash")
    assert result["figures"]["parameters"] == field.parameters


@pytest.mark.slow
@pytest.mark.parametrize("name", FIELDS)
def test_every_stage_works_with_it(name, photos, tmp_path, capsys):
    work, (kind, head) = tmp_path / "work", FIELDS[name]
    fitted(capsys, photos, work, kind, head, 400)
    plain = rendered(capsys, work, "fit")
    truth = [read_image(path).pixels for path in sorted((photos / "test").glob("*.png"))]
    over = np.stack([p[..., :3] * p[..., 3:] + 1 - p[..., 3:] for p in truth])
    blank, found = (-10 * np.log10(np.mean((p[..., :3] - over) ** 2)) for p in (np.ones_like(plain), plain))
    assert found > blank + 4

    said(capsys, "stylize", work, "--style", photos / PAINTING, "--method", "arf", *STYLIZE)
    assert np.abs(rendered(capsys, work, "painting-arf") - plain).mean() > 0.01
    density = load_field(WorkFolder(work).get("field", "painting-arf"))[0].density
    assert density.kind == kind.split("+")[0]

    said(capsys, "deform", work, "--of", "fit", "--steps", "10", "--vertices", "12", "--width", "16")
    said(capsys, "stylize", work, "--of", "fit-deformed", "--style", photos / PAINTING, "--method", "desrf", *STYLIZE)

    said(capsys, "select", work, "--of", "fit", "--at", middle_of(work), "--reach", 0.6, "--name", "part")
    said(capsys, "extract", work, "--region", "part")
    said(capsys, "stylize", work, "--region", "part", "--recolor", "--palette", "0=#10e020", "--name", "part", *PALETTE)
    said(capsys, "distill", work, "--edit", "part")
    said(capsys, "finetune", work, "--edit", "part", "--budget", "40", "--rays", "512")
    change = np.abs(rendered(capsys, work, "part") - plain)[..., :3].max(-1)
    assert (change > 0.1).any() and np.median(change) < 0.05
    assert main(["verify", str(work), "--quiet"]) == 0
