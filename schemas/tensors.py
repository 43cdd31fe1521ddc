"""Named arrays on disk as safetensors: nothing in such a file is executed when it is read."""

import json
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from schemas.atomic import write_bytes
from schemas.errors import ArtefactDamaged


def save_tensors(path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, str] | None = None) -> None:
    """Replaces the file `path` by named arrays and string metadata as one step.

    Strided views are copied first: safetensors refuses them. The bytes depend on the content alone.
    """
    whole = {name: np.asarray(tensors[name], order="C") for name in sorted(tensors)}
    write_bytes(Path(path), _in_order(save(whole, metadata=metadata or None)))


def _in_order(data: bytes) -> bytes:
    """The same file with its metadata sorted: safetensors writes them in another order in every process.

    A file is 8 bytes of header length (little endian), a JSON header padded with spaces to a multiple of 8, the data.
    """
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    if "__metadata__" in header:
        header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data[8 + length :]


def load_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays by name and the metadata of a safetensors file.

    ArtefactDamaged where it is missing, cut short or of another format. A flipped data byte is not seen here: that is
    what the digests of the manifest are for.
    """
    path = Path(path)
    if not path.is_file():
        raise ArtefactDamaged(f"{path} is missing; make the artefact it belongs to again")
    try:
        with safe_open(path, framework="numpy") as stream:
            return {name: stream.get_tensor(name) for name in stream.keys()}, dict(stream.metadata() or {})
    except (SafetensorError, OSError, ValueError) as error:
        raise ArtefactDamaged(f"{path} is no readable safetensors file ({error}); make its artefact again") from error
