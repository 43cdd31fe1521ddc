"""GPU memory: how much is free, and work in smaller parts when it runs out."""

from collections.abc import Callable
from typing import TypeVar

import torch

FEWEST = 1 << 10  # rays at once; if these do not fit, smaller parts would not either
Made = TypeVar("Made")


def free_on(device: torch.device | str, otherwise: float) -> float:
    """Return the free bytes of a GPU; `otherwise` for any other device."""
    device = torch.device(device)
    return torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else otherwise


def in_parts(count: int, at_once: int, work: Callable[[int, int], Made]) -> list[Made]:
    """Return work(begin, end) of parts of `at_once` rays each; halves the parts when memory runs out.

    Raises:
        torch.OutOfMemoryError: FEWEST rays are too many.
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
        # Outside of the handler: the error keeps the part's tensors alive.
        torch.cuda.empty_cache()
        at_once = (end - begin) // 2
    return made
