"""Every number of every artifact, made another one under a valid seal: a sound result, or one line that says why not.

Never a traceback, a crash, or a read beyond an array: kernels of numba check no bounds.
"""

import copy
import json
import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from schemas.errors import StylerfError
from schemas.migrations import CURRENT
from schemas.tensors import TYPES, load_tensors
from schemas.work_folder import Artifact, WorkFolder
from tests.resealing import reseal
from tests.stages.every_artifact import Made, every_artifact

MISSING = object()
EVERYTHING = (0, -1, 1, 2**31, 2**63, 1e308, -1e308, float("nan"), float("inf"), "12", "", None, [], [1], {}, True,
              MISSING)  # fmt: skip
IN_THE_GATE = 37  # of so many cases one
LONGEST_SECONDS, MOST_BYTES = 20.0, 1.5e9


@dataclass(frozen=True)
class Case:
    """made: what is altered, by `change` of one file's bytes."""

    made: Made
    file: str
    label: str
    change: Callable[[bytes], bytes]

    def __str__(self) -> str:
        return f"{self.made.artifact.path.parent.name}/{self.made.artifact.name} {self.file} {self.label}"


# -- what is altered --------------------------------------------------------------------------------------------------


def leaves(document: Any, path: tuple = ()) -> Iterator[tuple[tuple, Any]]:
    """Every value of a JSON document by its path, objects and lists too."""
    if path:
        yield path, document
    inner = document if isinstance(document, (dict, list)) else ()
    for key, value in inner.items() if isinstance(inner, dict) else enumerate(inner):
        yield from leaves(value, (*path, key))


def replaced(document: Any, path: tuple, value: Any) -> Any:
    """The document with another value at a path, or without one."""
    document = copy.deepcopy(document)
    at = document
    for key in path[:-1]:
        at = at[key]
    if value is MISSING:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return document


