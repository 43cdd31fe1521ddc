"""What stages do with a trainer: checkpoints every so often and at Ctrl-C, a fault in words; a toy learns nothing."""

import errno
import os
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged, BadInput
from schemas.tensors import save_tensors_with_digest
from stages.run import training_loop
from stages.run.progress import Context, Silent
from stages.run.training_loop import load_checkpoint, run_training, save_checkpoint
from stylerf.errors import Diverged


def save(folder, step):
    save_checkpoint(folder, {"step": step}, {"values": np.full(1000, step, np.float32), "more": np.arange(step)})


def flip(path, at):
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


def files(folder):
    return sorted(folder.iterdir(), reverse=True)


def test_the_last_two_are_kept_and_named_by_what_they_hold(tmp_path):
    for step in range(1, 5):
        save(tmp_path, step)
    kept = files(tmp_path)
    assert [path.name[:6] for path in kept] == ["000004", "000003"]
    assert all(file_sha256(path) == path.stem[7:] for path in kept)
    data, arrays = load_checkpoint(tmp_path, pytest.fail)
    assert data == {"step": 4} and arrays["values"].tolist() == [4] * 1000 and len(arrays["more"]) == 4


def test_a_checkpoint_without_a_state_is_damaged(tmp_path):
    digest = save_tensors_with_digest(tmp_path / "x", {"values": np.ones(3)}, {})
    (tmp_path / "x").rename(tmp_path / f"000001-{digest}.safetensors")
    with pytest.raises(ArtifactDamaged):
        load_checkpoint(tmp_path, pytest.fail)


@pytest.mark.parametrize("at", [3, 50, 2000, -1])
def test_a_flipped_bit_gives_way_to_the_one_before(tmp_path, at):
    save(tmp_path, 1)
    save(tmp_path, 2)
    flip(files(tmp_path)[0], at)
    said = []
    assert load_checkpoint(tmp_path, said.append)[0] == {"step": 1}
    assert len(said) == 1 and "000002" in said[0] and "using the one before it" in said[0]


def test_with_both_damaged_a_run_begins_again_and_says_so(tmp_path):
    save(tmp_path, 1)
    save(tmp_path, 2)
    for path in files(tmp_path):
        path.write_bytes(path.read_bytes()[:-1])
    said = []
    assert load_checkpoint(tmp_path, said.append) is None
    assert len(said) == 2 and said[0].endswith("using the one before it") and said[1].endswith("starting over")
    save(tmp_path, 3)
    assert load_checkpoint(tmp_path, pytest.fail)[0] == {"step": 3}


def test_one_that_cannot_be_read_is_not_passed_over(tmp_path, monkeypatch):
    save(tmp_path, 1)

    def unreadable(path):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(training_loop, "file_sha256", unreadable)
    with pytest.raises(OSError, match="Input/output"):
        load_checkpoint(tmp_path, pytest.fail)


def test_nothing_written_is_nothing_found(tmp_path):
    (tmp_path / "writing.safetensors").write_bytes(b"cut short")
    assert load_checkpoint(tmp_path, pytest.fail) is None


class Toy:
    """Counts steps; raises `fault` after the third."""

    def __init__(self, fault: BaseException | None = None, between_steps: bool = True) -> None:
        self.step, self.fault, self.between_steps = 0, fault, between_steps

    def run(self, on_step) -> None:
        for self.step in (1, 2, 3):
            on_step(self)
        if self.fault is not None:
            raise self.fault

    def checkpoint(self) -> tuple[dict, dict]:
        return {"step": self.step}, {"values": np.full(2, self.step, np.float32)}


class Said(Silent):
    def __init__(self) -> None:
        self.finished = 0

    def finish(self) -> None:
        self.finished += 1


@pytest.fixture
def partial(tmp_path):
    return SimpleNamespace(checkpoint=tmp_path)


def run(toy, partial, every=1e9, first=True):
    said, reported = Said(), []
    context = Context(processes=SimpleNamespace(first=first), progress=said)
    try:
        run_training(toy, "the toy", every, partial, context, lambda now: reported.append(now.step))
    finally:
        assert reported == [1, 2, 3] and said.finished == 1
    return load_checkpoint(partial.checkpoint, print)


def test_checkpoints_come_every_so_often_and_from_the_first_process_alone(partial):
    assert run(Toy(), partial) is None
    assert run(Toy(), partial, every=0.0, first=False) is None
    data, arrays = run(Toy(), partial, every=0.0)
    assert data == {"step": 3} and arrays["values"].tolist() == [3, 3]


@pytest.mark.parametrize("between_steps", [True, False])
def test_ctrl_c_keeps_whole_steps_alone(partial, between_steps):
    with pytest.raises(KeyboardInterrupt):
        run(Toy(KeyboardInterrupt(), between_steps), partial)
    assert (load_checkpoint(partial.checkpoint, print) is not None) == between_steps


def test_what_does_not_converge_is_reported_by_its_name(partial):
    with pytest.raises(BadInput, match="the toy does not converge: too far"):
        run(Toy(Diverged("too far")), partial)
