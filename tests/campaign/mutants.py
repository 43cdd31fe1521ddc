"""Seeded damage to real files: bytes flipped, cut, spliced; lengths and numbers of the format changed.

Every operator takes a file's bytes, a random generator and other files of the kind, and returns other bytes.
"""

import json
import re
import struct
import zlib
from collections.abc import Callable
from random import Random

Operator = Callable[[bytes, Random, list[bytes]], bytes]

LENGTHS = (0, 1, 2, 7, 255, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
NUMBERS = ("0", "-1", "1", "2", "-0.0", "0.5", "1e-320", "1e-30", "1e30", "1e308", "1e999", "-1e999", "NaN", "Infinity",
           "-Infinity", "65536", "2147483647", "4294967296", "9223372036854775807", "1" + "0" * 400, "9" * 5000, "null",
           "true", '"1"', '"x"', "[]", "{}", "[[]]", "[1,2,3]")  # fmt: skip
TEXTS = ("", ".", "..", "../../outside/x", "../../../../outside/x", "/dev/zero", "/dev/stdin", "a\nb", "a/../../b",
         "\x1b[2J\x1b[31msound", "x" * 5000, "\x00", "C:\\x\\y.png", "~/x", "=1+1", "%n%s", "$(touch outside)",
         "\udcff", "é", "e\u0301", " ", "images", "m$\\frac$q", "-rf", "NaN")  # fmt: skip
DEEP = 100_000
OTHERS = (b"%PDF-1.4\n", b"PK\x03\x04" + bytes(60), b"<html></html>", b"{}", b"[]", b"null", b"GIF89a\xff\xff\xff\xff",
          b"\x80\x04cos\nsystem\n(S'touch outside'\ntR.", b"\xff\xfe{\x00}\x00", "é".encode("latin-1"))  # fmt: skip


def flipped(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Flip one to eight bits."""
    made = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 8))):
        if made:
            made[_place(len(made), random)] ^= 1 << random.randrange(8)
    return bytes(made)


def overwritten(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Overwrite a run with random bytes, zeros or ones."""
    at, length = _place(len(data), random), random.choice((1, 2, 4, 8, 64, 512))
    run = random.choice((random.randbytes(length), bytes(length), b"\xff" * length))
    return (data[:at] + run + data[at + length :])[: max(len(data), 1)]


def cut(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Truncate anywhere, mostly near an end."""
    keep = random.choice(
        (random.randrange(len(data) + 1), _place(len(data), random), len(data) - random.randint(1, 16))
    )
    return data[: max(keep, 0)]


def extended(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Append random bytes or zeros."""
    length = random.choice((1, 7, 4096))
    return data + random.choice((random.randbytes(length), bytes(length), data))


def spliced(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Join the head of one file and the tail of another."""
    other = random.choice(others or [data])
    return data[: random.randrange(len(data) + 1)] + other[random.randrange(len(other) + 1) :]


def dropped(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Remove or repeat a stretch."""
    at, length = _place(len(data), random), random.choice((1, 4, 32, 1000))
    stretch = data[at : at + length]
    return data[:at] + (stretch * 2 if random.random() < 0.5 else b"") + data[at + length :]


def lengthened(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Make a number of 2, 4 or 8 bytes extreme, mostly near the head."""
    width = random.choice((2, 4, 8))
    number = (random.choice(LENGTHS) % 2 ** (8 * width)).to_bytes(width, random.choice(("little", "big")))
    at = _place(max(len(data) - width, 1), random)
    return data[:at] + number + data[at + width :]


def emptied(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Replace the file by nothing, one byte, or zeros."""
    return random.choice((b"", b"\x00", b"\n", bytes(len(data))))


def replaced(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Replace the file by one of another format."""
    return random.choice(OTHERS)


def _place(length: int, random: Random) -> int:
    """Pick a position, half the time within the first 128 bytes, where headers are."""
    return random.randrange(min(length, 128) if random.random() < 0.5 else length) if length else 0


BYTES: tuple[Operator, ...] = (flipped, overwritten, cut, extended, spliced, dropped, lengthened, emptied, replaced)


# -- text and JSON -----------------------------------------------------------------------------------------------------

_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
_WORD = re.compile(rb'"[^"\n]*"')


def renumbered(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Replace one or a few numbers of a text by extreme values or by something else."""
    for _ in range(random.choice((1, 1, 1, 3))):
        found = list(_NUMBER.finditer(data))
        if found:
            one = random.choice(found)
            data = data[: one.start()] + random.choice(NUMBERS).encode() + data[one.end() :]
    return data


def reworded(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Replace one JSON string."""
    found = list(_WORD.finditer(data))
    if not found:
        return overwritten(data, random, others)
    one = random.choice(found)
    return data[: one.start()] + json.dumps(random.choice(TEXTS)).encode() + data[one.end() :]


def nested(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Nest a hundred thousand brackets, in place of a value or alone."""
    open, close = random.choice(((b"[", b"]"), (b'{"a":', b"}")))
    depth = random.choice((500, 5000, DEEP))
    deep = open * depth + b"1" + close * depth
    found = list(_NUMBER.finditer(data))
    if not found or random.random() < 0.3:
        return deep
    one = random.choice(found)
    return data[: one.start()] + deep + data[one.end() :]


def lines_moved(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Drop, double, blank or reorder lines; use Windows line ends or another encoding."""
    lines = data.split(b"\n")
    at = random.randrange(len(lines))
    how = random.randrange(6)
    if how == 0:
        del lines[at]
    elif how == 1:
        lines.insert(at, lines[at])
    elif how == 2:
        lines.insert(at, b"")
    elif how == 3:
        random.shuffle(lines)
    elif how == 4:
        return b"\r\n".join(lines)
    else:
        return b"\xef\xbb\xbf" + data if random.random() < 0.5 else data.decode("utf-8", "replace").encode("utf-16")
    return b"\n".join(lines)


def restructured(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Drop, double, move or retype a value of a JSON tree."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return renumbered(data, random, others)
    places = list(_places(tree))
    if not places:
        return b"[]"
    parent, key = random.choice(places)
    how = random.randrange(5)
    if how == 0:
        del parent[key]
    elif how == 1:
        parent[key] = random.choice((None, True, 0, -1, 1.5, "", "x", [], {}, [[]], {"a": 1}, 2**70))
    elif how == 2:
        other, where = random.choice(places)
        parent[key] = (
            json.loads(json.dumps(other[where]))
            if where in (other if isinstance(other, dict) else range(len(other)))
            else None
        )
    elif how == 3 and isinstance(parent[key], list):
        parent[key] = parent[key] * random.choice((0, 2, 1000))
    elif isinstance(parent, dict):
        parent[random.choice(("x", "", "__class__", key + " "))] = parent.pop(key)
    else:
        parent.insert(key, parent[key])
    return json.dumps(tree, ensure_ascii=random.random() < 0.8).encode("utf-8", "surrogatepass")


def _places(tree):
    keys = list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from _places(tree[key])


TEXT: tuple[Operator, ...] = (renumbered, reworded, nested, lines_moved)
JSON: tuple[Operator, ...] = (
    renumbered,
    renumbered,
    reworded,
    reworded,
    nested,
    restructured,
    restructured,
    lines_moved,
)


# -- formats -----------------------------------------------------------------------------------------------------------


def in_a_png(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Change something in a chunk and fix its checksum."""
    chunks = _chunks(data)
    if not chunks:
        return flipped(data, random, others)
    at = 0 if random.random() < 0.6 else random.randrange(len(chunks))
    name, body = chunks[at]
    if name == b"IHDR" and random.random() < 0.7:
        width, height = (random.choice((0, 1, 17, 30_000, 2**31 - 1, 2**32 - 1)) for _ in range(2))
        body = struct.pack(">II", width, height) + body[8:]
    else:
        body = random.choice(BYTES[:6])(body, random, [body])
    chunks[at] = name, body
    if random.random() < 0.1:
        chunks.insert(at, chunks[at])
    return data[:8] + b"".join(_chunk(*one) for one in chunks)


def bomb(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Return a valid PNG of very many black pixels."""
    side, bits, samples = random.choice(((8000, 8, 3), (12000, 8, 1), (20000, 1, 1), (40000, 1, 1)))
    row = bytes(1 + (side * bits * samples + 7) // 8)
    packer, packed = zlib.compressobj(1), []
    for _ in range(side):
        packed.append(packer.compress(row))
    head = struct.pack(">IIBBBBB", side, side, bits, 2 if samples == 3 else 0, 0, 0, 0)
    body = b"".join([*packed, packer.flush()])
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def _chunk(name: bytes, body: bytes) -> bytes:
    return len(body).to_bytes(4, "big") + name + body + zlib.crc32(name + body).to_bytes(4, "big")


def damaged_png(data: bytes) -> bool:
    """Return whether a PNG's checksums reveal the damage: a chunk before its last pixel mismatches or is cut."""
    at, pixels = 8, zlib.decompressobj()
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        return True
    while at + 12 <= len(data) and not pixels.eof:
        length = int.from_bytes(data[at : at + 4], "big")
        name, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        reported = data[at + 8 + length : at + 12 + length]
        if len(reported) < 4 or (name[:1].isupper() and zlib.crc32(name + body) != int.from_bytes(reported, "big")):
            return True
        if name == b"IDAT":
            try:
                pixels.decompress(body)
            except zlib.error:
                return True
        at += 12 + length
    return not pixels.eof


def in_an_npy(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Change shapes, types or order in a header, keeping its length."""
    length = int.from_bytes(data[8:10], "little")
    head = data[10 : 10 + length]
    head = random.choice((
        lambda: renumbered(head, random, others),
        lambda: head.replace(b"<f8", random.choice((b"|O", b"<f4", b"<c16", b"|S8", b"<U4", b">f8", b"|V8"))),
        lambda: head.replace(b"False", b"True"),
        lambda: overwritten(head, random, others),
    ))()  # fmt: skip
    head = head.strip().ljust(length) if random.random() < 0.9 else head
    return data[:8] + (len(head) % 65536).to_bytes(2, "little") + head + data[10 + length :]


def in_a_safetensors(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """Change types, shapes, offsets or names in a header of correct length, or numbers, some to NaN."""
    length = int.from_bytes(data[:8], "little")
    head, body = data[8 : 8 + length], data[8 + length :]
    if random.random() < 0.4:
        at = random.randrange(max(len(body) // 4, 1)) * 4
        number = struct.pack("<f", random.choice((float("nan"), float("inf"), -float("inf"), 3e38, -3e38, 1e-40, 1e20)))
        run = number * random.choice((1, 1, 100, 10_000))
        return data[:8] + head + (body[:at] + run + body[at + len(run) :])[: len(body)]
    types = (b"F16", b"BF16", b"F64", b"I64", b"U8", b"BOOL", b"F8_E4M3", b"I32")
    head = random.choice((
        lambda: renumbered(head, random, others),
        lambda: restructured(head, random, others),
        lambda: head.replace(b'"F32"', b'"' + random.choice(types) + b'"', random.choice((1, -1))),
        lambda: reworded(head, random, others),
        lambda: _reshaped(head, random),
        lambda: _without(head, random),
    ))()  # fmt: skip
    return len(head).to_bytes(8, "little") + head + body


def _reshaped(head: bytes, random: Random) -> bytes:
    """Reshape to the same count, so that the library accepts it."""
    tree = json.loads(head)
    names = [name for name, one in tree.items() if name != "__metadata__" and one.get("shape")]
    if names:
        one = tree[random.choice(names)]
        shape = one["shape"]
        total = 1
        for side in shape:
            total *= side
        one["shape"] = random.choice((shape[::-1], [total], [1, *shape], [total, 1], shape[1:] + shape[:1]))
    return json.dumps(tree).encode()


def _without(head: bytes, random: Random) -> bytes:
    """Swap the names of two tensors."""
    tree = json.loads(head)
    names = [name for name in tree if name != "__metadata__"]
    if len(names) >= 2:
        one, other = random.sample(names, 2)
        tree[one], tree[other] = tree[other], tree[one]
    return json.dumps(tree).encode()


FORMATS: dict[str, tuple[Operator, ...]] = {
    ".png": (*BYTES, in_a_png, in_a_png, in_a_png),
    ".json": (*BYTES, *JSON, *JSON, *JSON),
    ".toml": (*BYTES, *TEXT, *TEXT, *TEXT),
    ".txt": (*BYTES, *TEXT, *TEXT),
    ".npy": (*BYTES, in_an_npy, in_an_npy, in_an_npy),
    ".safetensors": (*BYTES, *(in_a_safetensors,) * 9),
}


def mutant(data: bytes, suffix: str, random: Random, others: list[bytes]) -> tuple[bytes, str]:
    """Return damaged bytes, never the given ones, and the names of the changes."""
    operators = FORMATS.get(suffix, BYTES)
    if suffix == ".png" and random.random() < 0.004:
        operators = (bomb,)
    names = []
    for _ in range(100):
        made, names = data, []
        for _ in range(random.choice((1, 1, 1, 2))):
            one = random.choice(operators)
            try:
                made = one(made, random, others)
            except (
                ValueError,
                IndexError,
                TypeError,
                AttributeError,
                KeyError,
                RecursionError,
            ):  # no longer its format
                made = flipped(made, random, others)
            names.append(one.__name__)
        if made != data:
            break
    return made, "+".join(names)
