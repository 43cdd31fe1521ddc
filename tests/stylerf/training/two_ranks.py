"""A process of a fit and a fine-tuning by several: `python -m tests.stylerf.training.two_ranks OUT`, under torchrun's
variables; and the same by one process."""

import json
import sys

import numpy as np

from stylerf.training.finetune import EditedPixels, FineTuner, FineTuneSettings
from stylerf.training.fit import Fitter
from stylerf.training.ranks import ALONE, Ranks, Together
from tests.stylerf.training.running import saved
from tests.stylerf.training.scenes import AROUND, box_bank, settings

MORE = {"shares": (0.36,), "background": "random", "smoothness": (1e-4, 1e-4), "min_gain": 9.0, "samples": 4000}


def fitted(chunks: int, ranks: Ranks = ALONE) -> dict[str, np.ndarray]:
    """A fit that tries one rung, drops it, and trains on held-out views at the end; several begin from a checkpoint."""
    fitter = Fitter(AROUND, box_bank(), 2, settings(280, **MORE), 0, chunks, ranks=ranks)
    if ranks.count > 1:
        fitter.warm_up()
        for _ in range(3):
            fitter.step()
        data, arrays = fitter.checkpoint()
        first = fitter
        fitter = Fitter(AROUND, box_bank(), 2, settings(280, **MORE), 0, chunks, ranks=ranks)
        fitter.resume(*ranks.checkpoint((data, arrays) if ranks.first else None))
        assert first.state.step == fitter.state.step == 3
    fitter.run()
    return outcome(fitter)


def tuned(chunks: int, ranks: Ranks = ALONE) -> dict[str, np.ndarray]:
    """A fine-tuning of a field that has hardly begun, with edited pixels anywhere."""
    fitter = Fitter(AROUND, box_bank(), 0, settings(20), 0, 1)
    fitter.run()
    generator = np.random.default_rng(4)
    views, numbers = generator.integers(0, 10, 500), generator.integers(0, 576, 500)
    depth = generator.random(300, np.float32) + 1
    pixels = EditedPixels(views[:300], numbers[:300], depth, (views[300:], numbers[300:]))
    more = {"steps": 20, "rays": 501, "depth_weight": 0.1, "smoothness": 1e-4}
    tuner = FineTuner(fitter.field, fitter.bank, pixels, FineTuneSettings(**more), 0, chunks, ranks)
    tuner.run()
    return outcome(tuner)


def outcome(loop: Fitter | FineTuner) -> dict[str, np.ndarray]:
    """State, but for the clock, and arrays of a loop."""
    data, arrays = saved(loop)
    state = data["state"] | {"seconds": 0, "curve": [point | {"seconds": 0} for point in data["state"]["curve"]]}
    return {"state": np.array(json.dumps(state)), **arrays}


def main() -> None:
    ranks = Together()
    np.savez(f"{sys.argv[1]}/fit{ranks.place}.npz", **fitted(1, ranks))
    np.savez(f"{sys.argv[1]}/tune{ranks.place}.npz", **tuned(1, ranks))


if __name__ == "__main__":
    main()
