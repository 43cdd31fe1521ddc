"""How requested stages and prerequisites are run, reused, announced and refused."""

import queue
from dataclasses import replace
from types import SimpleNamespace

import pytest

from schemas.errors import ArtifactStale, UsageError
from schemas.work_folder import WorkFolder
from stages.pipeline.distributed import agree
from stages.pipeline.stage_runner import DefaultOptions, Machine, Request, StageRunner
from stages.run.progress import Silent
from stages.run.runner import Spec
from stylerf.training.common.process_group import SINGLE_PROCESS
from tests.stages import toy_stage
from tests.stages.toy_stage import ToyConfig

UPSTREAM = Spec("pose_import", "import", 1, "scene")


class Heard(Silent):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)


def runner(folder, seed: int = 0, only: bool = False) -> StageRunner:
    machine = Machine("cpu", 1, 0)
    return StageRunner(WorkFolder(folder), seed, machine, Heard(), SINGLE_PROCESS, DefaultOptions(), only)


def test_prerequisites_are_announced_made_once_and_never_renamed(tmp_path):
    for request in (Request(), Request("den", force=True)):
        stages = runner(tmp_path)
        scene = stages.run(UPSTREAM, toy_stage.run, {}, ToyConfig(steps=3), "fox")
        field = stages.run(toy_stage.SPEC, toy_stage.run, {"scene": scene}, ToyConfig(), "fox", request)
        assert (scene.name, field.name) == ("fox", request.name or "fox")
        announced = any("running `stylerf import` first" in line for line in stages.progress.lines)
        assert announced == (not request.force)
    stages = runner(tmp_path)
    stages.run(toy_stage.SPEC, toy_stage.run, {"scene": scene}, ToyConfig(), "fox", Request())
    assert stages.progress.lines == ["field fox is up to date (--force rebuilds it)"]


def test_a_name_that_no_artifact_can_have_is_refused_at_once():
    with pytest.raises(UsageError, match="is not a valid name"):
        Request("../fox")


def test_what_an_older_revision_made_is_made_again(tmp_path):
    stages = runner(tmp_path)
    scene = stages.run(UPSTREAM, toy_stage.run, {}, ToyConfig(steps=3), "fox")
    stages.run(toy_stage.SPEC, toy_stage.run, {"scene": scene}, ToyConfig(), "fox", Request())
    assert stages.reusable(toy_stage.SPEC, scene).name == "fox"
    assert stages.reusable(replace(toy_stage.SPEC, revision=toy_stage.SPEC.revision + 1), scene) is None


def test_default_names_of_any_length_are_made_valid(tmp_path):
    made = runner(tmp_path).run(UPSTREAM, toy_stage.run, {}, ToyConfig(steps=3), "x" * 130, Request())
    assert len(made.name) == 100


def test_only_refuses_missing_prerequisites_with_their_command(tmp_path):
    with pytest.raises(ArtifactStale, match=f"stylerf import {tmp_path}"):
        runner(tmp_path, only=True).run(UPSTREAM, toy_stage.run, {}, ToyConfig(), "fox")
    assert not list(tmp_path.iterdir())
    runner(tmp_path).run(UPSTREAM, toy_stage.run, {}, ToyConfig(), "fox")
    stages = runner(tmp_path, only=True)
    stages.run(UPSTREAM, toy_stage.run, {}, ToyConfig(), "fox")
    stages.run(toy_stage.SPEC, toy_stage.run, {}, ToyConfig(), "fox", Request())
    assert [one.kind for one in stages.work.artifacts()] == ["scene", "field"]


def test_only_names_options_seed_and_a_quoted_folder(tmp_path):
    stages = runner(tmp_path / "a folder", seed=7, only=True)
    with pytest.raises(ArtifactStale) as caught:
        stages.run(UPSTREAM, toy_stage.run, {}, ToyConfig(steps=3), "fox", by=("--of", "den"))
    folder = f"'{tmp_path}/a folder'"
    assert str(caught.value).endswith(f"run: stylerf import {folder} --name fox --of den --steps 3 --seed 7")


def test_several_processes_use_what_the_first_one_finds():
    """Here the second looks after the first has made what it did not find."""
    reported = queue.SimpleQueue()
    first = SimpleNamespace(count=2, first=True, tell=lambda text: reported.put(text) or text)
    second = SimpleNamespace(count=2, first=False, tell=lambda text: reported.get_nowait())
    assert agree(first, lambda: "") == ""
    assert agree(second, lambda: "fox") == ""
    assert agree(first, lambda: "fox") == "fox"
    assert agree(second, lambda: "") == "fox"
    assert agree(SINGLE_PROCESS, lambda: "den") == "den"
