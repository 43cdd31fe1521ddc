"""Structure from motion: finds the poses of photos by COLMAP in a child process that can be stopped.

Ctrl-C ends the child at once; finished photos, features and matches stay in the checkpoint, where the next run resumes.
"""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from schemas.atomic_write import refusal_of_disk
from schemas.errors import BadInput, OutOfResources
from schemas.safe_reading import allowance
from stages.readers.colmap import scene_of
from stages.readers.colmap_model import read_model
from stages.readers.source import SourceCamera, SourceScene, natural, path_in_source, with_masks
from stages.run.progress import Context
from stages.sfm.colmap_database import chosen_matching
from stages.sfm.job import MODEL, RESULT, Job, journal_of

ROOT = Path(__file__).resolve().parents[2]
POLL_SECONDS = 0.2
# Options of Popen: a separate process group for the child, which the terminal's Ctrl-C does not reach.
OWN_GROUP: dict[str, Any] = {"start_new_session": True}
if sys.platform == "win32":
    OWN_GROUP = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
PROBED_BYTES = 4_000_000  # bytes that a disk that is not full must accept


def reconstructed(
    photos: list[Path], root: Path, checkpoint: Path, context: Context, *, matching: str, side: int, features: int,
    shared: bool, clips: tuple[int, ...] = (),
) -> SourceScene:  # fmt: skip
    """Find the poses of the photos of a folder.

    Args:
        photos: The files.
        root: Folder that their names are relative to.
        checkpoint: Where finished steps are kept.
        context: Progress, seed and threads.
        matching: auto, exhaustive or sequential.
        side: See Job, as for features and shared.
        clips: For frames of video the number of each one's clip, in the order of `photos`.

    Raises:
        BadInput: Photos are damaged or too few, or the result is implausible.
        KeyboardInterrupt: Within a second of Ctrl-C.
    """
    photos = photos if clips else sorted(photos, key=lambda photo: natural(str(photo)))
    method, reason = chosen_matching(matching, [photo.name for photo in photos], bool(clips))
    what = "frames" if clips else "photos"
    context.progress.say(f"no poses found: structure from motion of {len(photos)} {what}, {method} matching ({reason})")
    folder = checkpoint / "sfm"
    folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(str(photo) for photo in photos)
    masks = _masks(photos, root, context)
    job = Job(
        str(folder), paths, masks, side, features, method, shared, context.seed, context.threads, clips, allowance()
    )
    job.write(folder / "job.json")
    result = finished(folder)
    if result is None:
        if (folder / RESULT).is_file():
            context.progress.say("warning: the poses of the interrupted run are damaged; recomputing them")
        run_child(folder / "job.json", context)
        result = _result(folder)
    return _scene(result, photos, folder / MODEL, root, context)


def finished(folder: Path) -> dict | None:
    """Return the result of a finished structure from motion in `folder`; None if there is none or it is damaged."""
    journal = journal_of(folder)
    if not journal.holds([RESULT]):
        return None
    result = _result(folder)
    return result if journal.holds(result["model"]) else None


def _result(folder: Path) -> dict:
    return json.loads((folder / RESULT).read_text("utf-8", "surrogatepass"))  # names of files may be of any bytes


def _masks(photos: list[Path], root: Path, context: Context) -> tuple[tuple[str, str], ...]:
    """Return per photo the masks of what to keep and to hide, empty if absent; () if no photo has any."""
    cameras = [SourceCamera(photo.stem, path_in_source(photo, root), photo, np.eye(4)) for photo in photos]
    masks = tuple((str(one.mask or ""), str(one.hides or "")) for one in with_masks(cameras, root))
    if found := sum(map(any, masks)):
        context.progress.say(f"{found} of {len(photos)} photos have masks; features in masked areas are ignored")
    return masks if found else ()


def _scene(result: dict, photos: list[Path], model: Path, root: Path, context: Context) -> SourceScene:
    figures = result["figures"]
    context.progress.say(
        f"structure from motion: {figures['registered']} of {figures['photos']} photos placed, {figures['points']} "
        f"points, {figures['error_px']:.2f} px"
    )
    # The photos may have been moved since an interrupted run read them; their order is the same.
    every = [{**copy, "photo": str(photo)} for copy, photo in zip(result["copies"], photos, strict=True)]
    copies = {copy["file"]: copy for copy in every}
    scene = scene_of(read_model(model), model, root, "photos, by structure from motion")
    cameras = with_masks([_of_photo(camera, copies[camera.source], root) for camera in scene.cameras], root)
    placed = {camera.image for camera in cameras}
    skipped = [
        (path_in_source(Path(copy["photo"]), root), copy["unusable"] or "structure from motion could not place it")
        for copy in every
        if Path(copy["photo"]) not in placed
    ]
    return replace(scene, cameras=cameras, upright=True, sfm=figures, skipped=tuple(skipped))


