"""`stylerf fit` in two processes: the same artifact, one voice; a process that dies ends it in one line."""

import json
import signal
import time

import pytest

from schemas.work_folder import WorkFolder
from tests.processes import ended, start
from tests.stylerf_cli.long_stages import timeless

FIT = ("--capacity", "fixed:32x8x8", "--samples", "3000", "--no-buffers", "--held-out", "2")


@pytest.fixture
def scene(in_memory, nursery, photos, tmp_path):
    """A work folder with a scene and nothing else."""
    command = nursery.run(tmp_path, "import", photos, tmp_path / "work", "--quiet")
    assert command.code == 0, command.err
    return tmp_path / "work"


def command(work, steps: int, *more: str) -> tuple[str, ...]:
    return "stylerf_cli.main", "fit", str(work), "--budget", str(steps), *FIT, *more


def test_two_processes_make_the_artifact_of_one(scene, nursery, tmp_path):
    processes = start(2, *command(scene, 30, "--name", "two", "--json"), folder=tmp_path)
    assert ended(processes, 200) == [0, 0], (tmp_path / "err0").read_text()
    assert json.loads((tmp_path / "out0").read_text())["name"] == "two"
    assert (tmp_path / "out1").read_text() == (tmp_path / "err1").read_text() == ""
    one = nursery.run(tmp_path / "one", *command(scene, 30, "--name", "one", "--threads", "2")[1:])
    assert one.code == 0, one.err
    fields = [WorkFolder(scene).get("field", name) for name in ("one", "two")]
    assert len({artifact.manifest.recipe for artifact in fields}) == 1
    assert len({artifact.file("field.safetensors").read_bytes() for artifact in fields}) == 1
    assert timeless(fields[0].manifest.figures) == timeless(fields[1].manifest.figures)


def test_a_process_that_dies_ends_the_run_in_a_line_and_resumably(scene, nursery, tmp_path):
    more = ("--checkpoint-every-seconds", "0.2", "--quiet")
    processes = start(2, *command(scene, 100_000, *more), folder=tmp_path)
    saved = scene / "field/.fit.partial/checkpoint"
    end = time.monotonic() + 200
    while not list(saved.glob("0*.safetensors")) and time.monotonic() < end:
        time.sleep(0.05)
    assert list(saved.glob("0*.safetensors")), (tmp_path / "err0").read_text()
    processes[1].send_signal(signal.SIGKILL)
    assert ended(processes, 60) == [5, -signal.SIGKILL]
    reported = (tmp_path / "err0").read_text().splitlines()
    assert len(reported) == 1 and reported[0].startswith("stylerf: error: another process of this run has ended;"), (
        reported
    )
    assert (
        list(saved.glob("0*.safetensors"))
        and not (scene / "field/fit").exists()
        and (tmp_path / "err1").read_text() == ""
    )


@pytest.mark.slow
def test_what_stands_is_not_made_again_and_every_process_knows(scene, tmp_path):
    for reported in ("30 steps", "is up to date"):
        processes = start(2, *command(scene, 30), folder=tmp_path)
        assert ended(processes, 200) == [0, 0]
        said = (tmp_path / "out0").read_text() + (tmp_path / "err0").read_text()
        assert reported in said and (tmp_path / "err1").read_text() == ""


@pytest.mark.slow
def test_a_fault_of_a_process_that_is_silent_is_reported_by_the_first(scene, tmp_path, monkeypatch):
    """The second finds no scene, as on a machine that does not share the work folder."""
    (tmp_path / "elsewhere").mkdir()
    first = ("tests.stylerf_cli.elsewhere", *command(scene, 100_000, "--quiet")[1:])
    monkeypatch.setenv("STYLERF_TEST_ELSEWHERE", str(tmp_path / "elsewhere"))
    processes = start(2, *first, folder=tmp_path)
    codes = ended(processes, 100)
    reported = (tmp_path / "err0").read_text().splitlines()
    assert codes[0] == 5 and codes[1] != 0 and len(reported) == 1, reported
    assert "(process 1: ArtifactStale:" in reported[0] and "elsewhere" in reported[0]
    assert (tmp_path / "err1").read_text() == ""


def test_processes_that_find_no_gpu_end_at_once_and_say_so(scene, tmp_path):
    processes = start(2, *command(scene, 30, "--device", "cuda"), folder=tmp_path)
    assert ended(processes, 100) == [2, 2]
    reported = (tmp_path / "err0").read_text().splitlines()
    assert len(reported) == 1 and reported[0].startswith("stylerf: error: --device cuda: torch finds no usable GPU"), (
        reported
    )
    assert (tmp_path / "err1").read_text() == ""


def test_verbs_of_one_process_say_so(tmp_path):
    processes = start(2, "stylerf_cli.main", "render", str(tmp_path / "work"), folder=tmp_path)
    assert ended(processes, 60) == [2, 2]
    assert "without torchrun (fit and finetune run in several)" in (tmp_path / "err0").read_text()
    assert (tmp_path / "err1").read_text() == ""
