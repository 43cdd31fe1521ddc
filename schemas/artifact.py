"""A finished artifact: a folder with a manifest and the files that it lists."""

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

# The command that makes each kind of artifact; WORK is the work folder.
MADE_BY: dict[str, str] = {
    "scene": "stylerf import PHOTOS WORK",
    "field": "stylerf fit WORK",
    "frames": "stylerf render WORK",
    "region": "stylerf select WORK",
    "edit-dataset": "stylerf extract WORK",
    "edit": "stylerf stylize WORK --region NAME",
    "export": "stylerf export WORK",
    "report": "stylerf eval WORK",
}

# The verb that runs each stage. Other stages, such as those of `stylerf stress`, have no verb of their own.
VERB_OF: dict[str, str] = {
    "pose_import": "import",
    "nerf_fit": "fit",
    "deform_init": "deform",
    "stylize": "stylize",
    "decompose": "stylize",
    "recolor": "stylize",
    "blend": "blend",
    "region_select": "select",
    "edit_dataset": "extract",
    "edit_learn": "stylize",
    "edit_palette": "stylize",
    "distill": "distill",
    "finetune": "finetune",
    "render": "render",
    "export": "export",
    "evaluate": "eval",
}


class Artifact:
    """A finished artifact on disk. Reads the manifest, and checks its own digest, on first use.

    Only files listed in the manifest belong to it, and they are never reached through a symbolic link.

    Args:
        name: The artifact's name if the folder, not yet moved into place, has another one.
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
        """The manifest, migrated to the current schema."""
        return self._read[0]

    @property
    def kind(self) -> str:
        """The kind recorded in the manifest."""
        return self.manifest.kind

    @property
    def name(self) -> str:
        """The folder's name, which may differ from the manifest's after a rename or a copy."""
        return self._name or self.path.name

    @property
    def digest(self) -> str:
        """The artifact's identity: SHA-256 of kind, schema, recipe and files as stored."""
        return self._read[1]

    def reference(self, role: str) -> InputRef:
        """Return a reference to this artifact as the input `role` of another."""
        return InputRef(role, self.kind, self.name, self.digest)

    @cached_property
    def _listed(self) -> frozenset[str]:
        return frozenset(record.path for record in self.manifest.files)

    def has(self, relative: str) -> bool:
        """Whether the manifest lists this file."""
        return relative in self._listed

    def file(self, relative: str) -> Path:
        """Return the path of a listed file; ArtifactDamaged if it is not listed or not a regular file."""
        if not self.has(relative):
            raise ArtifactDamaged(f"{self.path} lists no file {relative!r}; rebuild it: {self.rebuild_command()}")
        path = self.path / relative
        steps = [path, *path.parents[: relative.count("/")]]
        if link := next((step for step in reversed(steps) if step.is_symlink()), None):
            raise ArtifactDamaged(
                f"{link} is a link, which artifacts must not contain; rebuild it: {self.rebuild_command()}"
            )
        if not path.is_file():
            raise ArtifactDamaged(f"{self.path} lacks {relative}; rebuild it: {self.rebuild_command()}")
        return path

    def json(self, relative: str) -> Any:
        """Read a listed JSON file, migrated to the current schema; ArtifactDamaged if missing or invalid."""
        return current_json(read_json(self.file(relative), ArtifactDamaged), self._read[2])

    def tensors(self, relative: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Read arrays and metadata of a listed safetensors file, under the current schema's names."""
        arrays, metadata = load_tensors(self.file(relative))
        return current_arrays(arrays, self._read[2]), metadata

    def check_sizes(self) -> None:
        """Check that every listed file exists with its recorded size; ArtifactDamaged names the first mismatch."""
        for record in self.manifest.files:
            size = self.file(record.path).stat().st_size
            if size != record.bytes:
                raise ArtifactDamaged(
                    f"{self.path / record.path} has {size} bytes, but {record.bytes} were written; rebuild it: "
                    f"{self.rebuild_command()}"
                )

    def verify(self) -> None:
        """Check the digests of the manifest and of every file, and that no file was added (see is_desktop_file).

        Raises:
            ArtifactDamaged: Naming what differs.
        """
        for cached in ("_read", "_listed"):  # check what is on disk now
            self.__dict__.pop(cached, None)
        self.check_sizes()
        for record in self.manifest.files:
            if file_sha256(self.path / record.path) != record.sha256:
                raise ArtifactDamaged(
                    f"{self.path / record.path} was altered since it was written (its SHA-256 differs); rebuild it: "
                    f"{self.rebuild_command()}"
                )
        if added := added_files(self.path, {record.path for record in self.manifest.files}):
            raise ArtifactDamaged(f"{added[0]} is not part of this artifact; move it elsewhere")

    def rebuild_command(self) -> str:
        """Return the command line that rebuilds this artifact."""
        try:
            verb, config = VERB_OF[self.manifest.stage], self.manifest.config
        except (ArtifactDamaged, ArtifactStale, KeyError):
            return "run the command that made it with --force"
        source = [str(config.get("source", "PHOTOS"))] if verb == "import" else []
        work = str(self.path.parent.parent)
        command = shlex.join(["stylerf", verb, *source, work, "--name", self.name, "--force"])
        return f"{command}, with the options shown by: {shlex.join(['stylerf', 'show', str(self.path)])}"


def added_files(folder: Path, listed: set[str]) -> list[Path]:
    """Return files in `folder` that are neither its manifest, nor `listed`, nor created by a desktop."""
    # A link to a folder counts as a file: its target may change unnoticed.
    items = (item for item in folder.rglob("*") if item.is_symlink() or not (item.is_dir() or is_desktop_file(item)))
    return sorted(item for item in items if item.relative_to(folder).as_posix() not in listed | {MANIFEST})


def is_desktop_file(path: Path) -> bool:
    """Return whether macOS, Windows or KDE leave files of this name in folders that they display."""
    return path.name.startswith("._") or path.name.lower() in (".ds_store", "thumbs.db", "desktop.ini", ".directory")
