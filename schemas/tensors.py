"""Named arrays in safetensors files, which do not execute code when read."""

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from schemas.atomic_write import replacing
from schemas.errors import ArtifactDamaged
from schemas.safe_names import printable

# The format's types by numpy's name; arrays of later types come first in a file.
TYPES = {
    "bool": "BOOL", "uint8": "U8", "int8": "I8", "int16": "I16", "uint16": "U16", "float16": "F16", "int32": "I32",
    "uint32": "U32", "float32": "F32", "float64": "F64", "int64": "I64", "uint64": "U64",
}  # fmt: skip


def save_tensors(path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, str] | None = None) -> None:
    """Write named arrays and string metadata to `path` atomically.

    Equal contents give equal bytes, unlike with the safetensors library, which writes metadata in random order and
    also copies all arrays: a checkpoint is as large as everything that is trained.
    """
    _write(path, _parts(tensors, metadata))


def save_tensors_with_digest(path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, str]) -> str:
    """Do the same as save_tensors, and return the SHA-256 of the bytes, computed from memory while writing."""
    parts = _parts(tensors, metadata)
    with ThreadPoolExecutor(1) as pool:
        digest = pool.submit(_sha256, parts)
        _write(path, parts)
        return digest.result()


def _sha256(parts: list[bytes | memoryview]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def _parts(tensors: dict[str, np.ndarray], metadata: dict[str, str] | None) -> list[bytes | memoryview]:
    """Return header and arrays in file order."""
    rank = list(TYPES)
    whole = {name: np.asarray(array, array.dtype.newbyteorder("<"), order="C") for name, array in tensors.items()}
    # TYPES go from small to large items: with the largest first, every array starts aligned.
    names = sorted(whole, key=lambda name: (-rank.index(whole[name].dtype.name), name))
    header: dict[str, Any] = {"__metadata__": dict(sorted(metadata.items()))} if metadata else {}
    at = 0
    for name in names:
        array = whole[name]
        end = at + array.nbytes
        header[name] = {"dtype": TYPES[array.dtype.name], "shape": list(array.shape), "data_offsets": [at, end]}
        at = end
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    # The data begin at a multiple of 8, so that arrays stay aligned when a reader maps them.
    text += b" " * (-len(text) % 8)
    return [len(text).to_bytes(8, "little") + text, *(whole[name].reshape(-1).view(np.uint8).data for name in names)]


def _write(path: Path, parts: list[bytes | memoryview]) -> None:
    with replacing(Path(path)) as temporary, open(temporary, "wb") as stream:
        for part in parts:
            stream.write(part)


def load_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read the arrays, by name, and the metadata of a safetensors file.

    Flipped bytes in the data are not detected here, but by the manifest's digests.

    Raises:
        ArtifactDamaged: The file is missing, truncated or invalid.
    """
    path = Path(path)
    if not path.is_file():
        raise ArtifactDamaged(f"{path} is missing; rebuild the artifact that it belongs to")
    try:
        with safe_open(path, framework="numpy") as stream:
            for name in stream.keys():
                if (kind := str(stream.get_slice(name).get_dtype())) not in TYPES.values():
                    raise ValueError(f"its array {printable(name)} has the unknown type {kind}")
            return {name: stream.get_tensor(name) for name in stream.keys()}, dict(stream.metadata() or {})
    except (SafetensorError, OSError, ValueError, OverflowError) as error:
        raise ArtifactDamaged(f"{path} is not a readable safetensors file ({error}); rebuild its artifact") from error
