"""A process of trainings by several, and the same by one process.

`python -m tests.stylerf.training.two_ranks OUT STEPS`, under torchrun's variables.
"""

import json
import sys
import time

import numpy as np

from stylerf.training.common.process_group import SINGLE_PROCESS, DistributedProcesses, ProcessGroup
from stylerf.training.finetune.trainer import EditedPixels, FineTuner, FineTuneSettings
from stylerf.training.fit.fitter import Fitter
from stylerf.training.fit.settings import FitSettings
from tests.stylerf.training.running import run_until, saved
from tests.stylerf.training.scenes import AROUND, LEVELS, box_bank, settings

MORE = {"level_ends": (0.36,), "background": "random", "smoothness": (1e-4, 1e-4), "min_gain": 9.0, "samples": 4000}


def fitted(steps: int, threads: int, ranks: ProcessGroup = SINGLE_PROCESS) -> dict[str, np.ndarray]:
    """A fit that trains on held-out views at its end; in 280 steps it tries one level and drops it.

    Several processes begin from a checkpoint.
    """
    fitter = Fitter(AROUND, box_bank(), 2, settings(steps, **MORE), 0, threads, group=ranks)
    if ranks.count > 1:
        begun = run_until(fitter, 3)
        fitter = Fitter(AROUND, box_bank(), 2, settings(steps, **MORE), 0, threads, group=ranks)
        fitter.resume(*ranks.checkpoint(begun.checkpoint() if ranks.first else None))
        assert fitter.state.step == 3
    fitter.run()
    return outcome(fitter)


def timed(ranks: ProcessGroup) -> dict[str, np.ndarray]:
    """A fit by the clock, in which the processes are not equally fast."""
    fitter = Fitter(AROUND, box_bank(), 2, FitSettings(seconds=1.0, samples=2000, levels=LEVELS[:1]), 0, 1, group=ranks)
    fitter.run(lambda now: time.sleep(0.002 * ranks.place))
    return outcome(fitter)


def tuned(threads: int, ranks: ProcessGroup = SINGLE_PROCESS) -> dict[str, np.ndarray]:
    """A fine-tuning of a field that has hardly begun, with edited pixels anywhere."""
    fitter = Fitter(AROUND, box_bank(), 0, settings(20), 0, 1)
    fitter.run()
    generator = np.random.default_rng(4)
    views, numbers = generator.integers(0, 10, 500), generator.integers(0, 576, 500)
    depth = generator.random(300, np.float32) + 1
    pixels = EditedPixels(views[:300], numbers[:300], depth, (views[300:], numbers[300:]))
    more = {"steps": 20, "rays": 501, "depth_weight": 0.1, "smoothness": (1e-4, 1e-4)}
    tuner = FineTuner(fitter.field, fitter.dataset, pixels, FineTuneSettings(**more), 0, threads, ranks)
    tuner.run()
    return outcome(tuner)


def outcome(loop: Fitter | FineTuner) -> dict[str, np.ndarray]:
    """State, but for the clock, and arrays of a loop."""
    data, arrays = saved(loop)
    state = data["state"] | {"seconds": 0, "curve": [point | {"seconds": 0} for point in data["state"]["curve"]]}
    return {"state": np.array(json.dumps(state)), **arrays}


def main() -> None:
    folder, steps = sys.argv[1], int(sys.argv[2])
    ranks = DistributedProcesses()
    np.savez(f"{folder}/fit{ranks.place}.npz", **fitted(steps, 1, ranks))
    np.savez(f"{folder}/time{ranks.place}.npz", **timed(ranks))
    np.savez(f"{folder}/tune{ranks.place}.npz", **tuned(1, ranks))
    ranks.leave()


if __name__ == "__main__":
    main()
