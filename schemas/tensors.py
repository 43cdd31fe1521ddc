"""Named arrays on disk as safetensors: nothing in such a file is executed when it is read."""

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open

from schemas.atomic_write import replacing
from schemas.errors import ArtifactDamaged
from schemas.safe_names import printable

# By numpy's name, in the format's order from the last in a file to the first.
TYPES = {
    "bool": "BOOL", "uint8": "U8", "int8": "I8", "int16": "I16", "uint16": "U16", "float16": "F16", "int32": "I32",
    "uint32": "U32", "float32": "F32", "float64": "F64", "int64": "I64", "uint64": "U64",
}  # fmt: skip


def save_tensors(path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, str] | None = None) -> None:
    """Replaces the file `path` by named arrays and string metadata as one step.

    The bytes depend on the content alone: the library writes metadata in another order in every process. It would also
    hold everything once more, and a checkpoint is as large as all that learns.
    """
    _write(path, _parts(tensors, metadata))


def save_tensors_with_digest(path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, str]) -> str:
    """As save_tensors; returns the SHA-256 of the bytes as they are in memory, taken while they are written."""
    parts, digest = _parts(tensors, metadata), hashlib.sha256()
    with ThreadPoolExecutor(1) as pool:
        hashed = pool.submit(lambda: [digest.update(part) for part in parts])
        _write(path, parts)
        hashed.result()
    return digest.hexdigest()


def _parts(tensors: dict[str, np.ndarray], metadata: dict[str, str] | None) -> list[bytes | memoryview]:
    """Header and arrays, as they follow one another in the file."""
    rank = list(TYPES)
    whole = {name: np.asarray(array, array.dtype.newbyteorder("<"), order="C") for name, array in tensors.items()}
    names = sorted(whole, key=lambda name: (-rank.index(whole[name].dtype.name), name))
    header: dict = {"__metadata__": dict(sorted(metadata.items()))} if metadata else {}
    at = 0
    for name in names:
        array = whole[name]
        end = at + array.nbytes
        header[name] = {"dtype": TYPES[array.dtype.name], "shape": list(array.shape), "data_offsets": [at, end]}
        at = end
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    return [len(text).to_bytes(8, "little") + text, *(whole[name].reshape(-1).view(np.uint8).data for name in names)]


def _write(path: Path, parts: list[bytes | memoryview]) -> None:
    with replacing(Path(path)) as temporary, open(temporary, "wb") as stream:
        for part in parts:
            stream.write(part)


def load_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays by name and the metadata of a safetensors file.

    ArtifactDamaged where it is missing, cut short or of another format. A flipped data byte is not seen here: that is
    what the digests of the manifest are for.
    """
    path = Path(path)
    if not path.is_file():
        raise ArtifactDamaged(f"{path} is missing; make the artifact it belongs to again")
    try:
        with safe_open(path, framework="numpy") as stream:
            for name in stream.keys():
                if (kind := str(stream.get_slice(name).get_dtype())) not in TYPES.values():
                    raise ValueError(f"its array {printable(name)} is of type {kind}, which no artifact has")
            return {name: stream.get_tensor(name) for name in stream.keys()}, dict(stream.metadata() or {})
    except (SafetensorError, OSError, ValueError, OverflowError) as error:
        raise ArtifactDamaged(f"{path} is no readable safetensors file ({error}); make its artifact again") from error
