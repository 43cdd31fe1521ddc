"""The cost of feature extraction: `python -m benchmarks.extractor OUT.json`.

Protocol: features of an image and the gradient with respect to it, as in a style step, using direct convolutions
(oneDNN, channels last) and Winograd convolutions (stylerf/style/cpu_convolution.py) alternately, REPEATS times each in
one process; medians of the seconds, and of the ratios of consecutive runs. GFLOP/s count the multiplications and
additions of direct convolutions, forward and backward, so Winograd's may exceed the processor's peak. Transport:
targets for 2048 features among 4096, each layer once.
"""

import json
import sys
import time
from pathlib import Path

from stylerf.environment.performance import keep_freed_pages, wait_passively

wait_passively()  # as in the command-line tool, before torch is loaded

import numpy as np  # noqa: E402
import torch  # noqa: E402

from benchmarks.conditions import here_and_now  # noqa: E402
from stages.weights.resolve import resolve  # noqa: E402
from stylerf.kernels.cpu.compiling import set_threads  # noqa: E402
from stylerf.style.feature_extractor import FeatureExtractor  # noqa: E402
from stylerf.style.feature_matching import unit_rows  # noqa: E402
from stylerf.style.transport import transport_targets  # noqa: E402

LAYERS = ("conv3_1", "conv2_1,conv3_1", "conv2_1,conv3_1,conv4_1", "conv3")
SIZES = ((378, 504), (189, 252))
REPEATS = 8


def main() -> int:
    torch.set_num_threads(set_threads(2))
    keep_freed_pages()
    found = resolve()
    command = "python -m benchmarks.extractor OUT.json"
    result = {**here_and_now(), "command": command, "extractor": found.name, "threads": 2, "looks": [], "transport": []}
    for layers in LAYERS:
        fast, direct = (FeatureExtractor(found.state, layers, found.kind) for _ in range(2))
        direct.winograd = False
        for height, width in SIZES:
            image = torch.rand(1, 3, height, width, generator=torch.Generator().manual_seed(0))
            looks = np.array([[look(direct, image), look(fast, image)] for _ in range(REPEATS + 1)])[1:]
            operations = 2 * arithmetic(fast, height, width)
            seconds = np.median(looks, axis=0)
            result["looks"].append({
                "layers": layers, "size": f"{width}x{height}", "direct_seconds": round(float(seconds[0]), 3),
                "winograd_seconds": round(float(seconds[1]), 3),
                "ratio": round(float(np.median(looks[:, 0] / looks[:, 1])), 2),
                "direct_gflops": round(operations / seconds[0] / 1e9, 1),
            })  # fmt: skip
    for channels in (128, 256):
        generator = torch.Generator().manual_seed(1)
        content, style = (unit_rows(torch.rand(n, channels, generator=generator)) for n in (2048, 4096))
        seconds = [timed(lambda c=content, s=style: transport_targets(c, s, 0.5)) for _ in range(REPEATS)]
        result["transport"].append({"channels": channels, "seconds": round(float(np.median(seconds)), 3)})
    Path(sys.argv[1]).write_text(json.dumps(result, indent=1) + "\n")
    return 0


def look(extractor: FeatureExtractor, image: torch.Tensor) -> float:
    """Return the seconds for an image's features and the gradient of their mean square."""
    image = image.clone().requires_grad_()
    return timed(lambda: torch.autograd.grad(sum(f.square().mean() for f in extractor(image)), image))


def timed(work) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def arithmetic(extractor: FeatureExtractor, height: int, width: int) -> float:
    """Return the number of multiplications and additions in an image's convolutions, forward pass."""
    total = 0.0
    for layer in extractor.built:
        scale = 2 ** (int(layer[4]) - 1)
        weight = extractor.get_buffer(f"{layer}_weight")
        total += 2.0 * weight.numel() * (height // scale) * (width // scale)
    return total


if __name__ == "__main__":
    sys.exit(main())
