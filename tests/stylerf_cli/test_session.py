"""How a verb's own stage and the stages before it are run, and which device is chosen."""

import argparse
import os
import queue
import subprocess
import sys
from types import SimpleNamespace

import pytest

from schemas.errors import ArtifactStale, UsageError
from schemas.read_limit import LEAST, allowance
from stages.pipeline.distributed import agreed
from stages.run.memory import free
from stages.run.runner import Spec
from stylerf_cli import session as sessions
from stylerf_cli.arguments import Parser, add_common
from stylerf_cli.options import Options
from stylerf_cli.session import Session
from tests.conftest import REPOSITORY
from tests.stages import toy_stage
from tests.stages.toy_stage import ToyConfig

UPSTREAM = Spec("pose_import", "import", 1, "scene")


def session(tmp_path, *flags) -> Session:
    parser = Parser(prog="stylerf toy")
    parser.add_argument("work")
    add_common(parser)
    args: argparse.Namespace = parser.parse_args([str(tmp_path), "--device", "cpu", *flags])
    return Session("toy", args, Options("toy", args, ["toy"]), None)


def test_earlier_stages_are_announced_made_once_and_never_forced_or_named(tmp_path, capsys):
    for flags in ((), ("--force", "--name", "den")):
        given = session(tmp_path, *flags)
        scene = given.run(UPSTREAM, toy_stage.run, {}, ToyConfig(steps=3), "fox")
        field = given.run(toy_stage.SPEC, toy_stage.run, {"scene": scene}, ToyConfig(), "fox")
        assert (scene.name, field.name) == ("fox", "den" if flags else "fox")
        told = capsys.readouterr().err
        assert ("running `stylerf import` first" in told) == (not flags)
    session(tmp_path).run(toy_stage.SPEC, toy_stage.run, {"scene": scene}, ToyConfig(), "fox")
    assert capsys.readouterr().err == "field fox stands up to date (--force makes it anew)\n"


def test_several_processes_go_by_what_the_first_one_finds(tmp_path):
    """Here the second looks when the first has made what it did not find."""
    made = session(tmp_path).run(UPSTREAM, toy_stage.run, {}, ToyConfig(steps=3), "fox")
    told = queue.SimpleQueue()

    first, second = (SimpleNamespace(work=session(tmp_path).work) for _ in range(2))
    first.ranks = SimpleNamespace(count=2, first=True, tell=lambda text: told.put(text) or text)
    second.ranks = SimpleNamespace(count=2, first=False, tell=lambda text: told.get_nowait())
    assert agreed(first, "scene", lambda: None) is None
    assert agreed(second, "scene", lambda: made) is None
    assert agreed(first, "scene", lambda: made) is not None
    assert agreed(second, "scene", lambda: None).digest == made.digest
    assert agreed(session(tmp_path), "scene", lambda: made) is made


def test_only_refuses_to_make_earlier_stages_with_the_command_that_does(tmp_path):
    with pytest.raises(ArtifactStale, match=f"stylerf import {tmp_path}"):
        session(tmp_path, "--only").run(UPSTREAM, toy_stage.run, {}, ToyConfig(), "fox")
    assert not list(tmp_path.iterdir())
    session(tmp_path).run(UPSTREAM, toy_stage.run, {}, ToyConfig(), "fox")
    session(tmp_path, "--only").run(UPSTREAM, toy_stage.run, {}, ToyConfig(), "fox")
    session(tmp_path, "--only").run(toy_stage.SPEC, toy_stage.run, {}, ToyConfig(), "fox")


def test_only_names_the_whole_command_with_options_seed_and_a_folder_of_two_words(tmp_path):
    given = session(tmp_path / "a folder", "--only", "--seed", "7")
    with pytest.raises(ArtifactStale) as caught:
        given.run(UPSTREAM, toy_stage.run, {}, ToyConfig(steps=3), "fox", by=("--of", "den"))
    folder = f"'{tmp_path}/a folder'"
    assert str(caught.value).endswith(f"run: stylerf import {folder} --name fox --of den --steps 3 --seed 7")


def test_quiet_says_nothing(tmp_path, capsys):
    session(tmp_path, "--quiet").run(UPSTREAM, toy_stage.run, {}, ToyConfig(), "fox")
    assert capsys.readouterr() == ("", "")


def test_cuda_that_is_not_there_is_a_usage_fault():
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    assert sessions.resolved_device("auto") == "cpu"
    with pytest.raises(UsageError, match="--device cpu"):
        sessions.resolved_device("cuda")


def test_more_processes_than_gpus_compute_on_the_cpu_or_are_refused(monkeypatch):
    import torch

    monkeypatch.setattr(sessions, "_may_have_gpu", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    for count in ("2", "3"):
        said = []
        for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"):
            monkeypatch.setenv(name, count)
        monkeypatch.setenv("RANK", "0")
        assert sessions.resolved_device("auto", said.append) == ("cuda" if count == "2" else "cpu")
        assert [line.startswith("computing on the CPU: 3 processes") for line in said] == [True] * (count == "3")
    assert torch.backends.cudnn.allow_tf32 is False
    with pytest.raises(UsageError, match=r"3 processes on this machine.* find 2; start 2 here"):
        sessions.resolved_device("cuda")
    monkeypatch.delenv("RANK")  # of no launcher
    assert sessions.resolved_device("cuda") == "cuda"


def test_auto_does_not_import_torch_where_no_gpu_can_be(monkeypatch):
    monkeypatch.setattr(os.path, "exists", lambda path: False)
    monkeypatch.setitem(sys.modules, "torch", None)  # an import would raise
    assert sessions.resolved_device("auto") == "cpu"


def test_threads_reach_libraries_that_are_imported_later():
    code = (
        "from stylerf_cli.session import _use_threads; _use_threads(1)\n"
        "import os, numba; print(os.environ['OMP_NUM_THREADS'], numba.get_num_threads())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert done.stdout == "1 1\n"


def test_fewer_threads_once_numba_runs_do_not_hinder_its_compiler():
    code = (
        "import numba; numba.set_num_threads(2)\n"
        "from stylerf_cli.session import _use_threads; _use_threads(1)\n"
        "print(numba.njit(lambda x: x + 1)(1), numba.get_num_threads())"
    )
    ours = {"NUMBA_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY, env=os.environ | ours
    )
    assert done.stdout == "2 1\n"


def test_one_picture_may_take_what_the_run_may(tmp_path):
    session(tmp_path, "--memory", "50G")
    assert 40e9 < allowance() <= 50e9
    session(tmp_path, "--memory", "256M")
    assert allowance() == LEAST  # the program alone has taken more, and a photo must be read all the same
    session(tmp_path)
    assert LEAST <= allowance() < free()
