"""COLMAP's database: photos, cameras, features, pairs to match. Each step skips what an interrupted run has finished.

A damaged database (see Rows) is rebuilt.
"""

import hashlib
import json
import re
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np

from schemas.atomic_write import write_bytes
from schemas.errors import BadInput
from stages.sfm.job import Job, JobProgress
from stages.sfm.photo_copies import COPIES, MASKS, Copy
from stylerf.environment.colmap import pycolmap

# Above this many photos `auto` matches only neighbors, if the names are numbered like frames: all pairs grow with the
# square.
MOST_FOR_ALL_PAIRS = 80
# The number of neighbors that a frame is compared with, and the interval of key frames.
OVERLAP, KEY_FRAME_EVERY = 10, 8
_NUMBER = re.compile(r"(\d+)(?=\D*$)")


def chosen_matching(wanted: str, names: list[str], video: bool = False) -> tuple[str, str]:
    """Return exhaustive or sequential, and the reason as text. names: file names in order; video: they are frames."""
    if wanted != "auto":
        return wanted, "as requested"
    if len(names) <= MOST_FOR_ALL_PAIRS:
        return "exhaustive", f"{len(names)} photos are few enough to compare all pairs"
    if video:
        return "sequential", "frames of video follow each other"
    if _are_frames(names):
        return "sequential", f"the names of the {len(names)} photos are numbered like frames"
    return "exhaustive", f"the names of the {len(names)} photos are not numbered like frames, so any two may overlap"


def _are_frames(names: list[str]) -> bool:
    found = [match for name in names if (match := _NUMBER.search(name))]
    if len(found) < len(names):
        return False
    stems = {match.string[: match.start()] for match in found}
    numbers = [int(match.group()) for match in found]
    steps = [after - before for before, after in pairwise(numbers)]
    # Dropped frames leave gaps, but most steps of a sampled video are equal.
    return (
        len(stems) == 1
        and all(step > 0 for step in steps)
        and steps.count(max(steps, key=steps.count)) > len(steps) / 2
    )


