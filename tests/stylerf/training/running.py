"""Stopping a fit, going on from a checkpoint as a file would give it back, and comparing what comes of it."""

import json

import numpy as np
import pytest

from stylerf.training.fit import Fitter


class Stopped(Exception):
    """A kill between two steps."""


def saved(fitter: Fitter) -> tuple[dict, dict[str, np.ndarray]]:
    """A checkpoint as a file would give it back."""
    data, arrays = fitter.checkpoint()
    return json.loads(json.dumps(data)), {k: v.copy() for k, v in arrays.items()}


def stop_at(step: int):
    def on_step(fitter: Fitter) -> None:
        if fitter.state.step == step:
            raise Stopped

    return on_step


def resumed(other: Fitter, at: Fitter) -> Fitter:
    other.resume(*saved(at))
    return other


def run_until(fitter: Fitter, step: int) -> Fitter:
    with pytest.raises(Stopped):
        fitter.run(stop_at(step))
    return fitter


def result_of(fitter: Fitter) -> tuple[dict, dict]:
    """All that a fit comes to but its clock."""
    state = dict(vars(fitter.state))
    state["seconds"] = None
    state["curve"] = [entry | {"seconds": None} for entry in state["curve"]]
    return state, fitter.checkpoint()[1]


def assert_same_bits(one: dict, other: dict) -> None:
    assert one.keys() == other.keys()
    for name in one:
        assert np.array_equal(one[name], other[name]), name


def now(arrays: dict, part="now.") -> dict:
    return {k.removeprefix(part): v.copy() for k, v in arrays.items() if k.startswith(part)}
