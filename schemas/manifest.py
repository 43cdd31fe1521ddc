"""The manifest of an artifact: its kind, inputs, recipe, measurements, and the digests of its files."""

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
from schemas.migrations import CURRENT, Json, migrated
from schemas.safe_names import file_name, flags, relative_path
from schemas.safe_reading import parsed, read_bytes

MANIFEST = "manifest.json"
MOST_BYTES = 64 << 20  # a manifest of 10,000 files takes 2 MB
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
    """An input of an artifact: another artifact, the role it played, and its digest at the time."""

    role: str
    kind: str
    name: str
    digest: str


@dataclass(frozen=True)
class Recipe:
    """Everything that determines what a stage makes. Equal recipes make equal artifacts, so one is reused.

    Attributes:
        incidental: Options that are recorded but do not affect the result, such as the path of a file.
        extent: Options that set how far a run goes: an interrupted run with other values of them is resumed.
        stored_digest: Digest of a recipe read from a manifest, which does not record incidental options.
    """

    stage: str
    revision: int
    config: Json
    inputs: list[InputRef]
    seed: int = 0
    incidental: Sequence[str] = ()
    extent: Sequence[str] = ()
    stored_digest: str = ""

    @property
    def digest(self) -> str:
        """SHA-256 of stage, revision, options, seed, and the roles and digests (not the names) of the inputs."""
        if self.stored_digest:
            return self.stored_digest
        return self._digest_without(self.incidental)

    @property
    def run_digest(self) -> str:
        """The digest without the extent: runs that share it resume one another."""
        return self._digest_without((*self.incidental, *self.extent)) if self.extent else self.digest

    def _digest_without(self, options: Sequence[str]) -> str:
        inputs = sorted((ref.role, ref.kind, ref.digest) for ref in self.inputs)
        deciding = {name: value for name, value in self.config.items() if name not in options}
        return digest_of([self.stage, self.revision, deciding, inputs, self.seed])

    def other_options(self, before: "Recipe") -> str:
        """Describe the options and regions of `before` that differ from these; "" if none do."""
        here, there = ({**one.config, "seed": one.seed} for one in (self, before))
        names = [k for k, value in there.items() if k not in self.incidental and here.get(k, value) != value]
        changed = [flags(f"--{name.replace('_', '-')}", there[name]) for name in names if not name.endswith("_digest")]
        texts = [shlex.join(one) for one in changed] or (["other files"] if names else [])
        return ", ".join(texts + self._other_inputs(before, regions=True))

    def other_sources(self, before: "Recipe") -> str:
        """Describe the inputs (other than regions) and the code of `before` that differ; no option can restore them."""
        texts = self._other_inputs(before, regions=False)
        if (self.stage, self.revision) != (before.stage, before.revision):
            texts.append(f"revision {before.revision} of {before.stage}")
        return ", ".join(texts)

    def _other_inputs(self, before: "Recipe", regions: bool) -> list[str]:
        here, there = ({ref.role: ref for ref in one.inputs} for one in (self, before))
        texts = []
        for role in sorted(here.keys() | there.keys()):
            ref = there.get(role) or here[role]
            if role.startswith("region.") == regions:
                if role not in there:
                    texts.append(f"no {ref.kind} {ref.name}")
                elif role not in here:
                    texts.append(f"{ref.kind} {ref.name}")
                elif here[role].digest != ref.digest:
                    texts.append(f"{ref.kind} {ref.name} as it was")
        return texts