def values_for(value: Any) -> Iterator[Any]:
    """Other values, among them for numbers some close by."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        yield from (value + 1, value * 2, value - 1, value + 0.5, -value)
    yield from EVERYTHING


def cases_of_json(made: Made, file: str) -> Iterator[Case]:
    document = json.loads((made.artifact.path / file).read_text())
    yield Case(made, file, "[]", lambda _: b"[]")
    yield Case(made, file, "nested", lambda _: b"[" * 100_000)
    for path, value in leaves(document):
        for other in values_for(value):
            shown = "missing" if other is MISSING else repr(other)
            yield Case(
                made, file, f"{'.'.join(map(str, path))} {shown}",
                lambda _, path=path, other=other: json.dumps(replaced(document, path, other)).encode(),
            )  # fmt: skip


def packed(arrays: dict[str, tuple[str, list[int], bytes]], metadata: dict[str, str]) -> bytes:
    """A safetensors file of whatever types: (type, shape, bytes) by name."""
    header, at = {"__metadata__": metadata}, 0
    for name, (kind, shape, data) in arrays.items():
        header[name] = {"dtype": kind, "shape": shape, "data_offsets": [at, at + len(data)]}
        at += len(data)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + b"".join(data for _, _, data in arrays.values())


def others_of(array: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays that are nearly the same."""
    if not array.size:
        yield "one", np.ones((1, *array.shape[1:]), array.dtype)
        return
    yield "one fewer", array[:-1]
    yield "one more", np.concatenate([array, array[-1:]])
    yield "empty", array[:0]
    yield "flat and two", np.concatenate([array.reshape(-1)] * 2)
    yield "another axis", array[None]
    yield "no axis", array.reshape(-1)[0].copy().reshape(())
    for kind in ("float64", "float16", "int32", "int64", "uint8", "bool"):
        if kind != array.dtype.name:
            with np.errstate(invalid="ignore"):
                yield kind, array.astype(kind)
    if array.dtype.kind == "f":
        fills = (np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-45)
    else:
        fills = (0, 1) if array.dtype == bool else (np.iinfo(array.dtype).max, np.iinfo(array.dtype).min)
    for value in fills:
        one = array.copy()
        one.reshape(-1)[len(one.reshape(-1)) // 2] = value
        yield f"one {value}", one
        yield f"all {value}", np.full_like(array, value)
    if array.dtype.kind == "f":
        some = np.random.default_rng(0).choice(np.float32([3e38, -3e38]), array.shape).astype(array.dtype)
        yield "both ends", some
    else:
        yield "shuffled", np.random.default_rng(0).permutation(array.reshape(-1)).reshape(array.shape)


def cases_of_tensors(made: Made, file: str) -> Iterator[Case]:
    arrays, metadata = load_tensors(made.artifact.path / file)

    def written(altered: dict[str, np.ndarray], reported: dict[str, str]) -> bytes:
        parts = {n: (TYPES[a.dtype.name], list(a.shape), np.ascontiguousarray(a).tobytes()) for n, a in altered.items()}
        return packed(parts, reported)

    for name, array in arrays.items():
        without = {key: one for key, one in arrays.items() if key != name}
        yield Case(made, file, f"{name} missing", lambda _, w=without: written(w, metadata))
        for label, other in others_of(array):
            yield Case(
                made, file, f"{name} {label}", lambda _, n=name, o=other: written({**arrays, n: o}, metadata)
            )  # fmt: skip
        for kind, bits in (("BF16", 16), ("F8_E4M3", 8), ("C64", 64)):
            raw = array.tobytes()
            raw += bytes(-len(raw) % 8)
            part = {name: (kind, [len(raw) * 8 // bits], raw)}
            yield Case(made, file, f"{name} {kind}", lambda _, p=part: packed(p, metadata))
    for key, text in metadata.items():
        for path, value in leaves(json.loads(text)):
            for other in values_for(value):
                reported = metadata | {key: json.dumps(replaced(json.loads(text), path, other))}
                yield Case(made, file, f"{key}.{path} {other}", lambda _, t=reported: written(arrays, t))
        yield Case(made, file, f"{key} nested", lambda _, k=key: written(arrays, metadata | {k: "[" * 100_000}))
        yield Case(made, file, f"{key} missing", lambda _: written(arrays, {}))


def all_cases(made: dict[str, Made]) -> Iterator[Case]:
    for one in made.values():
        for path in sorted(one.artifact.path.rglob("*")):
            file = path.relative_to(one.artifact.path).as_posix()
            if path.suffix == ".json":
                yield from cases_of_json(one, file)
            elif path.suffix == ".safetensors":
                yield from cases_of_tensors(one, file)


# -- what comes of it -------------------------------------------------------------------------------------------------


def outcome(case: Case) -> str | None:
    """None for a sound result or one clear line; else what went wrong. The artifact is left as it was."""
    folder = case.made.artifact.path
    before = {path: path.read_bytes() for path in (folder / case.file, folder / "manifest.json")}
    begun = time.monotonic()
    try:
        altered = case.change(before[folder / case.file])
        if case.file == "manifest.json":
            try:
                content = json.loads(altered)
            except RecursionError:
                return None  # cannot be sealed
            if not isinstance(content, dict):
                return None
            files = content.get("files", MISSING)
            reseal(folder, lambda now: (now.clear(), now.update(content), now.update(files=files)) if files is not
                   MISSING else (now.clear(), now.update(content)))  # fmt: skip
        else:
            (folder / case.file).write_bytes(altered)
            reseal(folder)
        case.made.use(Artifact(folder))
    except StylerfError as error:
        line = str(error)
        return None if line and "\n" not in line and len(line) < 2000 else f"{len(line)} characters: {line[:300]}"
    except AssertionError as error:
        return f"silently wrong: {error}"
    except Exception as error:  # what must not happen
        return f"{type(error).__name__}: {error}"
    finally:
        for path, data in before.items():
            path.write_bytes(data)
    if (took := time.monotonic() - begun) > LONGEST_SECONDS:
        return f"took {took:.0f} s"
    return None


def assert_sound(cases: list[Case]) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    wrong = [f"{case}: {found}" for case in cases if (found := outcome(case)) is not None]
    assert not wrong, f"{len(wrong)} of {len(cases)}:\n" + "\n".join(wrong[:60])
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 < MOST_BYTES


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> dict[str, Made]:
    return every_artifact(WorkFolder(tmp_path_factory.mktemp("perturbed") / "work"))


def test_untouched_all_are_used(made):
    assert len(made) > len(CURRENT)
    for one in made.values():
        one.use(Artifact(one.artifact.path))  # raises where it does not


def test_some_numbers_of_every_artifact(made):
    assert_sound(list(all_cases(made))[::IN_THE_GATE])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scene", "field", "region", "edit", "frames", "report"])
def test_every_number_of_every_artifact(made, kind):
    assert_sound(list(all_cases({name: one for name, one in made.items() if name.split()[0].split("-")[0] == kind})))
