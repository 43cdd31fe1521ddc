"""Matches pairs of photos: COLMAP on one thread, in as many processes as there are threads to use.

With several threads in one process, COLMAP 4.2 occasionally loses matches of a pair, or all of them, and runs differ;
the cause is unknown, but processes share nothing.

`python -P -m stages.sfm.matching` is such a process: a batch of pairs per JSON line on stdin, a line on stdout when the
batch is done. It ends when its stdin closes, that is when its parent ends or dies.
"""

import json
import os
import queue
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

from schemas.atomic_write import write_bytes
from stages.sfm.colmap_database import INPUTS, pairs_of, rows_of
from stages.sfm.job import Job, JobProgress
from stages.sfm.photo_copies import Copy
from stylerf.environment.colmap import pycolmap

Pairs = list[tuple[str, str]]

BATCHES = "matching"  # folder of the batches in progress, in the job's folder
FEWEST_PAIRS_AT_ONCE, MOST_PAIRS_AT_ONCE = 10, 40
# A process takes half a second to start, as long as this many pairs.
PAIRS_FOR_A_PROCESS = 20
WAIT_SECONDS = 60.0  # for a database that another thread writes


def match(job: Job, path: Path, copies: list[Copy], progress: JobProgress) -> None:
    """Write matches and two-view geometry of the pairs that the database at `path` lacks, each pair's RANSAC with the
    same seed: the same rows by any number of processes."""
    wanted = [(copies[i].file, copies[j].file) for i, j in pairs_of(job, copies)]
    missing, rows = _not_compared(path, wanted), rows_of(path)
    finished = len(wanted) - len(missing)
    progress.step("matching", len(wanted), "pair")
    progress.done(finished)
    folder = Path(job.folder) / BATCHES
    shutil.rmtree(folder, ignore_errors=True)  # of an interrupted run
    folder.mkdir()
    size = min(MOST_PAIRS_AT_ONCE, max(FEWEST_PAIRS_AT_ONCE, len(missing) // (4 * job.threads)))
    batches = [missing[start : start + size] for start in range(0, len(missing), size)]
    for batch in _matched(batches, path, folder, job):
        rows.record()
        finished += len(batch)
        progress.done(finished)
    shutil.rmtree(folder)


def _matched(batches: list[Pairs], path: Path, folder: Path, job: Job) -> Iterator[Pairs]:
    """Matches the batches and yields each when its rows are in the database."""
    processes = min(job.threads, len(batches), max(1, sum(map(len, batches)) // PAIRS_FOR_A_PROCESS))
    if processes <= 1:
        for batch in batches:
            match_pairs(path, batch, job.seed)
            yield batch
        return
    with ExitStack() as stack:
        idle: queue.SimpleQueue[subprocess.Popen] = queue.SimpleQueue()
        for _ in range(processes):
            idle.put(stack.enter_context(_process()))

        def computed(number: int) -> Path:
            process = idle.get()
            try:
                part = folder / f"{number}.db"
                _copy_inputs(path, part, batches[number])
                _ask(process, {"database": str(part), "pairs": batches[number], "seed": job.seed})
                return part
            finally:
                idle.put(process)

        pool = stack.enter_context(ThreadPoolExecutor(processes))
        stack.callback(pool.shutdown, wait=False, cancel_futures=True)  # after a fault, start no other batch
        for batch, part in zip(batches, pool.map(computed, range(len(batches))), strict=True):
            merge_database(part, path)
            part.unlink()
            yield batch


def match_pairs(path: Path, pairs: Pairs, seed: int) -> None:
    """Match the pairs of file names in the database at `path`, on this thread."""
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.num_threads, matching.use_gpu = 1, False
    verification.ransac.random_seed = seed
    pairing = pycolmap.ImportedPairingOptions()
    listing = path.with_suffix(".txt")
    pairing.match_list_path = str(listing)
    write_bytes(listing, "".join(f"{first} {second}\n" for first, second in pairs).encode())
    pycolmap.match_image_pairs(path, matching, pairing, verification)


@contextmanager
def _process() -> Iterator[subprocess.Popen]:
    """A process of this module in our process group, so that killing the group kills it too."""
    command = [sys.executable, "-P", "-m", "stages.sfm.matching"]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8")
    try:
        yield child
    finally:
        child.kill()
        child.wait()
        for stream in filter(None, (child.stdin, child.stdout)):
            with suppress(OSError):  # what it died before reading cannot be flushed
                stream.close()


def _ask(process: subprocess.Popen, batch: dict) -> None:
    """Has the process match a batch, and waits for it."""
    assert process.stdin and process.stdout
    try:
        process.stdin.write(json.dumps(batch) + "\n")
        process.stdin.flush()
        answer = process.stdout.readline()
    except OSError:  # it died before it read the line
        answer = ""
    if not answer:
        code = process.wait()
        if hasattr(signal, "SIGKILL") and code == -signal.SIGKILL:
            raise MemoryError
        raise RuntimeError(f"a matching process ended early ({code})")


def _copy_inputs(path: Path, part: Path, pairs: Pairs) -> None:
    """Create the database `part` with what matching these pairs needs from the one at `path`."""
    pycolmap.Database.open(part).close()
    names = json.dumps(sorted({name for pair in pairs for name in pair}))
    with closing(sqlite3.connect(part, timeout=WAIT_SECONDS)) as database:
        database.execute("ATTACH ? AS whole", (str(path),))
        for table in INPUTS:
            database.execute(f"INSERT INTO {table} SELECT * FROM whole.{table}")
        for table in ("keypoints", "descriptors"):
            database.execute(
                f"INSERT INTO {table} SELECT * FROM whole.{table} WHERE image_id IN "
                "(SELECT image_id FROM whole.images WHERE name IN (SELECT value FROM json_each(?)))", (names,),
            )  # fmt: skip
        database.commit()


def merge_database(part: Path, path: Path) -> None:
    """Copy the results in the database `part` into the one at `path`. An interrupted pair may already have rows."""
    with closing(sqlite3.connect(path, timeout=WAIT_SECONDS)) as database:
        database.execute("ATTACH ? AS part", (str(part),))
        for table in ("matches", "two_view_geometries"):
            database.execute(f"INSERT OR REPLACE INTO {table} SELECT * FROM part.{table}")
        database.commit()


def _not_compared(path: Path, wanted: Pairs) -> Pairs:
    with pycolmap.Database.open(path) as database:
        numbers = {image.name: image.image_id for image in database.read_all_images()}
        both = [(numbers[first], numbers[second]) for first, second in wanted]
        return [
            pair
            for pair, ids in zip(wanted, both, strict=True)
            if not (database.exists_matches(*ids) and database.exists_two_view_geometry(*ids))
        ]


def main() -> int:
    """Match the batches requested on stdin."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # COLMAP's other output goes to the log
    pycolmap.logging.minloglevel = 1
    asked: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(asked,), daemon=True).start()
    while True:
        batch = json.loads(asked.get())
        match_pairs(Path(batch["database"]), batch["pairs"], batch["seed"])
        channel.write("done\n")
        channel.flush()


def _listen(asked: "queue.SimpleQueue[str]") -> None:
    with os.fdopen(os.dup(0), encoding="utf-8") as lines:  # not sys.stdin, see child.py
        for line in lines:
            asked.put(line)
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
