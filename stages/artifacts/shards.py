"""Shards of a render job: frames whose recipes differ only in their range, merged without rendering them again."""

import os
import shutil
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath

from schemas.atomic_write import make_folder, replacing
from schemas.canonical_json import file_sha256
from schemas.errors import StylerfError
from schemas.frames import Frame
from schemas.journal import Journal
from schemas.manifest import FileRecord, Manifest
from schemas.work_folder import Artifact, PartialArtifact, Recipe, WorkFolder

NOT_PICTURED = ("frames", "video", "fps")  # options that do not affect pictures


def take_frames(partial: PartialArtifact, frames: Sequence[Frame], journal: Journal) -> dict[str, list[str]]:
    """Put the shards' files of `frames` below `partial.path` and record them; return the names taken, by shard.

    Files are hard-linked if the disk can, otherwise copied. Files altered since they were written are not taken.
    """
    taken: dict[str, list[str]] = {}
    for shard in _shards(partial):
        files = _files_by_frame(shard.manifest)
        for frame in frames:
            records = files.get(frame.name, [])
            if records and not (partial.path / frame.png).exists() and all(_sound(shard, one) for one in records):
                for record in records:
                    _place(shard.path / record.path, partial.path / record.path)
                journal.add(record.path for record in records)
                taken.setdefault(shard.name, []).append(frame.name)
    return taken


def _shards(partial: PartialArtifact) -> Iterator[Artifact]:
    wanted = _pictured(partial.recipe)
    for one in WorkFolder(partial.target.parent.parent).artifacts(partial.kind):
        with suppress(StylerfError):  # skip one that cannot be read
            made = one.manifest
            recipe = Recipe(made.stage, made.revision, made.config, made.inputs, made.seed)
            if made.config.get("frames") and _pictured(recipe) == wanted:
                yield one


def _pictured(recipe: Recipe) -> str:
    # A camera file is identified by its content.
    idle = (*NOT_PICTURED, "path") if recipe.config.get("path_digest") else NOT_PICTURED
    config = {name: value for name, value in recipe.config.items() if name not in idle}
    return Recipe(recipe.stage, recipe.revision, config, recipe.inputs, recipe.seed).digest


def _files_by_frame(made: Manifest) -> dict[str, list[FileRecord]]:
    found = defaultdict(list)
    for record in made.files:
        kind, *name = PurePosixPath(record.path).with_suffix("").parts
        if name:  # masks/REGION/FRAME; a frame's name may have folders
            found["/".join(name[1:] if kind == "masks" else name)].append(record)
    return found


def _sound(shard: Artifact, record: FileRecord) -> bool:
    with suppress(OSError):
        return file_sha256(shard.path / record.path) == record.sha256
    return False


def _place(source: Path, target: Path) -> None:
    make_folder(target.parent)
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:
        with replacing(target) as temporary:
            shutil.copyfile(source, temporary)
