"""What a session passes from the command line to the pipeline."""

import argparse

import pytest

from schemas.errors import ArtifactStale
from schemas.safe_reading import allowance
from stages.run.runner import Spec
from stylerf_cli.arguments import Parser, add_common
from stylerf_cli.session import Options, Session
from tests.stages import toy_stage
from tests.stages.toy_stage import ToyConfig

SCENE = Spec("pose_import", "import", 1, "scene")


def session(tmp_path, *flags) -> Session:
    parser = Parser(prog="stylerf toy")
    parser.add_argument("work")
    add_common(parser)
    args: argparse.Namespace = parser.parse_args([str(tmp_path), "--device", "cpu", *flags])
    return Session("toy", args, Options("toy", args, ["toy"]), None)


def test_seed_only_and_folder_reach_the_pipeline(tmp_path):
    pipeline = session(tmp_path / "work", "--seed", "7", "--only").pipeline
    assert pipeline.work.root == tmp_path / "work"
    with pytest.raises(ArtifactStale):
        pipeline.fit()
    made = pipeline.run(SCENE, toy_stage.run, {}, ToyConfig(steps=3), "fox")
    assert made.manifest.seed == 7


@pytest.mark.parametrize(("flags", "lines"), [((), 1), (("--quiet",), 0)])
def test_quiet_silences_notes(tmp_path, capsys, flags, lines):
    for _ in range(2):
        session(tmp_path, *flags).pipeline.run(SCENE, toy_stage.run, {}, ToyConfig(), "fox")
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("up to date") == lines


def test_memory_bounds_what_one_image_may_take(tmp_path):
    session(tmp_path, "--memory", "50G")
    assert 40e9 < allowance() <= 50e9
