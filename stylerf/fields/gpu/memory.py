"""GPU memory: how much is free, and retrying work in smaller parts when it runs out."""

from collections.abc import Callable
from typing import TypeVar

import torch

FEWEST = 1 << 10  # rays at once; if these do not fit, fewer would not either
Made = TypeVar("Made")


def free_on(device: torch.device | str, otherwise: float) -> float:
    """Return the free memory of a GPU in bytes, or `otherwise` for any other device."""
    device = torch.device(device)
    return torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else otherwise


def in_parts(count: int, at_once: int, work: Callable[[int, int], Made]) -> list[Made]:
    """Return the results of work(begin, end) for parts of `at_once` rays; halves the part size when memory runs out.

    Raises:
        torch.OutOfMemoryError: even FEWEST rays do not fit.
    """
    made, begin = [], 0
    while begin < count:
        end = min(begin + at_once, count)
        try:
            made.append(work(begin, end))
            begin = end
            continue
        except torch.OutOfMemoryError:
            if end - begin <= FEWEST:
                raise
        # Outside the handler, where the exception would keep the part's tensors alive.
        torch.cuda.empty_cache()
        at_once = (end - begin) // 2
    return made
