"""An unfinished artifact: a locked folder that an interrupted run leaves behind and the next one resumes.

    WORK/<kind>/.<name>.partial/recipe.json    what is being made
                                files/         the files of the artifact
                                checkpoint/    what the stage needs to resume
                                clock.json     seconds and peak memory of the runs so far
                                ready/         the finished artifact, before it is moved into place
                                replaced/      the artifact that it replaces
    WORK/<kind>/.<name>.lock                   held while a process writes here; see schemas.lock

Committing hashes and flushes the files, writes the manifest last, and swaps `files` with the artifact of that name in
one rename. No run creates links here, so none are followed.
"""

import ctypes
import json
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from schemas.artifact import Artifact, added_files, is_desktop_file
from schemas.atomic_write import is_temporary, make_folder, sync_file, sync_folder, write_bytes, write_json, writing
from schemas.canonical_json import file_sha256, plain
from schemas.errors import ArtifactStale, OutOfResources, WouldBeLost
from schemas.lock import Lock
from schemas.manifest import MANIFEST, FileRecord, InputRef, Manifest, Recipe
from schemas.migrations import CURRENT

EXPENSIVE_SECONDS = 60.0  # work beyond this is not discarded silently
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


class UnlikeInterrupted(ArtifactStale):
    """An interrupted run with other options would be lost. seconds: its work so far; options: as text."""

    def __init__(self, kind: str, name: str, seconds: float, options: str) -> None:
        super().__init__(f"an interrupted run of {kind} {name} with {options} would be lost")
        self.seconds, self.options = seconds, options


