"""What a verb starts from: the scene, the field, and what is said of one that is out of date."""

import pytest

from schemas.work_folder import WorkFolder
from stylerf_cli.main import main
from tests.stages import evaluation_fixture as made


@pytest.fixture
def work(tmp_path) -> WorkFolder:
    """Field `wall` of scene `wall`, and a stylized one of it. Stand-ins: a stage that reads them stops."""
    work = WorkFolder(tmp_path / "work")
    scene = made.make_scene(work, [-0.2, 0.2], depth=False)
    field = made.make_field(work, "wall", "nerf_fit", {"scene": scene})
    made.make_field(work, "red", "stylize", {"scene": scene, "field": field})
    return work


@pytest.mark.parametrize(
    "arguments",
    [
        ("render",),
        ("render", "--of", "red"),
        ("deform", "--of", "red"),
        ("stylize", "--of", "red", "--method", "palettenerf"),
        ("select", "--of", "red", "--at", "0:1,1"),
        ("edit", "--of", "red", "--at", "0:1,1", "--recolor"),
    ],
    ids=" ".join,
)
def test_a_field_of_an_older_import_is_used_with_a_note_of_each_reason(work, capsys, arguments):
    verb, *flags = arguments
    main([verb, str(work.root), *flags])
    assert "out of date" not in capsys.readouterr().err
    made.make_scene(work, [-0.2, 0.0, 0.2], depth=False)
    main([verb, str(work.root), *flags])
    notes = [line for line in capsys.readouterr().err.splitlines() if "out of date" in line]
    assert sorted(notes) == [
        "field red is out of date: scene wall was rebuilt after field red",
        "field red is out of date: scene wall was rebuilt after field wall",
    ]
