"""Structure from motion goes on from what an interrupted run left: what is damaged there is made again."""

import io
import json
import shutil
import sqlite3
import threading
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pycolmap
import pytest

from schemas import safe_reading
from schemas.canonical_json import file_sha256
from schemas.errors import BadInput
from schemas.images import read_srgb, write_png
from stages.readers.source import IMAGE_SUFFIXES
from stages.run.progress import Context
from stages.sfm import child, colmap_database, matching, photo_copies, reconstruction
from stages.sfm.colmap_database import Rows
from stages.sfm.job import Job, JobProgress
from tests.stages.importing import Said
from tests.stages.photo_room import walk, write_photos


class Heard:
    """A Teller that keeps what it is reported."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.finished: list[int] = []

    def step(self, label, total, unit):
        pass

    def done(self, count, note=""):
        self.finished.append(count)

    def say(self, text):
        self.lines.append(text)


def flipped(path: Path, where: float = 0.5) -> None:
    data = bytearray(path.read_bytes())
    data[int(where * (len(data) - 1))] ^= 4
    path.write_bytes(data)


def cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def digests(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): file_sha256(path) for path in sorted(folder.rglob("0*.*"))}


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> Path:
    """Four photos of 120 x 90, and masks that cut an edge out of the first two."""
    folder = tmp_path_factory.mktemp("photos")
    write_photos(folder, walk(4, (0.45, 1.1), width=120, height=90, focal=115.0))
    mask = np.full((90, 120), 255, np.uint8)
    mask[:, :30] = 0
    for name in ("p00", "p01"):
        write_png(folder / "masks" / f"{name}.png", mask)
    return folder


@pytest.fixture
def job(photos, tmp_path) -> Job:
    masks = tuple((str(photos / "masks" / f"p0{n}.png") if n < 2 else "", "") for n in range(4))
    return Job(str(tmp_path), tuple(str(photos / f"p0{n}.png") for n in range(4)), masks)


@pytest.mark.parametrize("damage", [flipped, cut, Path.unlink])
@pytest.mark.parametrize("name", ["copies/00001.jpg", "masks/00001.jpg.png", "copies/00001.json"])
def test_a_damaged_copy_is_made_again(job, tmp_path, name, damage):
    first = photo_copies.make_copies(job, Heard())
    whole = digests(tmp_path)
    damage(tmp_path / name)
    untouched = (tmp_path / "copies" / "00000.jpg").stat().st_mtime_ns
    assert photo_copies.make_copies(job, Heard()) == first and digests(tmp_path) == whole
    assert (tmp_path / "copies" / "00000.jpg").stat().st_mtime_ns == untouched


@pytest.mark.parametrize(("fit", "threads", "most"), [(2, 4, 2), (0, 4, 1), (9, 2, 2)])
def test_as_many_photos_are_copied_at_once_as_memory_and_threads_allow(job, monkeypatch, fit, threads, most):
    reading, seen, lock = [], [], threading.Lock()

    def read(path):
        with lock:
            reading.append(path)
            seen.append(len(reading))
        time.sleep(0.1)
        with lock:
            reading.remove(path)
        return read_srgb(path)

    monkeypatch.setattr(photo_copies, "read_srgb", read)
    allowed = fit * photo_copies.BYTES_PER_PIXEL * 120 * 90
    photo_copies.make_copies(replace(job, threads=threads, allowance=allowed), Heard())
    assert max(seen) == most


def test_the_memory_of_the_parent_bounds_the_child(job, tmp_path, monkeypatch):
    jobs = []
    monkeypatch.setattr(reconstruction, "run_child", lambda path, context: jobs.append(Job.read(path)))
    monkeypatch.setattr(reconstruction, "_result", lambda folder: {})
    monkeypatch.setattr(reconstruction, "_scene", lambda *args: None)
    monkeypatch.setattr(photo_copies, "make_copies", lambda job, progress: photo_copies.usable([], 3))
    monkeypatch.setattr(safe_reading, "_find", lambda: 1 << 30)
    photos = [Path(photo) for photo in job.photos]
    options = {"matching": "auto", "side": 800, "features": 100, "shared": True}
    reconstruction.reconstructed(photos, photos[0].parent, tmp_path, Context(), **options)
    assert jobs[0].allowance == 1 << 30
    with pytest.raises(BadInput, match="can be used"):
        child.run(replace(jobs[0], allowance=1 << 29), JobProgress(io.StringIO()))
    assert safe_reading.allowance() == 1 << 29


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_photos_of_every_format_are_copied(tmp_path, suffix):
    """Also of those that COLMAP itself cannot open."""
    pixels = np.full((64, 96, 3), 0.5, np.float32)
    pixels[:, :48] = 0.2
    target = oiio.ImageOutput.create(f"x{suffix}")
    photo = str(tmp_path / f"x{suffix}")
    assert target.open(photo, oiio.ImageSpec(96, 64, 3, oiio.UINT8)) and target.write_image(pixels) and target.close()
    [copy] = photo_copies.make_copies(Job(str(tmp_path), (photo,)), Heard())
    assert (copy.full_size, copy.size, copy.focal, copy.unusable) == ((96, 64), (96, 64), 0.0, "")
    made = read_srgb(tmp_path / "copies" / copy.file).pixels
    np.testing.assert_allclose(made, read_srgb(photo).pixels, atol=0.05)  # JPEG


@pytest.mark.parametrize("damage", [flipped, cut, Path.unlink])
def test_copies_without_their_journal_are_made_again(job, tmp_path, damage):
    first = photo_copies.make_copies(job, Heard())
    whole = digests(tmp_path)
    damage(tmp_path / "whole.jsonl")
    flipped(tmp_path / "copies" / "00002.jpg")
    flipped(tmp_path / "masks" / "00000.jpg.png")
    assert photo_copies.make_copies(job, Heard()) == first and digests(tmp_path) == whole


def matched(job: Job) -> tuple[Heard, Path]:
    tell = Heard()
    used = photo_copies.usable(photo_copies.make_copies(job, tell), 3)
    path = colmap_database.register(job, used, tell)
    colmap_database.extract(job, path, used, tell)
    matching.match(job, path, used, tell)
    return tell, path


def rows(path: Path) -> dict[str, list]:
    with closing(sqlite3.connect(path)) as opened:
        return {
            table: opened.execute(f"SELECT * FROM {table} ORDER BY 1").fetchall()
            for table in ("cameras", "images", "keypoints", "descriptors", "matches", "two_view_geometries")
        }


def changed(path: Path, statement: str, *values) -> None:
    with closing(sqlite3.connect(path)) as opened:
        opened.execute(statement, values)
        opened.commit()


def flip_a_blob(path: Path, table: str, key: str) -> None:
    with closing(sqlite3.connect(path)) as opened:
        number, data = opened.execute(f"SELECT {key}, data FROM {table} WHERE rows > 0 LIMIT 1").fetchone()
    data = bytearray(data)
    data[len(data) // 2] ^= 1
    changed(path, f"UPDATE {table} SET data = ? WHERE {key} = ?", bytes(data), number)


DAMAGES = {
    "keypoints": lambda path: flip_a_blob(path, "keypoints", "image_id"),
    "descriptors": lambda path: flip_a_blob(path, "descriptors", "image_id"),
    "matches": lambda path: flip_a_blob(path, "matches", "pair_id"),
    "geometries": lambda path: flip_a_blob(path, "two_view_geometries", "pair_id"),
    "a focal length": lambda path: changed(path, "UPDATE cameras SET params = ?", np.full(4, 50.0).tobytes()),
    "a row is gone": lambda path: changed(path, "DELETE FROM keypoints WHERE image_id = 3"),
    "a name": lambda path: changed(path, "UPDATE images SET name = 'x.jpg' WHERE image_id = 2"),
    "cut": cut,
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "the header": lambda path: flipped(path, 0.0),
    "gone": Path.unlink,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_database_is_made_again(job, damage):
    _, path = matched(job)
    whole = rows(path)
    DAMAGES[damage](path)
    tell, path = matched(job)
    assert rows(path) == whole
    (line,) = tell.lines
    assert line.startswith("warning: the features") and "damaged" in line


def test_an_intact_database_is_kept_and_partial_rows_are_recomputed(job, tmp_path):
    _, path = matched(job)
    whole = rows(path)
    tell, _ = matched(job)
    assert tell.lines == [] and tell.finished[-2:] == [4, 6]  # no photo is searched, no pair compared
    lines = (tmp_path / "rows.jsonl").read_text().splitlines()
    (tmp_path / "rows.jsonl").write_text("\n".join(lines[:-3])[:-20])  # matches of the last pairs are not recorded
    flip_a_blob(path, "two_view_geometries", "pair_id")
    (tmp_path / "rows.jsonl").write_text("\n".join(line for line in lines if "two_view" not in line))
    tell, _ = matched(job)
    assert tell.lines == [] and rows(path) == whole


def test_a_flipped_bit_anywhere_in_the_database_is_noticed(job, tmp_path):
    """But where no row lies: in free pages and in what SQLite itself notes."""
    _, path = matched(job)
    whole, data = rows(path), path.read_bytes()
    random = np.random.default_rng(0)
    for place in random.integers(0, len(data), 150):
        broken = bytearray(data)
        broken[place] ^= 1 << int(random.integers(8))
        path.write_bytes(broken)
        sound = Rows(path, tmp_path / "rows.jsonl").sound()
        assert not sound or rows(path) == whole, place


@pytest.fixture(scope="module")
def ended(tmp_path_factory) -> tuple[Path, Path]:
    """Photos, and the checkpoint of a structure from motion that has ended."""
    folder = tmp_path_factory.mktemp("ended")
    write_photos(folder / "room", walk(8, (0.45, 1.1), width=240, height=180, focal=230.0))
    reconstructed(folder / "room", folder / "checkpoint", Said())
    return folder / "room", folder / "checkpoint"


def reconstructed(room: Path, checkpoint: Path, said: Said):
    return reconstruction.reconstructed(
        list(room.glob("*.png")), room, checkpoint, Context(progress=said), matching="auto", side=1600, features=2048,
        shared=True,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["result.json", "model/images.bin", "model/cameras.bin", "model/points3D.bin"])
@pytest.mark.parametrize("damage", [flipped, cut, Path.unlink])
def test_damaged_poses_are_reported_from_whole_ones(ended, tmp_path, name, damage):
    shutil.copytree(ended[1] / "sfm", tmp_path / "sfm")
    assert reconstruction.finished(tmp_path / "sfm")["figures"]["registered"] == 8
    damage(tmp_path / "sfm" / name)
    assert reconstruction.finished(tmp_path / "sfm") is None


def test_damaged_poses_are_found_again(ended, tmp_path):
    room, checkpoint = ended
    shutil.copytree(checkpoint, tmp_path / "c")
    flipped(tmp_path / "c" / "sfm" / "model" / "images.bin", 0.01)
    cut(tmp_path / "c" / "sfm" / "job.json")
    said = Said()
    scene = reconstructed(room, tmp_path / "c", said)
    assert any(line.startswith("warning: the poses") and "damaged" in line for line in said.lines)
    assert len(scene.cameras) == 8
    for one in ("images.bin", "cameras.bin", "points3D.bin"):
        assert file_sha256(tmp_path / "c" / "sfm" / "model" / one) == file_sha256(checkpoint / "sfm" / "model" / one)
    again = Said()
    reconstructed(room, tmp_path / "c", again)
    assert not any("damaged" in line for line in again.lines)
    assert pycolmap.Reconstruction(tmp_path / "c" / "sfm" / "model").num_reg_images() == 8
    assert json.loads((tmp_path / "c" / "sfm" / "result.json").read_text())["figures"]["registered"] == 8