class PartialArtifact:
    """A run in progress. The stage writes its files below `path` and its checkpoints below `checkpoint`.

    An interrupted run with another recipe is deleted.

    Args:
        protect: Keep an interrupted run of EXPENSIVE_SECONDS or more and raise UnlikeInterrupted if other options
            would resume it; if none can, delete it and describe it in `lost`.
        rebuild: Resume only a run that was started with `rebuild` too.

    Attributes:
        resumed: Whether an interrupted run of the same recipe is continued.

    Raises:
        UnlikeInterrupted: See `protect`.
        WouldBeLost: Files that no run wrote are where the artifact goes; commit() checks this too.
        OutOfResources: Another process is writing this artifact.
    """

    def __init__(
        self, root: Path, kind: str, name: str, recipe: Recipe, protect: bool = False, rebuild: bool = False
    ) -> None:
        self.rebuild = rebuild
        self.kind, self.name, self.recipe = kind, name, recipe
        self.target = root / kind / name
        self.folder = root / kind / f".{name}.partial"
        self.path = self.folder / "files"
        self.checkpoint = self.folder / "checkpoint"
        self.lost = ""
        self._lock = Lock(root / kind / f".{name}.lock")
        try:
            self._refuse_links()
            if self.folder.exists():
                self._lock.hold_folder(self.folder)
            # In this order: first undo what a killed swap left, then examine what is in the artifact's place.
            self._restore_replaced()
            self._restore_ready()
            self._refuse_to_bury()
            self.resumed = self._holds_same_run()
            if not self.resumed:
                if protect:
                    self._refuse_to_lose()
                self._start_afresh()
            self._store_recipe()
            make_folder(self.checkpoint)
            for leftover in [item for item in self.folder.rglob(".*") if is_temporary(item)]:
                leftover.unlink(missing_ok=True)
        except BaseException:
            self._lock.release()
            raise

    def _holds_same_run(self) -> bool:
        if not self.path.is_dir():  # finished: killed before it was cleaned up
            return False
        left = _stored(self.folder / "recipe.json")
        same = left.get("run", left.get("digest")) == self.recipe.run_digest
        return same and (not self.rebuild or left.get("rebuild") is True)

    def _refuse_to_lose(self) -> None:
        left = _stored(self.folder / "recipe.json")
        try:
            seconds = float(_stored(self.folder / "clock.json")["seconds"])
            known = {item.name: left[item.name] for item in fields(Recipe) if item.name in left}
            before = Recipe(**{**known, "inputs": [InputRef(**one) for one in left["inputs"]]})
            sources, options = self.recipe.other_sources(before), self.recipe.other_options(before)
        except (ValueError, KeyError, TypeError, AttributeError):
            return  # not resumable
        if seconds < EXPENSIVE_SECONDS or not self.path.is_dir():
            return
        if sources:
            self.lost = f"{seconds / 60:.0f} min of work with {sources}"
        elif options:
            raise UnlikeInterrupted(self.kind, self.name, seconds, options)

    def _refuse_links(self) -> None:
        """Raise WouldBeLost if the run's folder holds a link, pipe or device: the run would write through it."""
        if strange := next(_strange_in(self.folder), None):
            raise WouldBeLost(f"{strange} is a link or not a regular file, which runs never create; delete it")

    def _refuse_to_bury(self) -> None:
        """Raise WouldBeLost if the artifact would replace anything not listed in a manifest there."""
        if os.path.islink(self.target) and not self.target.exists():
            raise WouldBeLost(f"{self.target} is a broken link; delete it, or restore its target")
        if not self.target.exists():
            return
        # On macOS and Windows, Fit and fit are the same name.
        if (other := _stored_name(self.target)) != self.name:
            raise WouldBeLost(
                f"{self.kind} {other} would be replaced: on this disk {self.name} is the same name; give another --name"
            )
        listed = _listed_in(self.target)
        if listed is None:
            return
        added = added_files(self.target, listed) if self.target.is_dir() else [self.target]
        if added:
            raise WouldBeLost(
                f"{added[0]} would be deleted with the current {self.kind} {self.name}, whose manifest does not list "
                "it; move it elsewhere"
            )

    def _start_afresh(self) -> None:
        with writing(self.folder):
            # The folder's lock goes with the old folder; the lock file keeps others out until the new one is held.
            self._delete()
        make_folder(self.path)
        self._lock.hold_folder(self.folder)

    def _store_recipe(self) -> None:
        # Last: a folder without a recipe is never resumed, so a kill before this does no harm.
        digests = {"digest": self.recipe.digest, "run": self.recipe.run_digest}
        stored = {**asdict(self.recipe), **digests, "rebuild": self.rebuild}
        write_json(self.folder / "recipe.json", stored)

    def _restore_replaced(self) -> None:
        # Killed between the two renames of a swap that the disk cannot do in one: put the old artifact back.
        replaced = replaced_by(self.target.parent.parent, self.kind, self.name)
        if replaced.is_dir() and not os.path.lexists(self.target):
            os.rename(replaced, self.target)

    def _restore_ready(self) -> None:
        """Recover the files of a run that was killed while they were moved into place."""
        ready = self.folder / "ready"
        # `ready` is ours only before the swap; after it, `ready` is the artifact that was replaced.
        made = [_recipe_in(folder) == self.recipe.digest for folder in (ready, self.target)]
        if made == [True, False] and not self.path.exists():
            os.rename(ready, self.path)

    def commit(
        self,
        *,
        device: str = "cpu",
        threads: int | None = None,
        versions: dict[str, str] | None = None,
        seconds: float = 0.0,
        peak_memory_mb: float = 0.0,
        figures: dict[str, Any] | None = None,
    ) -> Artifact:
        """Finish the artifact and return it; then delete checkpoints and the artifact it replaces.

        A kill at any moment leaves either the older artifact, if any, and a resumable run, or the new artifact.
        """
        self._refuse_links()
        with writing(self.path):
            records = [self._record(item) for item in self._files()]
            manifest = Manifest(
                kind=self.kind,
                schema=CURRENT[self.kind],
                name=self.name,
                stage=self.recipe.stage,
                revision=self.recipe.revision,
                recipe=self.recipe.digest,
                config=plain(self.recipe.config),
                inputs=list(self.recipe.inputs),
                files=records,
                seed=self.recipe.seed,
                device=device,
                versions=dict(versions or {}),
                seconds=round(float(seconds), 3),
                peak_memory_mb=round(float(peak_memory_mb), 1),
                created=datetime.now(UTC).isoformat(timespec="milliseconds"),
                figures=plain(figures or {}),
                threads=threads,
            )
            self._refuse_to_bury()
            # Last of the files: a manifest makes them an artifact, so they must be on the disk before it.
            write_bytes(self.path / MANIFEST, manifest.to_bytes())
            self._swap()
            shutil.rmtree(self.folder, ignore_errors=True)
        self.release()
        return Artifact(self.target)

    def _files(self) -> list[Path]:
        """Return all files to keep, sorted by path; the manifest of an interrupted commit is deleted."""
        (self.path / MANIFEST).unlink(missing_ok=True)
        items = [item for item in self.path.rglob("*") if item.is_file()]
        items = [item for item in items if not is_temporary(item) and not is_desktop_file(item)]
        return sorted(items, key=lambda item: item.relative_to(self.path).as_posix())

    def _record(self, item: Path) -> FileRecord:
        sync_file(item)
        return FileRecord(item.relative_to(self.path).as_posix(), item.stat().st_size, file_sha256(item))

    def _swap(self) -> None:
        for folder in [*(item for item in self.path.rglob("*") if item.is_dir()), self.path]:
            sync_folder(folder)
        ready = self.folder / "ready"
        # `files` is gone from here on, which marks the run as finished; a kill leaves `ready` for _restore_ready().
        os.rename(self.path, ready)
        if not os.path.lexists(self.target):
            os.rename(ready, self.target)
        elif not _exchange(ready, self.target):
            os.rename(self.target, replaced_by(self.target.parent.parent, self.kind, self.name))
            os.rename(ready, self.target)
        sync_folder(self.target.parent)

    def discard(self) -> None:
        """Delete the run with its checkpoints."""
        with suppress(OSError):
            self._delete()
        self.release()

    def _delete(self) -> None:
        """Delete the recipe first, so that leftovers of a kill are never resumed."""
        (self.folder / "recipe.json").unlink(missing_ok=True)
        if self.folder.exists():
            shutil.rmtree(self.folder)

    def release(self) -> None:
        """Release the lock; the folder remains and can be resumed."""
        self._lock.release()


