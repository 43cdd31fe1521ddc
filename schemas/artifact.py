"""A finished artifact: a folder that holds a manifest and the files that it lists."""

import shlex
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged, ArtifactStale
from schemas.manifest import MANIFEST, InputRef, Manifest, read_manifest
from schemas.migrations import current_arrays, current_json
from schemas.safe_reading import read_json
from schemas.tensors import load_tensors

# What a user types to get an artifact of each kind; WORK stands for the work folder.
MADE_BY: dict[str, str] = {
    "scene": "stylerf import PHOTOS WORK",
    "field": "stylerf fit WORK",
    "frames": "stylerf render WORK",
    "region": "stylerf select WORK",
    "edit-dataset": "stylerf extract WORK",
    "edit": "stylerf stylize WORK --region NAME",
    "report": "stylerf eval WORK",
}

# The verb that runs a stage; of a stage that is none of these only its own command knows how.
VERB_OF: dict[str, str] = {
    "pose_import": "import",
    "nerf_fit": "fit",
    "deform_init": "deform",
    "stylize": "stylize",
    "decompose": "stylize",
    "recolor": "stylize",
    "region_select": "select",
    "edit_dataset": "extract",
    "edit_learn": "stylize",
    "edit_palette": "stylize",
    "distill": "distill",
    "finetune": "finetune",
    "render": "render",
    "evaluate": "eval",
}


class Artifact:
    """A finished artifact on disk. Its manifest is read, and its seal checked, when first asked for.

    Its files are those that the manifest lists, and nothing on the way to them is a link. name: by which it can be
    found, the folder's own unless the folder is on its way to its place.
    """

    def __init__(self, path: Path, name: str | None = None) -> None:
        self.path = Path(path)
        self._name = name

    def __repr__(self) -> str:
        return f"Artifact({str(self.path)!r})"

    @cached_property
    def _read(self) -> tuple[Manifest, str, int]:
        return read_manifest(self.path)

    @property
    def manifest(self) -> Manifest:
        """The manifest, brought to the present schema."""
        return self._read[0]

    @property
    def kind(self) -> str:
        """Kind by manifest."""
        return self.manifest.kind

    @property
    def name(self) -> str:
        """Name of the folder, so that a renamed or copied artifact goes by the name it can be found under."""
        return self._name or self.path.name

    @property
    def digest(self) -> str:
        """Identity: SHA-256 over kind, schema, recipe and files as stored."""
        return self._read[1]

    def reference(self, role: str) -> InputRef:
        """This artifact as an input that plays `role`."""
        return InputRef(role, self.kind, self.name, self.digest)

    @cached_property
    def _listed(self) -> frozenset[str]:
        return frozenset(record.path for record in self.manifest.files)

    def has(self, relative: str) -> bool:
        """Whether the manifest lists a file of that path."""
        return relative in self._listed

    def file(self, relative: str) -> Path:
        """Path of one of its files; ArtifactDamaged where the manifest does not list it, or it is not there as a
        regular file."""
        if not self.has(relative):
            raise ArtifactDamaged(f"{self.path} lists no file {relative!r}; make it again: {self.remade_by()}")
        path = self.path / relative
        steps = [path, *path.parents[: relative.count("/")]]
        if link := next((step for step in reversed(steps) if step.is_symlink()), None):
            raise ArtifactDamaged(f"{link} is a link, which no artifact holds; make it again: {self.remade_by()}")
        if not path.is_file():
            raise ArtifactDamaged(f"{self.path} lacks {relative}; make it again: {self.remade_by()}")
        return path

    def json(self, relative: str) -> Any:
        """One of its JSON files as the current schema has it; ArtifactDamaged where it is absent or no JSON."""
        return current_json(read_json(self.file(relative), ArtifactDamaged), self._read[2])

    def tensors(self, relative: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Arrays and metadata of one of its safetensors files, named as in the current schema."""
        arrays, metadata = load_tensors(self.file(relative))
        return current_arrays(arrays, self._read[2]), metadata

    def check_sizes(self) -> None:
        """Quick check that every listed file is there with its length; ArtifactDamaged naming the first that is not."""
        for record in self.manifest.files:
            size = self.file(record.path).stat().st_size
            if size != record.bytes:
                raise ArtifactDamaged(
                    f"{self.path / record.path} has {size} bytes where {record.bytes} were written; make it again: "
                    f"{self.remade_by()}"
                )

    def verify(self) -> None:
        """Full check: seal of the manifest, digest of every file, nothing added (see of_a_desktop). ArtifactDamaged
        names what differs."""
        for earlier in ("_read", "_listed"):  # what is on disk now, not what was read before
            self.__dict__.pop(earlier, None)
        self.check_sizes()
        for record in self.manifest.files:
            if file_sha256(self.path / record.path) != record.sha256:
                raise ArtifactDamaged(
                    f"{self.path / record.path} was altered since it was written (its SHA-256 differs); make it "
                    f"again: {self.remade_by()}"
                )
        if added := added_files(self.path, {record.path for record in self.manifest.files}):
            raise ArtifactDamaged(f"{added[0]} is no part of this artifact; move it elsewhere")

    def remade_by(self) -> str:
        """What a user types to have it made again."""
        try:
            verb, config = VERB_OF[self.manifest.stage], self.manifest.config
        except (ArtifactDamaged, ArtifactStale, KeyError):
            return "run the command that made it with --force"
        source = [str(config.get("source", "PHOTOS"))] if verb == "import" else []
        work = str(self.path.parent.parent)
        command = shlex.join(["stylerf", verb, *source, work, "--name", self.name, "--force"])
        return f"{command}, with the options that are told by: {shlex.join(['stylerf', 'show', str(self.path)])}"


def added_files(folder: Path, listed: set[str]) -> list[Path]:
    """What lies in `folder` beside a manifest and the files that it lists by path, but for files of_a_desktop."""
    # A link to a folder counts: what lies behind it can change without a word.
    items = (item for item in folder.rglob("*") if item.is_symlink() or not (item.is_dir() or of_a_desktop(item)))
    return sorted(item for item in items if item.relative_to(folder).as_posix() not in listed | {MANIFEST})


def of_a_desktop(path: Path) -> bool:
    """Whether macOS, Windows or KDE leave files of that name in folders that they show."""
    return path.name.startswith("._") or path.name.lower() in (".ds_store", "thumbs.db", "desktop.ini", ".directory")
