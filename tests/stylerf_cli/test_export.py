"""`stylerf export`: what it makes, its names, and combinations of options that it refuses."""

import json

import pytest

from schemas.work_folder import WorkFolder
from stages.configs.export import FORMATS
from stylerf_cli.main import main


def test_a_mesh_of_a_fit_is_made_and_kept(work, capsys):
    command = ["export", str(work), "--of", "fit", "--as", "mesh", "--format", "glb,ply", "--resolution", "24"]
    assert main([*command, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["name"] == "fit-mesh" and made["figures"]["files"] == ["mesh.glb", "mesh.ply"]
    WorkFolder(work).get("export", "fit-mesh").verify()
    assert main(command) == 0
    assert "up to date" in capsys.readouterr().err


def test_cameras_need_no_field(work, capsys):
    assert main(["export", str(work), "--as", "cameras", "--path", "orbit", "--count", "3", "--format", "3dgs"]) == 0
    made = WorkFolder(work).get("export", "orbit-cameras")
    assert {ref.role for ref in made.manifest.inputs} == {"scene"}
    assert "3 cameras" in capsys.readouterr().out
    # And they are a path to render along, in the place where they were.
    path = str(made.path / "cameras.json")
    assert main(["render", str(work), "--of", "fit", "--path", path, "--scale", "0.5", "--quiet"]) == 0


@pytest.mark.parametrize(
    "options, said",
    [
        (["--as", "mesh", "--format", "fbx"], "'fbx' is unknown"),
        (["--as", "cameras", "--faces", "500"], "--faces has no effect"),
        (["--as", "cameras", "--path", "no/such/file"], "neither a known camera path nor an existing file"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(work, capsys, options, said):
    assert main(["export", str(work), *options]) in (2, 3)
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and said in lines[0]
    assert not list((work / "export").glob("*-*/")) if (work / "export").exists() else True


def test_the_help_names_every_kind_and_format(capsys):
    assert main(["export", "--help"]) == 0
    words = capsys.readouterr().out.replace(",", " ").replace(";", " ").replace(":", " ").split()
    assert {*FORMATS, *(name for names in FORMATS.values() for name in names)} <= set(words)
