"""Canonical JSON: equal values have equal bytes, and so equal digests."""

import dataclasses
import errno
import hashlib
import json
import math
import os
import stat
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

from schemas.open_flags import NONBLOCK


def plain(value: Any) -> Any:
    """Convert `value` to the types of JSON.

    Dataclasses and mappings become objects with string keys; tuples, sets (sorted) and arrays become lists; numpy
    scalars become numbers; paths become strings. Infinities and NaN, which JSON lacks, become the strings "inf",
    "-inf" and "nan".

    Raises:
        TypeError: For any other type, so that no artifact holds the `repr` of an object.
    """
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, PurePath):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, set | frozenset):
        return [plain(item) for item in sorted(value)]
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy scalars and arrays, torch tensors
        return plain(value.tolist())
    raise TypeError(f"a {type(value).__name__} cannot be written as JSON")


def canonical_json(value: Any) -> bytes:
    """Encode `value` as UTF-8 JSON with sorted keys and no spaces; digests are computed from these bytes."""
    text = json.dumps(plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8", "surrogatepass")


def digest_of(value: Any) -> str:
    """Return the SHA-256 of the canonical JSON of `value`, 64 hex digits."""
    return hashlib.sha256(canonical_json(value)).hexdigest()


def file_sha256(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a regular file, 64 hex digits; OSError for a pipe or a device."""
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | NONBLOCK)) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        return hashlib.file_digest(stream, "sha256").hexdigest()