@dataclass(frozen=True)
class FileRecord:
    """One file of an artifact: its path inside the folder (forward slashes), size and SHA-256."""

    path: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """The contents of manifest.json.

    Attributes:
        schema: Version of the format of this kind.
        seconds: Wall time, summed over interrupted runs.
        peak_memory_mb: Largest of those runs, MB = 1e6 bytes.
        created: UTC, ISO 8601.
        figures: Measurements, different for each stage.
        threads: Of the run that finished; None in artifacts of schema 1. The same recipe gives the same bytes only with
            the same number of threads, as sums are split among them.
    """

    kind: str
    schema: int
    name: str
    stage: str
    revision: int
    recipe: str
    config: Json
    inputs: list[InputRef]
    files: list[FileRecord]
    seed: int
    device: str
    versions: dict[str, str]
    seconds: float
    peak_memory_mb: float
    created: str
    figures: Json = field(default_factory=dict)
    threads: int | None = None

    @property
    def digest(self) -> str:
        """The artifact's identity, whatever its name: SHA-256 of kind, schema, recipe and files."""
        return digest_of([self.kind, self.schema, self.recipe, [asdict(record) for record in self.files]])

    def to_bytes(self) -> bytes:
        """Encode as manifest.json; `self_sha256` is the SHA-256 of the text with 64 zeros in its place."""
        content = {**plain(self), "self_sha256": "0" * 64}
        text = (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
        return sealed(text)


def sealed(text: bytes) -> bytes:
    """Return the JSON of a manifest with the digest of its text in place of the blank one."""
    seal = hashlib.sha256(text).hexdigest().encode()
    head, _, tail = text.rpartition(_BLANK)  # the last match: free text in `config` or `figures` may contain another
    return head + _BLANK.replace(b"0" * 64, seal) + tail


def _seal_holds(text: bytes) -> bool:
    found = list(_SEAL.finditer(text))
    if not found:
        return False
    last = found[-1]
    blank = text[: last.start()] + _BLANK + text[last.end() :]
    return hashlib.sha256(blank).hexdigest().encode() == last.group(1)


def read_manifest(folder: Path) -> tuple[Manifest, str, int]:
    """Read the manifest of the artifact in `folder`.

    Returns:
        The manifest, migrated to the current schema; the artifact's digest as stored, by which artifacts made from this
        one stay up to date after a migration; and the schema as stored.

    Raises:
        ArtifactDamaged: The manifest is missing, altered or invalid.
        ArtifactStale: A newer stylerf wrote it.
    """
    path = folder / MANIFEST
    try:
        text = read_bytes(path, MOST_BYTES, ArtifactDamaged)
    except FileNotFoundError:
        raise ArtifactDamaged(f"{folder} has no {MANIFEST}, so it is not a finished artifact; rebuild it") from None
    if not _seal_holds(text):
        raise ArtifactDamaged(f"{path} was altered since it was written (its own digest differs); rebuild it")
    content = parsed(text.decode("utf-8", "replace"), str(path), ArtifactDamaged)
    if not isinstance(content, dict):
        raise ArtifactDamaged(f"{path} is not a JSON object; rebuild the artifact")
    content.pop("self_sha256", None)
    stored = _digest_as_stored(content)
    manifest = _from_dict(migrated(content, folder), path)
    return manifest, stored, content["schema"]


def _digest_as_stored(content: Json) -> str:
    return digest_of([content.get(key) for key in ("kind", "schema", "recipe", "files")])


def _from_dict(content: Json, path: Path) -> Manifest:
    known = {item.name for item in fields(Manifest)}
    if missing := sorted(known - {"figures"} - content.keys()):
        raise ArtifactDamaged(f"{path} lacks {', '.join(missing)}; rebuild the artifact")
    if more := sorted(content.keys() - known):
        raise ArtifactDamaged(f"{path} contains unknown fields {', '.join(more)}; rebuild the artifact")
    try:
        return _checked(content)
    except (TypeError, ValueError, OverflowError, ArtifactDamaged) as error:
        raise ArtifactDamaged(f"{path} is not a valid manifest ({error}); rebuild the artifact") from error


def _checked(content: Json) -> Manifest:
    """Check the type and range of every field; ValueError names the first invalid one."""
    for key, kinds in _TYPES.items():
        if type(content.get(key)) not in kinds:
            raise ValueError(f"{key} is a {type(content.get(key)).__name__}")
    for key, (low, high) in _RANGES.items():
        if not low <= content[key] <= high:
            raise ValueError(f"{key} is {content[key]}")
    if not _SHA256.fullmatch(content["recipe"]):
        raise ValueError("recipe is not a SHA-256")
    if datetime.fromisoformat(content["created"]).tzinfo is None:
        raise ValueError("created has no time zone")
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
    if type(record.bytes) is not int or not 0 <= record.bytes < 1 << 63 or not _SHA256.fullmatch(record.sha256):
        raise ValueError(f"file {record.path!r} has no length and SHA-256")
    return record