def pairs(count: int, matching: str, clips: Sequence[int] = ()) -> list[tuple[int, int]]:
    """Index pairs (i < j), near ones first.

    exhaustive: all. sequential: frames up to OVERLAP apart, those 2^k apart, and all pairs of key frames, which close
    the loop where a walk comes back. clips: the number of each frame's clip; frames of two clips are not neighbors, and
    twice as many of them are key frames, since nothing else joins their clips.
    """
    if matching == "exhaustive":
        return [(i, i + gap) for gap in range(1, count) for i in range(count - gap)]
    of = list(clips) or [0] * count
    gaps = sorted({*range(1, OVERLAP + 1), *(2**k for k in range(count.bit_length()))})
    near = [(i, i + gap) for gap in gaps for i in range(count - gap) if of[i] == of[i + gap]]
    keys = range(0, count, KEY_FRAME_EVERY)
    between = range(0, count, KEY_FRAME_EVERY // 2)
    far = {(i, j) for i in keys for j in keys if i < j and of[i] == of[j]}
    far |= {(i, j) for i in between for j in between if i < j and of[i] != of[j]}
    return near + sorted(far - set(near))


# Tables that are computed row by row, so that a lost row is simply recomputed.
COMPUTED = ("keypoints", "descriptors", "matches", "two_view_geometries")
INPUTS = ("rigs", "rig_sensors", "cameras", "frames", "frame_data", "images", "pose_priors")


class Rows:
    """The digests in the file at `journal` of the rows of the database at `path`. Lines cut short are passed over."""

    def __init__(self, path: Path, journal: Path) -> None:
        self._path, self._journal = path, journal
        self._digests: dict[tuple[str, int], str] = {}
        if journal.is_file():
            for line in journal.read_text("utf-8", "replace").splitlines():
                try:
                    table, number, digest = json.loads(line)
                    self._digests[str(table), int(number)] = str(digest)
                except (ValueError, TypeError, RecursionError):
                    continue

    def record(self) -> None:
        """Record the digests of all rows that have none yet."""
        with closing(self._open()) as database:
            fresh = {row: _digest(database, *row) for row in _stored_rows(database) if row not in self._digests}
        # A separate line even if an earlier write was cut short.
        text = "\n" + "".join(json.dumps([*row, digest]) + "\n" for row, digest in fresh.items())
        with open(self._journal, "a", encoding="utf-8") as stream:
            stream.write(text)
        self._digests |= fresh

    def sound(self) -> bool:
        """Return whether all rows with a digest are unchanged. Computed rows without one, from an interrupted step, are
        deleted, so that they are computed again."""
        try:
            with closing(self._open()) as database:
                held = set(_stored_rows(database))
                unknown = held - self._digests.keys()
                if not self._digests.keys() <= held or any(table in INPUTS for table, _ in unknown):
                    return False
                if any(_digest(database, *row) != digest for row, digest in self._digests.items()):
                    return False
                for table, number in unknown:
                    database.execute(f"DELETE FROM {table} WHERE rowid = ?", (number,))
                database.commit()
        except sqlite3.Error:
            return False
        return bool(self._digests)

    def _open(self) -> sqlite3.Connection:
        return sqlite3.connect(f"{self._path.absolute().as_uri()}?mode=rw", uri=True)


def _stored_rows(database: sqlite3.Connection) -> Iterator[tuple[str, int]]:
    for table in (*INPUTS, *COMPUTED):
        for (number,) in database.execute(f"SELECT rowid FROM {table} ORDER BY rowid").fetchall():
            yield table, number


def _digest(database: sqlite3.Connection, table: str, number: int) -> str:
    found = hashlib.sha256()
    for value in database.execute(f"SELECT * FROM {table} WHERE rowid = ?", (number,)).fetchone():
        part = value if isinstance(value, bytes) else repr(value).encode("utf-8", "surrogatepass")
        found.update(b"%d " % len(part) + part)
    return found.hexdigest()


DATABASE, REGISTERED, ROWS = "database.db", "registered", "rows.jsonl"
# One radial coefficient: with few photos, more of them would explain errors away; refinement adds the second.
CAMERA_MODEL = "SIMPLE_RADIAL"
PHOTOS_AT_ONCE = 4
# The octave of twice the photo's size costs four times all others and holds the least repeatable features: it is
# searched only in photos so small (longest side) that they would have few without.
SMALL_PHOTO = 800


def register(job: Job, copies: list[Copy], progress: JobProgress) -> Path:
    """Create the database with its cameras and photos in a fixed order, so that numbers are reproducible."""
    folder = Path(job.folder)
    path, done = folder / DATABASE, folder / REGISTERED
    if done.is_file():
        if rows_of(path).sound():
            return path
        progress.say("warning: the features and matches of the interrupted run are damaged; recomputing them")
    for leftover in (done, folder / ROWS, *folder.glob(f"{DATABASE}*")):  # with its journal
        leftover.unlink(missing_ok=True)
    pycolmap.Database.open(path).close()
    for group in _by_lens(job, copies):
        options = pycolmap.ImageReaderOptions()
        options.camera_model = CAMERA_MODEL
        first = group[0]
        if first.focal:
            options.camera_params = f"{first.focal},{first.size[0] / 2},{first.size[1] / 2},0"
        mode = pycolmap.CameraMode.SINGLE
        pycolmap.import_images(path, folder / COPIES, mode, [copy.file for copy in group], options)
    with pycolmap.Database.open(path) as database:
        found = database.num_images()
    if found != len(copies):
        raise BadInput(f"COLMAP accepted only {found} of {len(copies)} photos; remove unusual ones and run again")
    rows_of(path).record()
    write_bytes(done, b"")
    return path


def rows_of(path: Path) -> Rows:
    """Return the digests of the rows of the job's database at `path`."""
    return Rows(path, path.with_name(ROWS))


def _by_lens(job: Job, copies: list[Copy]) -> list[list[Copy]]:
    """Group the copies that share a camera; the zoom of a clip of video is unknown, so each has its own."""
    if not job.shared:
        return [[copy] for copy in copies]
    groups: dict[tuple[str, int], list[Copy]] = {}
    for copy in copies:
        groups.setdefault((copy.lens, _clip_of(job, copy)), []).append(copy)
    return list(groups.values())


def extract(job: Job, path: Path, copies: list[Copy], progress: JobProgress) -> None:
    """Compute SIFT features of every photo; BadInput if hardly any photo has some."""
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = job.threads, False
    options.sift.max_num_features = job.features
    options.sift.first_octave = -1 if max(max(copy.size) for copy in copies) <= SMALL_PHOTO else 0
    progress.step("finding features", len(copies), "photo")
    missing, rows = _without_features(path, copies), rows_of(path)
    done = len(copies) - len(missing)
    for part in _in_parts(missing):
        reader = pycolmap.ImageReaderOptions()
        if part[0].cut_out:
            reader.mask_path = Path(job.folder) / MASKS
        mode = pycolmap.CameraMode.AUTO  # cameras already exist
        names = [copy.file for copy in part]
        pycolmap.extract_features(path, Path(job.folder) / COPIES, names, mode, reader, options)
        rows.record()
        done += len(part)
        progress.done(done)


def _in_parts(copies: list[Copy]) -> Iterator[list[Copy]]:
    """A few at a time, photos with masks separately: given a folder of masks, COLMAP finds nothing in photos without
    one there."""
    for _, group in groupby(copies, lambda copy: copy.cut_out):
        alike = list(group)
        for start in range(0, len(alike), PHOTOS_AT_ONCE):
            yield alike[start : start + PHOTOS_AT_ONCE]


def _without_features(path: Path, copies: list[Copy]) -> list[Copy]:
    with pycolmap.Database.open(path) as database:
        numbers = {image.name: image.image_id for image in database.read_all_images()}
        return [
            copy
            for copy in copies
            if not (database.exists_keypoints(numbers[copy.file]) and database.exists_descriptors(numbers[copy.file]))
        ]


def matched_pairs(path: Path) -> list[tuple[str, str, pycolmap.TwoViewGeometry]]:
    """Names of the two copies and the verified geometry of every pair with inliers."""
    with pycolmap.Database.open(path) as database:
        names = {image.image_id: image.name for image in database.read_all_images()}
        numbers, geometries = database.read_two_view_geometries()
        found = []
        for number, geometry in zip(numbers, geometries, strict=True):
            if len(geometry.inlier_matches):
                first, second = pycolmap.pair_id_to_image_pair(number)
                found.append((names[first], names[second], geometry))
        return found


def compared_pairs(job: Job, copies: list[Copy]) -> set[tuple[str, str]]:
    """Names of the copies of every pair that was searched for matches."""
    return {(copies[i].file, copies[j].file) for i, j in pairs_of(job, copies)}


def pairs_of(job: Job, copies: list[Copy]) -> list[tuple[int, int]]:
    """Index pairs of the copies that are used, which may be fewer than the job's photos."""
    return pairs(len(copies), job.matching, [_clip_of(job, copy) for copy in copies])


def _clip_of(job: Job, copy: Copy) -> int:
    # By number: the photo may have been moved since an interrupted run made the copy.
    return job.clips[int(Path(copy.file).stem)] if job.clips else 0


def keypoints(path: Path) -> dict[str, np.ndarray]:
    """Feature positions [n, 2] in pixels of the copies, by file name."""
    with pycolmap.Database.open(path) as database:
        return {image.name: database.read_keypoints(image.image_id)[:, :2] for image in database.read_all_images()}
