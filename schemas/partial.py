"""An artefact in the making: a locked folder that an interrupted run leaves behind and the next one goes on with.

    WORK/<kind>/.<name>.partial/recipe.json    what is being made
                                files/         the files of the artefact to be
                                checkpoint/    what the stage needs to go on, gone once it is finished
                                clock.json     seconds and peak memory of the runs so far
    WORK/<kind>/.<name>.lock                   held while a process writes here

Finishing hashes and flushes the files, writes the manifest last, and swaps `files` with the artefact of that name in
one rename.
"""

import ctypes
import errno
import fcntl
import json
import os
import shutil
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from schemas.artefact import Artefact, added_files, of_a_desktop
from schemas.atomic import is_temporary, make_folder, sync_file, sync_folder, write_bytes, write_json, writing
from schemas.canonical import file_sha256, plain
from schemas.errors import ArtefactStale, OutOfResources, WouldBeLost
from schemas.manifest import MANIFEST, FileRecord, InputRef, Manifest, Recipe
from schemas.migrations import CURRENT

DEAR_SECONDS = 60.0  # so much work goes without a word, no more
_HELD = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES}
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


class UnlikeInterrupted(ArtefactStale):
    """An interrupted run with other options would be lost. seconds: its work so far; options: in words."""

    def __init__(self, kind: str, name: str, seconds: float, options: str) -> None:
        super().__init__(f"an interrupted run of {kind} {name} with {options} would be lost")
        self.seconds, self.options = seconds, options


