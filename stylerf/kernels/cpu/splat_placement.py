"""Draw surface points from the samples of rays."""

import numpy as np
from numba import prange

from stylerf.kernels.cpu.compiling import parallel_kernel

_ZERO, _ONE = np.float32(0), np.float32(1)


@parallel_kernel
def draw_samples(samples, draws, reach, threads, chosen, opacities):
    """Draw one sample per ray with a probability equal to its weight, or none with the remaining probability.

    Args:
        samples: of marched rays.
        draws: [rays], uniform in 0..1.
        reach: half the thickness of a surface, relative to its distance.
        chosen: output, [rays] int64: the sample, -1 for none.
        opacities: output, [rays]: the fraction of the light arriving at the surface that it absorbs.
    """
    starts, ends, t, weights = samples.starts, samples.ends, samples.t, samples.weights
    n = len(ends)
    for thread in prange(threads):
        for r in range(thread * n // threads, (thread + 1) * n // threads):
            chosen[r], opacities[r] = -1, _ZERO
            passed = _ZERO
            for k in range(starts[r], ends[r]):
                passed += weights[k]
                if passed > draws[r]:
                    chosen[r] = k
                    break
            k = chosen[r]
            if k < 0:
                continue
            before, inside = _ZERO, _ZERO
            for j in range(starts[r], ends[r]):
                if t[j] < t[k] * (_ONE - reach):
                    before += weights[j]
                elif t[j] <= t[k] * (_ONE + reach):
                    inside += weights[j]
            opacities[r] = min(inside / max(_ONE - before, np.float32(1e-6)), _ONE)
