"""The manifest of an artifact: what it is, what it was made from and how, and which bytes it consists of."""

import hashlib
import json
import re
import shlex
import unicodedata
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from datetime import datetime
from pathlib import Path
from typing import Any

from schemas.canonical_json import digest_of, plain
from schemas.errors import ArtifactDamaged
from schemas.flag_text import flags
from schemas.migrations import CURRENT, migrated
from schemas.safe_names import file_name, relative_path
from schemas.safe_reading import parsed, read_bytes

MANIFEST = "manifest.json"
MOST_BYTES = 64 << 20  # of a manifest; one of 10,000 files takes 2 MB
_SEAL = re.compile(rb'"self_sha256": "([0-9a-f]{64})"')
_SHA256 = re.compile(r"[0-9a-f]{64}")
_TYPES: dict[str, tuple[type, ...]] = {
    **dict.fromkeys(("kind", "name", "stage", "recipe", "device", "created"), (str,)),
    **dict.fromkeys(("schema", "revision", "seed"), (int,)),
    **dict.fromkeys(("config", "versions", "figures"), (dict,)),
    **dict.fromkeys(("inputs", "files"), (list,)),
    **dict.fromkeys(("seconds", "peak_memory_mb"), (int, float)),
    "threads": (int, type(None)),
}
_RANGES = {"revision": (0, 1e9), "seconds": (0.0, 1e12), "peak_memory_mb": (0.0, 1e12)}
_BLANK = b'"self_sha256": "' + b"0" * 64 + b'"'


@dataclass(frozen=True)
class InputRef:
    """An artifact that another was made from: the part it played, and the digest that it had."""

    role: str
    kind: str
    name: str
    digest: str


@dataclass(frozen=True)
class Recipe:
    """All that decides what a stage makes. Two equal recipes make the same artifact, so the older one is reused.

    aside: options of the config that are told in the manifest and decide nothing, such as where a file lies. known: the
    digest of one that was read from a manifest, which does not tell what is aside.
    """

    stage: str
    revision: int
    config: dict
    inputs: list[InputRef]
    seed: int = 0
    aside: Sequence[str] = ()
    known: str = ""

    @property
    def digest(self) -> str:
        """SHA-256 over stage, revision, deciding options, seed and the inputs' roles and digests (not their names)."""
        if self.known:
            return self.known
        inputs = sorted((ref.role, ref.kind, ref.digest) for ref in self.inputs)
        deciding = {name: value for name, value in self.config.items() if name not in self.aside}
        return digest_of([self.stage, self.revision, deciding, inputs, self.seed])

    def other_options(self, before: "Recipe") -> str:
        """Options of `before` that are other than here, and regions, which come and go with the work folder; in words,
        empty where there are none."""
        here, there = ({**one.config, "seed": one.seed} for one in (self, before))
        names = [k for k, value in there.items() if k not in self.aside and here.get(k, value) != value]
        given = [flags(f"--{name.replace('_', '-')}", there[name]) for name in names if not name.endswith("_digest")]
        told = [shlex.join(one) for one in given] or (["other files"] if names else [])
        return ", ".join(told + self._other_inputs(before, regions=True))

    def other_sources(self, before: "Recipe") -> str:
        """Inputs but for regions, and code, of `before` that are other than here: no option leads back to them."""
        told = self._other_inputs(before, regions=False)
        if (self.stage, self.revision) != (before.stage, before.revision):
            told.append(f"revision {before.revision} of {before.stage}")
        return ", ".join(told)

    def _other_inputs(self, before: "Recipe", regions: bool) -> list[str]:
        here, there = ({ref.role: ref for ref in one.inputs} for one in (self, before))
        told = []
        for role in sorted(here.keys() | there.keys()):
            ref = there.get(role) or here[role]
            if role.startswith("region.") == regions:
                if role not in there:
                    told.append(f"no {ref.kind} {ref.name}")
                elif role not in here:
                    told.append(f"{ref.kind} {ref.name}")
                elif here[role].digest != ref.digest:
                    told.append(f"{ref.kind} {ref.name} as it was")
        return told


