"""Checkpoints of training: the last two, each named by its digest so that a damaged one is never resumed."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from schemas.atomic_write import sync_folder
from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged
from schemas.safe_reading import parsed
from schemas.tensors import load_tensors, save_tensors_with_digest

KEPT = 2
_NAME = re.compile(r"(\d{6,})-([0-9a-f]{64})\.safetensors")  # number, SHA-256 of the bytes


def save_checkpoint(folder: Path, data: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Save state and arrays, keeping the checkpoint before.

    Both go to one file, `NUMBER-SHA256.safetensors`, so that a kill cannot leave state and arrays of different steps.
    """
    earlier = _kept(folder)
    number = earlier[0][0] + 1 if earlier else 1
    writing = folder / "writing.safetensors"
    digest = save_tensors_with_digest(writing, arrays, {"state": json.dumps(data)})
    os.replace(writing, folder / f"{number:06d}-{digest}.safetensors")
    sync_folder(folder)
    for _, _, path in earlier[KEPT - 1 :]:
        path.unlink(missing_ok=True)


def load_checkpoint(folder: Path, say: Callable[[str], None]) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Load the newest undamaged checkpoint.

    Args:
        folder: where checkpoints are kept.
        say: receives one line for each damaged checkpoint.

    Returns:
        State and arrays, or None without a checkpoint.

    Raises:
        OSError: a checkpoint cannot be read; it may be undamaged.
    """
    found = _kept(folder)
    for place, (_, digest, path) in enumerate(found):
        if file_sha256(path) == digest:
            arrays, metadata = load_tensors(path)
            return parsed(metadata["state"], str(path), ArtifactDamaged), arrays
        rest = "using the one before it" if place + 1 < len(found) else "starting over"
        say(f"checkpoint {path.name[:6]} is damaged; {rest}")
    return None


def _kept(folder: Path) -> list[tuple[int, str, Path]]:
    """Return number, digest and path of each checkpoint, newest first."""
    matches = [(_NAME.fullmatch(path.name), path) for path in folder.glob("*.safetensors")]
    return sorted(((int(match[1]), match[2], path) for match, path in matches if match), reverse=True)
