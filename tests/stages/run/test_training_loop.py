"""What stages do with a trainer: checkpoints every so often and at Ctrl-C, a fault in words; a toy learns nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from schemas.errors import BadInput
from stages.run.checkpoints import load_checkpoint
from stages.run.progress import Context, Silent
from stages.run.training_loop import run_training
from stylerf.errors import Diverged


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
    said, told = Said(), []
    context = Context(processes=SimpleNamespace(first=first), progress=said)
    try:
        run_training(toy, "the toy", every, partial, context, lambda now: told.append(now.step))
    finally:
        assert told == [1, 2, 3] and said.finished == 1
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


def test_what_does_not_converge_is_told_by_its_name(partial):
    with pytest.raises(BadInput, match="the toy does not converge: too far"):
        run(Toy(Diverged("too far")), partial)
