"""PLY files of 3D Gaussian splatting (Kerbl et al. 2023), read strictly: header, size and every number are checked."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from schemas.errors import BadInput, OutOfResources
from schemas.safe_names import printable
from schemas.safe_reading import allowance, opened

LONGEST_HEADER = 64 << 10  # bytes
MOST_SPLATS = 100_000_000
# Coefficients of one channel's spherical harmonics without the first, by degree.
RESTS = {0: 0, 9: 1, 24: 2, 45: 3}  # of all three channels: degree
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
_CENTER, _DC = ("x", "y", "z"), ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALES, _TURN = ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
NEEDED = (*_CENTER, *_DC, "opacity", *_SCALES, *_TURN)
# Ranges in which float32 arithmetic of a renderer neither overflows nor loses a splat; trained ones are far inside.
FARTHEST, LARGEST_LOG_SCALE, LARGEST_LOGIT, LARGEST_HARMONIC = 1e6, 14.0, 1e4, 1e4


@dataclass(frozen=True, eq=False)
class StoredSplats:
    """n splats, all float32, in the file's frame.

    Attributes:
        centers: [n, 3].
        log_scales: [n, 3], natural logarithms of the standard deviations.
        quaternions: [n, 4], w x y z, not of length 0.
        logits: [n], of the opacity.
        harmonics: [n, bands, 3], 1, 4, 9 or 16 bands of spherical harmonics, sRGB-encoded.
    """

    centers: np.ndarray
    log_scales: np.ndarray
    quaternions: np.ndarray
    logits: np.ndarray
    harmonics: np.ndarray


def is_splat_ply(path: Path) -> bool:
    """Return whether the file begins as a PLY with the properties of splats; False if it cannot be read."""
    try:
        with opened(path) as stream:
            header = stream.read(LONGEST_HEADER)
    except (BadInput, FileNotFoundError):
        return False
    return header.startswith(b"ply") and all(b" " + name.encode() in header for name in (*_DC, "opacity", "scale_0"))


def read_splat_ply(path: Path) -> StoredSplats:
    """Read the splats of a binary PLY.

    Raises:
        BadInput: It is not such a file, a count does not match its size, or a number is out of range.
        OutOfResources: It needs more memory than allowed.
    """
    shown = printable(str(path))
    try:
        with opened(path) as stream:
            count, record = _header(stream, shown)
            size, at = os.fstat(stream.fileno()).st_size, stream.tell()
            if size - at != count * record.itemsize:
                raise BadInput(
                    f"{shown} is damaged: {count} splats of {record.itemsize} bytes need {count * record.itemsize} "
                    f"bytes, but {size - at} follow its header; export it again"
                )
            takes = 2 * count * record.itemsize
            if takes > (most := allowance()):
                raise OutOfResources(
                    f"{shown} holds {count} splats, which take {takes / 1e9:.1f} GB of memory; the limit is "
                    f"{most / 1e9:.1f} GB; raise --memory"
                )
            table = np.frombuffer(stream.read(count * record.itemsize), record)
    except FileNotFoundError:
        raise BadInput(f"{shown}: file not found") from None
    if len(table) != count:
        raise BadInput(f"{shown} was truncated while being read; try again")
    return _checked(table, shown)


def _header(stream: BinaryIO, shown: str) -> tuple[int, np.dtype]:
    """Return the number of splats and the layout of one, with the stream positioned at the first."""
    lines = _lines(stream, shown)
    if not lines or lines[0] != "ply":
        raise BadInput(f"{shown} is not a PLY file; give the point_cloud.ply of 3D Gaussian splatting")
    order, count = "", -1
    fields: list[tuple[str, str]] = []
    elements: list[str] = []
    for line in lines[1:]:
        word, *rest = line.split() or [""]
        if word == "format":
            order = _ORDERS.get(rest[0] if rest else "", "")
            if not order:
                raise BadInput(f"{shown} is a text PLY ({printable(line)[:60]}); save it as binary")
        elif word == "element":
            elements.append(rest[0] if rest else "")
            if len(elements) == 1 and elements == ["vertex"] and len(rest) == 2 and re.fullmatch(r"\d{1,10}", rest[1]):
                count = int(rest[1])
        elif word == "property" and elements == ["vertex"]:
            if len(rest) != 2 or rest[0] not in _TYPES:
                raise BadInput(f"{shown}: its vertices have a property that is not a number ({printable(line)[:60]})")
            fields.append((rest[1], (order or "<") + _TYPES[rest[0]]))
    names = [name for name, _ in fields]
    if any(name.startswith("packed_") for name in names):
        raise BadInput(f"{shown} is compressed; decompress it, with SuperSplat: splat-transform IN.ply OUT.ply")
    if missing := [name for name in NEEDED if name not in names]:
        raise BadInput(
            f"{shown} contains no splats: its vertices lack {', '.join(missing[:4])}; give a point_cloud.ply"
        )
    if not order or elements != ["vertex"] or not 0 < count <= MOST_SPLATS or len(set(names)) != len(names):
        raise BadInput(f"{shown}: expected a header of one element, 1 to {MOST_SPLATS} vertices; export it again")
    return count, np.dtype(fields)


def _lines(stream: BinaryIO, shown: str) -> list[str]:
    lines: list[str] = []
    while stream.tell() < LONGEST_HEADER and (line := stream.readline(LONGEST_HEADER)):
        text = line.decode("latin-1").strip()
        if text == "end_header":
            return lines
        lines.append(text)
        if lines[0] != "ply":
            return lines
    raise BadInput(f"{shown}: its header has no end; export it again")


def _checked(table: np.ndarray, shown: str) -> StoredSplats:
    names = table.dtype.names or ()
    rest = sorted((name for name in names if re.fullmatch(r"f_rest_\d{1,2}", name)), key=lambda name: int(name[7:]))
    if len(rest) not in RESTS or rest != [f"f_rest_{k}" for k in range(len(rest))]:
        raise BadInput(
            f"{shown} has {len(rest)} coefficients f_rest_*; expected 0, 9, 24 or 45, of spherical harmonics up to "
            "degree 3"
        )
    centers = _columns(table, _CENTER, FARTHEST, shown)
    scales = _columns(table, _SCALES, np.inf, shown)
    if (large := int((scales > LARGEST_LOG_SCALE).any(axis=1).sum())) > 0:
        raise BadInput(f"{shown}: {large} splats have scales beyond exp({LARGEST_LOG_SCALE:g}); export it again")
    turns = _columns(table, _TURN, LARGEST_LOGIT, shown)
    if (flat := int((np.abs(turns).max(axis=1) < 1e-6).sum())) > 0:
        raise BadInput(f"{shown}: {flat} splats have a rotation of length 0; export it again")
    logits = _columns(table, ("opacity",), np.inf, shown)[:, 0].clip(-LARGEST_LOGIT, LARGEST_LOGIT)
    first = _columns(table, _DC, LARGEST_HARMONIC, shown)[:, None]
    others = _columns(table, tuple(rest), LARGEST_HARMONIC, shown)
    # Stored channel by channel.
    bands = others.reshape(len(table), 3, len(rest) // 3).transpose(0, 2, 1)
    return StoredSplats(centers, np.maximum(scales, -30), turns, logits, np.concatenate([first, bands], axis=1))


def _columns(table: np.ndarray, names: tuple[str, ...], most: float, shown: str) -> np.ndarray:
    """[n, names] float32; BadInput naming the property with a number that is not finite or beyond `most`."""
    found = np.empty((len(table), len(names)), np.float32)
    for place, name in enumerate(names):
        with np.errstate(over="ignore"):
            found[:, place] = table[name]
        bad = ~(np.abs(found[:, place]) <= min(most, np.finfo(np.float32).max))
        if bad.any():
            raise BadInput(
                f"{shown}: {name} of splat {int(bad.argmax())} is {found[int(bad.argmax()), place]:g}, as of "
                f"{int(bad.sum())} splats; remove them, for instance in SuperSplat"
            )
    return found
