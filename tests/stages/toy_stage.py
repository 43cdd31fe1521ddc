"""A small stage that checkpoints as the long ones do, for tests of the runner."""

import json
import time
from dataclasses import dataclass

import numpy as np

from schemas.atomic_write import write_json
from schemas.images import write_png
from schemas.tensors import load_tensors, save_tensors
from stages.configs import option
from stages.run.runner import Spec

SPEC = Spec(stage="toy", verb="toy", revision=1, writes="field")


@dataclass(frozen=True)
class ToyConfig:
    steps: int = option(30, help="steps")
    pause: float = option(0.0, help="seconds after a step", incidental=True)


def run(inputs, config, partial, context) -> dict:
    """A chaotic sequence: any lost or repeated step shows in the result."""
    state, done = np.full(8, 0.3 + context.seed), 0
    saved = partial.checkpoint / "state.safetensors"
    if saved.is_file():
        tensors, metadata = load_tensors(saved)
        state, done = tensors["state"], int(metadata["done"])
    kept = state, done
    try:
        while done < config.steps:
            state = np.sin(7 * state + np.arange(8) + done)
            done += 1
            if done % 3 == 0:
                # First what the step made, then the checkpoint that counts the step as done.
                write_png(partial.path / "frames" / f"{done:03d}.png", np.full((2, 2), done, np.uint8))
                save_tensors(saved, {"state": state}, {"done": str(done)})
            kept = state, done
            time.sleep(config.pause)
    except KeyboardInterrupt:
        save_tensors(saved, {"state": kept[0]}, {"done": str(kept[1])})
        raise
    save_tensors(partial.path / "field.safetensors", {"state": state})
    write_json(partial.path / "log.json", {"inputs": sorted(inputs)})
    return {"last": float(state[-1]), "list": json.loads("[1]")}
