"""The child process of structure from motion: `python -P -m stages.sfm.child JOB.json`.

COLMAP ignores Ctrl-C for minutes, may abort the process, and writes to stdout, so it runs here, where it can be killed
at any time. Events go to stdout as JSON lines (sfm/job.py), COLMAP's log to stderr. The process ends when its
stdin closes, that is when the parent dies.
"""

import os
import shutil
import sys
import threading
from dataclasses import asdict, replace
from pathlib import Path

from schemas.atomic_write import sync_file, write_json
from schemas.errors import BadInput, StylerfError
from schemas.safe_reading import set_allowance
from stages.sfm.job import MODEL, RESULT, Job, JobProgress, journal_of


def main(path: str) -> int:
    """Run the job at `path`; return 0 when its result is written, 1 after a reported fault."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # other output to stdout goes to the log
    progress = JobProgress(channel)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        run(Job.read(Path(path)), progress)
    except StylerfError as error:
        progress.fault(type(error).__name__, str(error))
        return 1
    except OSError as error:
        progress.fault("OSError", f"{error.errno or 0} {error}")
        return 1
    except MemoryError:
        progress.fault("MemoryError", "out of memory")
        return 1
    return 0


def run(job: Job, progress: JobProgress) -> None:
    """Run the steps that no interrupted run has finished; write model/ and result.json to the job's folder."""
    from stages.sfm import colmap_database, mapping, matching, photo_copies, quality, silhouettes
    from stylerf.environment.colmap import pycolmap

    progress.started()
    set_allowance(lambda: job.allowance)
    pycolmap.logging.minloglevel = 1
    pycolmap.set_random_seed(job.seed)
    folder = Path(job.folder)
    every = photo_copies.make_copies(job, progress)
    used = photo_copies.usable(every, quality.FEWEST_PHOTOS)
    path = colmap_database.register(job, used, progress)
    colmap_database.extract(job, path, used, progress)
    matching.match(job, path, used, progress)
    models = mapping.reconstruct(job, path, len(used), progress)
    refined, refuted, share = False, [], 0.0
    if models:
        refuted = silhouettes.refuted(models[0], silhouettes.of_object(folder, used))
        share = len(refuted) / models[0].num_reg_images()
        if share <= quality.MOST_REFUTED:
            silhouettes.without(models[0], refuted)
        models[0], refined = mapping.refined(models[0], folder)
    pairs = colmap_database.matched_pairs(path)
    found = quality.quality(models, len(used), pairs, colmap_database.keypoints(path), refined)
    if models:
        must = quality.expected(models[0], pairs, colmap_database.compared_pairs(job, used))
        found = replace(found, silent_share=must.silent_share, pairs_expected=must.count, refuted_share=share)
    refusal, warnings = quality.verdict(found)
    if refusal:
        raise BadInput(refusal)
    for warning in warnings:
        progress.say(warning)
    if refuted:
        progress.say(f"warning: {len(refuted)} photos left out: their silhouettes contradict their poses")
    every = [replace(copy, unusable=silhouettes.REASON) if copy.file in refuted else copy for copy in every]
    shutil.rmtree(folder / MODEL, ignore_errors=True)  # of an earlier run
    (folder / MODEL).mkdir()
    models[0].write(folder / MODEL)
    names = sorted(f"{MODEL}/{path.name}" for path in (folder / MODEL).iterdir())
    for name in names:
        sync_file(folder / name)
    write_json(folder / RESULT, {"copies": every, "figures": asdict(found), "model": names})
    journal_of(folder).add([RESULT, *names])


def _end_with_parent() -> None:
    while os.read(0, 1):  # not sys.stdin: Python aborts at its end where a thread holds that stream
        pass
    os._exit(2)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