def replaced_by(root: Path, kind: str, name: str) -> Path:
    """Return where an artifact is kept while a newer one replaces it, if the disk cannot swap the two in one step."""
    return root / kind / f".{name}.partial" / "replaced"


def _stored(path: Path) -> dict[str, Any]:
    """Read one of the run's own JSON objects; {} if it is missing or damaged.

    Any other OSError is raised: a run on a disk that is temporarily unavailable must not be discarded.
    """
    try:
        found = json.loads(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _stored_name(path: Path) -> str:
    """Return the name of `path` as listed in its folder; its case may differ on case-insensitive disks."""
    names = os.listdir(path.parent)
    alike = [name for name in names if name.casefold() == path.name.casefold()]
    return path.name if path.name in names or not alike else alike[0]


def _recipe_in(folder: Path) -> str | None:
    return _stored(folder / MANIFEST).get("recipe")


def _strange_in(folder: Path) -> Iterator[Path]:
    """Yield everything that is neither a file nor a folder: `folder` itself, or anything below it."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        yield folder
        return
    for parent, folders, files in os.walk(folder):
        for name in (*folders, *files):
            with suppress(FileNotFoundError):
                mode = os.lstat(os.path.join(parent, name)).st_mode
                if not (stat.S_ISDIR(mode) or stat.S_ISREG(mode)):
                    yield Path(parent, name)


def _listed_in(folder: Path) -> set[str] | None:
    """Return the paths that a manifest lists, even if altered or of another version; empty if there is no manifest.

    None if the manifest cannot be read: such an artifact can only be rebuilt.
    """
    if not (folder / MANIFEST).is_file():
        return set()
    try:
        return {record["path"] for record in json.loads((folder / MANIFEST).read_bytes())["files"]}
    except (OSError, ValueError, RecursionError, KeyError, TypeError):
        return None


def sweep_finished(root: Path, kind: str, name: str) -> None:
    """Delete what is left of a run that was killed between committing and cleaning up; never a resumable run."""
    folder = root / kind / f".{name}.partial"
    if not folder.is_dir() or (folder / "files").is_dir():
        return
    with suppress(OutOfResources, WouldBeLost):  # another process works here, or the folder is read-only: skip it
        lock = Lock(root / kind / f".{name}.lock")
        try:
            lock.hold_folder(folder)
            if not (folder / "files").is_dir() and (root / kind / name).exists():
                shutil.rmtree(folder, ignore_errors=True)
        finally:
            lock.release()


def _exchange(one: Path, other: Path) -> bool:
    """Swap two folders in one step, if the system can (Linux), so that an artifact is in place at every moment."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):  # macOS has no such call, Windows no library of that name
        return False
    return bool(renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0)
