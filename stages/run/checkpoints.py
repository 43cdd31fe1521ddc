"""Checkpoints of what trains: the last two, each known by its digest, so that a damaged one is never gone on with."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from schemas.atomic_write import sync_folder
from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged
from schemas.safe_reading import parsed
from schemas.tensors import load_tensors, save_tensors_with_digest

KEPT = 2
_NAME = re.compile(r"(\d{6,})-([0-9a-f]{64})\.safetensors")  # its number, then the SHA-256 of its bytes


def save_checkpoint(folder: Path, data: dict, arrays: dict[str, np.ndarray]) -> None:
    """State and arrays in one file, `NUMBER-SHA256.safetensors`, so that no kill can leave the two of different
    moments. The one before is kept too."""
    earlier = _kept(folder)
    number = earlier[0][0] + 1 if earlier else 1
    writing = folder / "writing.safetensors"
    digest = save_tensors_with_digest(writing, arrays, {"state": json.dumps(data)})
    os.replace(writing, folder / f"{number:06d}-{digest}.safetensors")
    sync_folder(folder)
    for _, _, path in earlier[KEPT - 1 :]:
        path.unlink(missing_ok=True)


def load_checkpoint(folder: Path, say: Callable[[str], None]) -> tuple[dict, dict[str, np.ndarray]] | None:
    """The newest undamaged checkpoint, None if there is none. say: called with a line for each damaged one.

    OSError where one cannot be read: it may be sound.
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
    """Number, digest and path of each checkpoint, the newest first."""
    matches = [(_NAME.fullmatch(path.name), path) for path in folder.glob("*.safetensors")]
    return sorted(((int(match[1]), match[2], path) for match, path in matches if match), reverse=True)
