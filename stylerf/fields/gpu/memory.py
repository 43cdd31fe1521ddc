"""A GPU's memory: how much of it is free, and work that is cut finer where it does not suffice."""

from collections.abc import Callable
from typing import TypeVar

import torch

FEWEST = 1 << 10  # rays at once; where not even these fit, no smaller part would
Made = TypeVar("Made")


def free_on(device: torch.device | str, otherwise: float) -> float:
    """Bytes that are free on a GPU; `otherwise` for a device that does not tell."""
    device = torch.device(device)
    return torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else otherwise


def in_parts(count: int, at_once: int, work: Callable[[int, int], Made]) -> list[Made]:
    """work(begin, end) of all parts of 0 to `count`, `at_once` rays each; where memory lacks, half as many from there.

    OutOfMemoryError where FEWEST rays are too many.
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
        # Here, and not above: the error holds on to what the part had taken.
        torch.cuda.empty_cache()
        at_once = (end - begin) // 2
    return made