class Lock:
    """The right to write one artefact, or what else `path` tells. The system frees it when the process ends, however
    it ends."""

    def __init__(self, path: Path, instead: str = "give another --name") -> None:
        """Takes the lock at `path`; OutOfResources naming the holder's process when another one has it, or telling
        that the disk knows no locks. instead: what there is to do but wait."""
        make_folder(path.parent)
        with writing(path):
            self._handle: int | None = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.pread(self._handle, 32, 0).decode(errors="replace").strip() or "unknown"
            self.release()
            if error.errno not in _HELD:
                raise OutOfResources(
                    f"{path} cannot be locked ({error.strerror}), so nothing keeps two processes apart; choose a work "
                    "folder on a disk that can"
                ) from error
            name = path.name.removeprefix(".").removesuffix(".lock")
            raise OutOfResources(
                f"{path.parent.name} {name} is being written by another process ({holder}); wait for it to end, or "
                f"{instead}"
            ) from error
        with suppress(OSError):  # only so that the other side can name us; a full disk is met soon enough
            os.ftruncate(self._handle, 0)
            os.pwrite(self._handle, f"{os.getpid()}\n".encode(), 0)

    def release(self) -> None:
        """Gives the lock back; harmless when it was given back before."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


class Partial:
    """A run in progress. The stage writes its files below `path` and its checkpoints below `checkpoint`.

    `resumed` tells that an earlier run of the same recipe left something here; with `anew` one that was begun so,
    too. What a run with other options left is deleted; with `careful`, where that is a minute's work or more, it is
    kept and UnlikeInterrupted raised, or, where no option goes on with it, `lost` tells what was deleted. Where files
    lie at the artefact's place that no run wrote, no run begins or finishes (WouldBeLost).
    """

    def __init__(
        self, root: Path, kind: str, name: str, recipe: Recipe, careful: bool = False, anew: bool = False
    ) -> None:
        self.anew = anew
        self.kind, self.name, self.recipe = kind, name, recipe
        self.target = root / kind / name
        self.folder = root / kind / f".{name}.partial"
        self.path = self.folder / "files"
        self.checkpoint = self.folder / "checkpoint"
        self.lost = ""
        self._lock = Lock(root / kind / f".{name}.lock")
        try:
            self._restore_replaced()
            self._restore_ready()
            self._refuse_to_bury()
            self.resumed = self._holds_same_recipe()
            if not self.resumed:
                if careful:
                    self._refuse_to_lose()
                self._start_afresh()
            make_folder(self.checkpoint)
            for leftover in [item for item in self.folder.rglob(".*") if is_temporary(item)]:
                leftover.unlink(missing_ok=True)
        except BaseException:
            self._lock.release()
            raise

    def _holds_same_recipe(self) -> bool:
        # `files` is gone from the moment a run is finished, so what a kill after that left behind is not resumed.
        if not self.path.is_dir():
            return False
        try:
            left = json.loads((self.folder / "recipe.json").read_text())
            return left["digest"] == self.recipe.digest and (not self.anew or left.get("anew") is True)
        except (OSError, ValueError, KeyError, TypeError):
            return False

    def _refuse_to_lose(self) -> None:
        try:
            left = json.loads((self.folder / "recipe.json").read_text())
            seconds = float(json.loads((self.folder / "clock.json").read_text())["seconds"])
            del left["digest"]
            left.pop("anew", None)
            before = Recipe(**{**left, "inputs": [InputRef(**one) for one in left["inputs"]]})
        except (OSError, ValueError, KeyError, TypeError):
            return  # nothing that could go on
        if seconds < DEAR_SECONDS or not self.path.is_dir():
            return
        if sources := self.recipe.other_sources(before):
            self.lost = f"{seconds / 60:.0f} min of work with {sources}"
        elif options := self.recipe.other_options(before):
            raise UnlikeInterrupted(self.kind, self.name, seconds, options)

    def _refuse_to_bury(self) -> None:
        """WouldBeLost where something stands in the artefact's place that no manifest there lists."""
        if os.path.islink(self.target) and not self.target.exists():
            raise WouldBeLost(f"{self.target} is a link to nothing; delete it, or mend what it leads to")
        if not self.target.exists():
            return
        listed = _listed_in(self.target)
        if listed is None:
            return
        added = added_files(self.target, listed) if self.target.is_dir() else [self.target]
        if added:
            raise WouldBeLost(
                f"{added[0]} would be deleted with what stands as {self.kind} {self.name}, whose manifest does not "
                "list it; move it elsewhere"
            )

    def _start_afresh(self) -> None:
        with writing(self.folder):
            self._delete()
        make_folder(self.path)
        told = {**asdict(self.recipe), "digest": self.recipe.digest, "anew": self.anew}
        write_json(self.folder / "recipe.json", told)

    def _restore_replaced(self) -> None:
        replaced = self.folder / "replaced"
        if replaced.is_dir() and not os.path.lexists(self.target):
            os.rename(replaced, self.target)

    def _restore_ready(self) -> None:
        """A run that was killed after its last file and before its artefact stood goes on from there."""
        ready = self.folder / "ready"
        made = [_recipe_in(folder) == self.recipe.digest for folder in (ready, self.target)]
        if made == [True, False] and not self.path.exists():
            os.rename(ready, self.path)

    def commit(
        self,
        *,
        device: str = "cpu",
        versions: dict[str, str] | None = None,
        seconds: float = 0.0,
        peak_memory_mb: float = 0.0,
        figures: dict[str, Any] | None = None,
    ) -> Artefact:
        """Finishes the artefact and returns it; checkpoints and the artefact it replaces are deleted after.

        A kill at any moment leaves either the older artefact (or none) with this run resumable, or the new one.
        """
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
            )
            self._refuse_to_bury()
            write_bytes(self.path / MANIFEST, manifest.to_bytes())
            self._swap()
            shutil.rmtree(self.folder, ignore_errors=True)
        self.release()
        return Artefact(self.target)

    def _files(self) -> list[Path]:
        """All files to keep, in the order of their names; an interrupted run's manifest is written anew."""
        (self.path / MANIFEST).unlink(missing_ok=True)
        items = (item for item in self.path.rglob("*") if item.is_file())
        items = [item for item in items if not is_temporary(item) and not of_a_desktop(item)]
        return sorted(items, key=lambda item: item.relative_to(self.path).as_posix())

    def _record(self, item: Path) -> FileRecord:
        sync_file(item)
        return FileRecord(item.relative_to(self.path).as_posix(), item.stat().st_size, file_sha256(item))

    def _swap(self) -> None:
        for folder in [*(item for item in self.path.rglob("*") if item.is_dir()), self.path]:
            sync_folder(folder)
        ready = self.folder / "ready"
        os.rename(self.path, ready)
        if not os.path.lexists(self.target):
            os.rename(ready, self.target)
        elif not _exchange(ready, self.target):
            os.rename(self.target, self.folder / "replaced")
            os.rename(ready, self.target)
        sync_folder(self.target.parent)

    def discard(self) -> None:
        """Deletes the run with its checkpoints."""
        with suppress(OSError):
            self._delete()
        self.release()

    def _delete(self) -> None:
        """The recipe goes first: what a kill leaves of the rest is never taken up again."""
        (self.folder / "recipe.json").unlink(missing_ok=True)
        if self.folder.exists():
            shutil.rmtree(self.folder)

    def release(self) -> None:
        """Lets others write here; the folder stays and can be resumed."""
        self._lock.release()


def _recipe_in(folder: Path) -> str | None:
    try:
        return json.loads((folder / MANIFEST).read_text())["recipe"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _listed_in(folder: Path) -> set[str] | None:
    """Paths that a manifest lists, also one of another version or with an altered byte; none where there is none.

    None where there is one that cannot be read: an artefact that is to be made again, as whoever asks for it is told.
    """
    if not (folder / MANIFEST).is_file():
        return set()
    try:
        return {record["path"] for record in json.loads((folder / MANIFEST).read_text())["files"]}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def sweep_finished(root: Path, kind: str, name: str) -> None:
    """Deletes what a run left that was killed between its last rename and its own tidying up; never a resumable run."""
    folder = root / kind / f".{name}.partial"
    if not folder.is_dir() or (folder / "files").is_dir():
        return
    with suppress(OutOfResources):  # another process is at work here, or we may not write: no harm done
        lock = Lock(root / kind / f".{name}.lock")
        try:
            if not (folder / "files").is_dir() and (root / kind / name).exists():
                shutil.rmtree(folder, ignore_errors=True)
        finally:
            lock.release()


def _exchange(one: Path, other: Path) -> bool:
    """Swaps two folders in one step where the system can (Linux), so that there is no moment without an artefact."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    return renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0
