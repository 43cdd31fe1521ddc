"""Pairs are matched by several processes as by one, and errors of any one of them are reported."""

import os
import signal
import sqlite3
import subprocess
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from stages.sfm import colmap_database, matching, photo_copies
from stages.sfm.job import Job
from tests.stages.photo_room import walk, write_photos
from tests.stages.sfm.test_damaged_files import Heard


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> tuple[Path, ...]:
    folder = tmp_path_factory.mktemp("photos")
    write_photos(folder, walk(6, (0.45, 1.1), width=120, height=90, focal=115.0))
    return tuple(sorted(folder.glob("*.png")))


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    """Fifteen pairs are many."""
    monkeypatch.setattr(matching, "FEWEST_PAIRS_AT_ONCE", 2)
    monkeypatch.setattr(matching, "PAIRS_FOR_A_PROCESS", 1)


def with_features(job: Job) -> tuple[Path, list]:
    used = photo_copies.usable(photo_copies.make_copies(job, Heard()), 3)
    path = colmap_database.register(job, used, Heard())
    colmap_database.extract(job, path, used, Heard())
    return path, used


def job_of(photos: tuple[Path, ...], folder: Path, threads: int) -> Job:
    folder.mkdir()
    return Job(str(folder), tuple(map(str, photos)), threads=threads)


def found(path: Path) -> list:
    with closing(sqlite3.connect(path)) as database:
        tables = ("matches", "two_view_geometries")
        return [database.execute(f"SELECT * FROM {table} ORDER BY pair_id").fetchall() for table in tables]


def test_several_processes_find_what_one_finds(photos, tmp_path):
    rows = []
    for threads in (1, 3):
        job = job_of(photos, tmp_path / str(threads), threads)
        path, used = with_features(job)
        heard = Heard()
        matching.match(job, path, used, heard)
        rows.append(found(path))
        assert heard.finished[0] == 0 and heard.finished[-1] == 15
        assert not (Path(job.folder) / matching.BATCHES).exists() and colmap_database.rows_of(path).sound()
    assert rows[0] == rows[1]
    assert [len(table) for table in rows[0]] == [15, 15] and sum(matches[1] for matches in rows[0][0]) > 500


def test_matching_goes_on_where_it_was_cut_short(photos, tmp_path, monkeypatch):
    job = job_of(photos, tmp_path / "job", 2)
    path, used = with_features(job)
    merged = []

    def cut_short(part, whole, merge=matching.merge_database):
        if len(merged) == 2:
            raise KeyboardInterrupt
        merged.append(part)
        merge(part, whole)

    with monkeypatch.context() as cut:
        cut.setattr(matching, "merge_database", cut_short)
        with pytest.raises(KeyboardInterrupt):
            matching.match(job, path, used, Heard())
    heard = Heard()
    matching.match(replace(job, threads=1), path, used, heard)
    assert heard.finished[0] == 4 and [len(table) for table in found(path)] == [15, 15]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_process_killed_by_the_system_is_lack_of_memory(photos, tmp_path, monkeypatch):
    job = job_of(photos, tmp_path / "job", 2)
    path, used = with_features(job)
    started = []

    def doomed(*arguments, popen=subprocess.Popen, **options):
        started.append(popen(*arguments, **options))
        if len(started) == 2:
            os.kill(started[-1].pid, signal.SIGKILL)
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", doomed)
    with pytest.raises(MemoryError):
        matching.match(job, path, used, Heard())
    assert all(process.poll() is not None for process in started)
