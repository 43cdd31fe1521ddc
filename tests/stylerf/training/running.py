"""Stopping a loop, going on from a checkpoint as a file would give it back, and comparing what comes of it."""

import json

import numpy as np
import pytest

from stylerf.training.fit.fitter import Fitter
from stylerf.training.stylize.trainer import StylizationTrainer

Loop = Fitter | StylizationTrainer


class Stopped(Exception):
    """A kill between two steps."""


def saved(fitter: Loop) -> tuple[dict, dict[str, np.ndarray]]:
    """A checkpoint as a file would give it back."""
    data, arrays = fitter.checkpoint()
    return json.loads(json.dumps(data)), {k: v.copy() for k, v in arrays.items()}


def stop_at(step: int):
    def on_step(fitter: Loop) -> None:
        if fitter.state.step == step:
            raise Stopped

    return on_step


def resumed(other: Loop, at: Loop) -> Loop:
    other.resume(*saved(at))
    return other


def run_until(fitter: Loop, step: int) -> Loop:
    with pytest.raises(Stopped):
        fitter.run(stop_at(step))
    return fitter


def result_of(fitter: Loop) -> tuple[dict, dict]:
    """All that a loop comes to but its clock."""
    state = dict(vars(fitter.state))
    state["seconds"] = None
    state["curve"] = [entry | {"seconds": None} for entry in state["curve"]]
    return state, fitter.checkpoint()[1]


def assert_same_bits(one: dict, other: dict) -> None:
    assert one.keys() == other.keys()
    for name, values in one.items():
        assert np.array_equal(values, other[name]), name


def now(arrays: dict, part="now.") -> dict:
    return {k.removeprefix(part): v.copy() for k, v in arrays.items() if k.startswith(part)}
