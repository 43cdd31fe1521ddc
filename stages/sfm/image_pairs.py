"""Which photos are compared with which."""

import re
from itertools import pairwise

# Above this many photos `auto` takes neighbors only, if the names count frames: all pairs grow with the square.
MOST_FOR_ALL_PAIRS = 80
# Neighbors of a frame that it is compared with, and every how many-th frame is a key frame.
OVERLAP, KEY_FRAME_EVERY = 10, 8
_NUMBER = re.compile(r"(\d+)(?=\D*$)")


def chosen_matching(wanted: str, names: list[str]) -> tuple[str, str]:
    """Return exhaustive or sequential, and the reason as text. names: file names in order."""
    if wanted != "auto":
        return wanted, "as requested"
    if len(names) <= MOST_FOR_ALL_PAIRS:
        return "exhaustive", f"{len(names)} photos are few enough to compare all pairs"
    if _are_frames(names):
        return "sequential", f"the names of the {len(names)} photos count frames"
    return "exhaustive", f"the names of the {len(names)} photos do not count frames, so any two may overlap"


def _are_frames(names: list[str]) -> bool:
    found = [match for name in names if (match := _NUMBER.search(name))]
    if len(found) < len(names):
        return False
    stems = {match.string[: match.start()] for match in found}
    numbers = [int(match.group()) for match in found]
    steps = [after - before for before, after in pairwise(numbers)]
    # Dropped frames leave gaps, but most steps of a sampled video are equal.
    return (
        len(stems) == 1
        and all(step > 0 for step in steps)
        and steps.count(max(steps, key=steps.count)) > len(steps) / 2
    )


def pairs(count: int, matching: str) -> list[tuple[int, int]]:
    """Index pairs (i < j), near ones first.

    exhaustive: all. sequential: frames up to OVERLAP apart, those 2^k apart, and all pairs of key frames, which close
    the loop where a walk comes back.
    """
    if matching == "exhaustive":
        return [(i, i + gap) for gap in range(1, count) for i in range(count - gap)]
    gaps = sorted({*range(1, OVERLAP + 1), *(2**k for k in range(count.bit_length()))})
    near = [(i, i + gap) for gap in gaps for i in range(count - gap)]
    keys = range(0, count, KEY_FRAME_EVERY)
    return near + sorted({(i, j) for i in keys for j in keys if i < j} - set(near))