@dataclass(frozen=True)
class FileRecord:
    """One file of an artifact: its path inside the folder with forward slashes, its length, its SHA-256."""

    path: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """manifest.json. `schema` counts the versions of this kind, `created` is UTC in ISO 8601, sizes are in MB = 1e6.

    `seconds` and `peak_memory_mb` cover all runs that an interrupted artifact took. `figures` is free to each stage.
    `threads`: of the run that finished it, None where an earlier version did not tell; sums over another number of
    threads round otherwise, so that the same recipe gives the same bytes only with as many.
    """

    kind: str
    schema: int
    name: str
    stage: str
    revision: int
    recipe: str
    config: dict
    inputs: list[InputRef]
    files: list[FileRecord]
    seed: int
    device: str
    versions: dict[str, str]
    seconds: float
    peak_memory_mb: float
    created: str
    figures: dict = field(default_factory=dict)
    threads: int | None = None

    @property
    def digest(self) -> str:
        """SHA-256 over kind, schema, recipe and files: the identity of the artifact, whatever its name."""
        return digest_of([self.kind, self.schema, self.recipe, [asdict(record) for record in self.files]])

    def to_bytes(self) -> bytes:
        """The text of manifest.json, sealed: `self_sha256` is the SHA-256 of the text with 64 zeros in its place."""
        content = {**plain(self), "self_sha256": "0" * 64}
        text = (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
        return _sealed(text)


def _sealed(text: bytes) -> bytes:
    seal = hashlib.sha256(text).hexdigest().encode()
    head, _, tail = text.rpartition(_BLANK)  # the last one: `figures` and `config` are free text and come before
    return head + _BLANK.replace(b"0" * 64, seal) + tail


def _seal_holds(text: bytes) -> bool:
    found = list(_SEAL.finditer(text))
    if not found:
        return False
    last = found[-1]
    blank = text[: last.start()] + _BLANK + text[last.end() :]
    return hashlib.sha256(blank).hexdigest().encode() == last.group(1)


def read_manifest(folder: Path) -> tuple[Manifest, str, int]:
    """The manifest of the artifact in `folder` at the current schema, and the digest and schema it was stored with.

    Returning the stored digest keeps artifacts that were made from this one up to date after a migration.

    Raises ArtifactDamaged when the manifest is missing or altered, ArtifactStale when a newer stylerf wrote it.
    """
    path = folder / MANIFEST
    try:
        text = read_bytes(path, MOST_BYTES, ArtifactDamaged)
    except FileNotFoundError:
        raise ArtifactDamaged(f"{folder} has no {MANIFEST}, so it is no finished artifact; make it again") from None
    if not _seal_holds(text):
        raise ArtifactDamaged(f"{path} was altered since it was written (its own digest differs); make it again")
    content = parsed(text.decode("utf-8", "replace"), str(path), ArtifactDamaged)
    if not isinstance(content, dict):
        raise ArtifactDamaged(f"{path} is no JSON object; make the artifact again")
    content.pop("self_sha256", None)
    stored = _digest_as_stored(content)
    manifest = _from_dict(migrated(content, folder), path)
    return manifest, stored, content["schema"]


def _digest_as_stored(content: dict) -> str:
    return digest_of([content.get(key) for key in ("kind", "schema", "recipe", "files")])


def _from_dict(content: dict, path: Path) -> Manifest:
    known = {item.name for item in fields(Manifest)}
    if missing := sorted(known - {"figures"} - content.keys()):
        raise ArtifactDamaged(f"{path} lacks {', '.join(missing)}; make the artifact again")
    if more := sorted(content.keys() - known):
        raise ArtifactDamaged(f"{path} holds unknown fields {', '.join(more)}; make the artifact again")
    try:
        return _checked(content)
    except (TypeError, ValueError, OverflowError, ArtifactDamaged) as error:
        raise ArtifactDamaged(f"{path} is not as a manifest is written ({error}); make the artifact again") from error


def _checked(content: dict) -> Manifest:
    """The manifest, every field of the type and range that others rely on; ValueError telling the first that is not."""
    for key, kinds in _TYPES.items():
        if type(content.get(key)) not in kinds:
            raise ValueError(f"{key} is a {type(content.get(key)).__name__}")
    for key, (low, high) in _RANGES.items():
        if not low <= content[key] <= high:
            raise ValueError(f"{key} is {content[key]}")
    if not _SHA256.fullmatch(content["recipe"]):
        raise ValueError("recipe is no SHA-256")
    if datetime.fromisoformat(content["created"]).tzinfo is None:
        raise ValueError("created names no time zone")
    for key in ("name", "stage"):
        file_name(content[key], key)
    if not all(isinstance(one, str) for pair in content["versions"].items() for one in pair):
        raise ValueError("versions are not text")
    inputs, files = [_input(one) for one in content["inputs"]], [_file(one) for one in content["files"]]
    folded = [unicodedata.normalize("NFC", one.path).casefold() for one in files]
    if len(set(folded)) < len(folded):
        raise ValueError("it lists a file twice")
    return Manifest(**{**content, "inputs": inputs, "files": files})


def _input(entry: Any) -> InputRef:
    ref = InputRef(**entry)
    file_name(ref.name, "name of an input")
    if ref.kind not in CURRENT or not isinstance(ref.role, str) or not _SHA256.fullmatch(ref.digest):
        raise ValueError(f"input {ref.name!r} has no kind, role and SHA-256")
    return ref


def _file(entry: Any) -> FileRecord:
    record = FileRecord(**entry)
    if relative_path(record.path, "path of a file").casefold() == MANIFEST:
        raise ValueError("it lists itself")
    if type(record.bytes) is not int or record.bytes < 0 or not _SHA256.fullmatch(record.sha256):
        raise ValueError(f"file {record.path!r} has no length and SHA-256")
    return record