def _of_photo(camera: SourceCamera, copy: dict, root: Path) -> SourceCamera:
    """Convert the camera of a working copy to that of the photo itself."""
    photo, size = Path(copy["photo"]), tuple(copy["full_size"])
    kx, ky = size[0] / copy["size"][0], size[1] / copy["size"][1]
    fx, fy, cx, cy = camera.intrinsics
    return replace(
        camera, name=photo.stem, source=path_in_source(photo, root), image=photo, size=size,
        intrinsics=(fx * kx, fy * ky, cx * kx, cy * ky),
    )  # fmt: skip


def run_child(job: Path, context: Context) -> None:
    """Run `stages.sfm.child` to its end, showing its progress; raise the fault that it reports.

    The child leads a process group of its own, so the terminal's Ctrl-C reaches only this process, which then kills
    the group.
    """
    log = job.with_suffix(".log")
    # Without -P, `-m` imports from the current folder first, whose files may be untrusted.
    with open(log, "wb") as errors:
        child = subprocess.Popen(
            [sys.executable, "-P", "-m", "stages.sfm.child", str(job)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=errors, env={**os.environ, "PYTHONPATH": _search_path()}, **OWN_GROUP,
        )  # fmt: skip
    try:
        started, fault = _follow(child, context)
        code = child.wait()
    finally:
        _end(child)
    if fault or code:
        # On a full disk COLMAP and its libraries fail in many ways, often without naming the cause.
        full = refusal_of_disk(job, PROBED_BYTES) if code != -signal.SIGTERM else None
        raise full or (_fault(fault["kind"], fault["text"]) if fault else _death(code, log, started))


def _search_path() -> str:
    """Return the child's PYTHONPATH: our absolute entries. An empty entry would mean the current folder."""
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return os.pathsep.join([str(ROOT), *(entry for entry in inherited if os.path.isabs(entry))])


def _end(child: subprocess.Popen) -> None:
    if child.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL) if hasattr(os, "killpg") else child.kill()
        child.wait()
    for stream in filter(None, (child.stdin, child.stdout)):
        stream.close()


def _follow(child: subprocess.Popen, context: Context) -> tuple[bool, dict | None]:
    """Pass on the child's events until it closes its channel; return whether it started, and the fault it reported."""
    events: queue.Queue[dict | None] = queue.Queue()
    threading.Thread(target=_read, args=(child.stdout, events), daemon=True).start()
    started, fault = False, None
    while True:
        try:
            # On some systems no signal interrupts a wait without a timeout.
            event = events.get(timeout=POLL_SECONDS)
        except queue.Empty:
            continue
        if event is None:
            context.progress.finish()
            return started, fault
        if event["event"] == "started":
            started = True
        elif event["event"] == "step":
            context.progress.start(event["label"], event["total"], event["unit"])
        elif event["event"] == "done":
            context.progress.update(event["count"], event["note"])
        elif event["event"] == "say":
            context.progress.say(event["text"])
        else:
            fault = event


def _read(stream, events: "queue.Queue[dict | None]") -> None:
    with suppress(ValueError, OSError):  # closed by _end while we were reading
        for line in stream:
            with suppress(ValueError):
                events.put(json.loads(line))
    events.put(None)


def _fault(kind: str, text: str) -> BaseException:
    if kind == "MemoryError":
        return MemoryError(text)
    if kind == "OSError":
        number, _, words = text.partition(" ")
        return OSError(int(number), words)
    return {"OutOfResources": OutOfResources}.get(kind, BadInput)(text)


def _death(code: int, log: Path, started: bool) -> BaseException:
    """Return the error for a child that died without reporting one. started: it had loaded its libraries."""
    if hasattr(signal, "SIGKILL") and code == -signal.SIGKILL:
        return OutOfResources(
            "structure from motion was killed by the system, most likely because memory ran out; give fewer "
            "--threads, a lower --memory, smaller photos, or a smaller --sfm-side or --sfm-features, and run the same "
            "command"
        )
    if code == -signal.SIGTERM:
        return KeyboardInterrupt()
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    last = next((line for line in reversed(lines) if line[:1] in "EF" or "Error" in line), lines[-1] if lines else "")
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    if code > 0 and not started:  # Python ended on its own, before it read any photo
        return OutOfResources(
            f"structure from motion could not start ({how}: {last.strip()[:200]}); check that the disk with Python's "
            "libraries is readable, and run the same command again"
        )
    return BadInput(f"structure from motion failed ({how}: {last.strip()[:200]}); check the photos")
