"""Optical flow files: Middlebury .flo, and .npy. [h, w, 2] float32: pixels to the right, pixels down.

A .flo is the float 202021.25 ("PIEH" as bytes), width and height as int32, then the vectors row by row, all
little-endian. By its convention a component over 1e9 marks an unknown vector, which is read as NaN.
"""

import math
import os
import struct
from pathlib import Path
from tokenize import TokenError

import numpy as np

from schemas.errors import BadInput
from schemas.safe_reading import allowance, check_allowance, opened, read_bytes

FLOW_SUFFIXES = (".flo", ".npy")
_TAG = b"PIEH"
_UNKNOWN = 1e9
LARGEST_FLOW = 2 << 30  # bytes


def read_flow(path: Path) -> np.ndarray:
    """Read optical flow [h, w, 2] float32, NaN where unknown; BadInput if the file is not a flow file."""
    try:
        found = _read_flo(path) if path.suffix.lower() == ".flo" else _read_npy(path)
    except FileNotFoundError as error:
        raise BadInput(f"flow {path} cannot be read: {error.strerror or error}") from error
    with np.errstate(invalid="ignore"):
        unknown = ~np.isfinite(found) | (np.abs(found) > _UNKNOWN)
    return np.where(unknown.any(axis=-1, keepdims=True), np.float32(np.nan), found)


def _read_flo(path: Path) -> np.ndarray:
    data = read_bytes(path, min(LARGEST_FLOW, allowance()))
    if len(data) < 12 or data[:4] != _TAG:
        raise BadInput(f"flow {path} is not a Middlebury .flo: it does not begin with the number 202021.25")
    width, height = struct.unpack("<ii", data[4:12])
    if width < 1 or height < 1 or len(data) != 12 + 8 * width * height:
        raise BadInput(
            f"flow {path} claims {width}x{height} pixels, {12 + 8 * width * height} bytes, but has {len(data)}"
        )
    return np.frombuffer(data, "<f4", offset=12).reshape(height, width, 2).astype(np.float32)


def _read_npy(path: Path) -> np.ndarray:
    try:
        with opened(path) as stream:
            magic = np.lib.format.read_magic(stream)
            header = np.lib.format.read_array_header_1_0 if magic == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, kind = header(stream)
            # numpy allocates all that the header claims before it checks the file's size.
            if math.prod(shape) * kind.itemsize > os.fstat(stream.fileno()).st_size:
                raise ValueError(f"it is too short for its shape {shape}")
            if len(shape) == 3:
                check_allowance(path, shape[1], shape[0], math.prod(shape) * max(4, kind.itemsize))
            stream.seek(0)
            found = np.load(stream, allow_pickle=False)
    except (ValueError, EOFError, SyntaxError, TypeError, RecursionError, OverflowError, TokenError) as error:
        raise BadInput(f"flow {path} is not an array that numpy can read without running code: {error}") from error
    if not isinstance(found, np.ndarray):
        raise BadInput(f"flow {path} contains several arrays; expected one of shape [height, width, 2]")
    if found.ndim != 3 or found.shape[2] != 2 or found.dtype.kind not in "fiu":
        raise BadInput(f"flow {path} has shape {found.shape}; expected numbers of shape [height, width, 2]")
    return found.astype(np.float32)
