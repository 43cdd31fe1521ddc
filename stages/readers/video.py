"""Video clips: which files are clips, and the frames that are taken from them as photos."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.atomic_write import write_json
from schemas.errors import BadInput
from schemas.images import write_png
from schemas.journal import Journal
from schemas.safe_names import printable
from schemas.video_reading import VideoFrame, frames_of
from stages.readers.source import natural
from stages.run.progress import Context
from stylerf.geometry.frame_choice import MOTION_SIDE, SHARPNESS_SIDE, chosen_frames, motion_between, sharpness

VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")
# Motion of a whole capture, relative to the picture's longer side, below which it shows no depth.
LEAST_MOTION = 0.05
MEASURED = 30  # examined frames per chosen one, roughly: neighbors in a long clip differ little
CHOICE = "choice.json"
LONGEST_STEM = 80  # bytes of a clip's name in the names of its frames: file systems allow 255


@dataclass(frozen=True, eq=False)
class Measured:
    """What the choice needs to know about each frame of all clips: arrays [n]."""

    clip: np.ndarray
    number: np.ndarray
    time: np.ndarray
    motion: np.ndarray
    sharpness: np.ndarray


def clips_of(source: Path) -> list[Path]:
    """List the clips at `source`, a file or the files of a folder, in natural order."""
    if source.is_file():
        return [source] if source.suffix.lower() in VIDEOS else []
    items = source.iterdir() if source.is_dir() else ()
    found = [one for one in items if one.suffix.lower() in VIDEOS and one.is_file() and one.name[0] != "."]
    return sorted(found, key=lambda one: natural(one.name))


def frames_as_photos(clips: list[Path], count: int, folder: Path, context: Context) -> list[tuple[Path, int]]:
    """Write the chosen frames of the clips to `folder`, as 8-bit PNGs named by clip and time.

    Finished steps of an interrupted run are kept. One frame is in memory at a time: the clips are decoded twice.

    Returns:
        The files in order of time, each with the number of its clip.

    Raises:
        BadInput: A clip cannot be read, or the camera does not move.
    """
    journal = Journal(folder / "whole.jsonl", folder)
    if not journal.holds([CHOICE]):
        measured = _measured(clips, count, context)
        _check_motion(measured, clips)
        kept, blurred = chosen_frames(measured.motion, measured.sharpness, count)
        entries = [[int(measured.clip[k]), int(measured.number[k]), float(measured.time[k])] for k in kept]
        write_json(folder / CHOICE, {"frames": entries, "of": len(measured.time), "blurred": blurred})
        journal.add([CHOICE])
    choice = json.loads((folder / CHOICE).read_text("utf-8"))
    left_out = f"; left out {choice['blurred']} where all frames are blurred" if choice["blurred"] else ""
    context.progress.say(
        f"chose {len(choice['frames'])} of {choice['of']} frames, sharp ones at even steps of motion{left_out}"
    )
    return list(_written(clips, choice["frames"], folder, journal, context))


def _measured(clips: list[Path], count: int, context: Context) -> Measured:
    rows: list[tuple[int, int, float, float, float]] = []
    context.progress.start("measuring motion", None, "frame")
    for clip, path in enumerate(clips):
        before: np.ndarray | None = None
        for frame in frames_of(path, max(1, MEASURED * count // len(clips))):
            small = frame.gray(MOTION_SIDE)
            motion = 0.0 if before is None else motion_between(before, small)
            rows.append((clip, frame.number, frame.time, motion, sharpness(frame.gray(SHARPNESS_SIDE))))
            before = small
            context.progress.update(len(rows))
    context.progress.finish()
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return Measured(*columns)


def _check_motion(measured: Measured, clips: list[Path]) -> None:
    total = np.nansum(measured.motion)
    if total < LEAST_MOTION and not np.isnan(measured.motion).any():
        raise BadInput(
            f"{printable(clips[0].name)}: the picture moves by {total:.1%} of its side in {len(measured.time)} "
            "frames; depth can only be found if the camera moves around the scene"
        )


def _written(
    clips: list[Path], chosen: list[list], folder: Path, journal: Journal, context: Context
) -> Iterator[tuple[Path, int]]:
    context.progress.start("writing frames", len(chosen), "frame")
    done, digits = 0, len(str(len(clips) - 1))
    for clip, path in enumerate(clips):
        wanted = {number: time for one, number, time in chosen if one == clip}
        names = {number: _name(path, clip, digits, len(clips), time) for number, time in wanted.items()}
        missing = {number for number, name in names.items() if not journal.holds([name])}
        for frame in _until(path, max(missing, default=-1)):
            if frame.number in missing:
                write_png(folder / names[frame.number], frame.pixels())
                journal.add([names[frame.number]])
                missing.discard(frame.number)
                context.progress.update(done + len(wanted) - len(missing))
        if missing:
            raise BadInput(f"{printable(str(path))} changed while being read; run the import again")
        done += len(wanted)
        yield from ((folder / names[number], clip) for number in sorted(wanted, key=wanted.__getitem__))
    context.progress.finish()


def _name(path: Path, clip: int, digits: int, clips: int, time: float) -> str:
    """Return the clip's name and the frame's time; several clips are numbered, as two may have the same stem."""
    lead = f"{clip:0{digits}d}-" if clips > 1 else ""
    stem = printable(path.stem).encode()[:LONGEST_STEM].decode("utf-8", "ignore")
    # Microseconds: no two frames of a clip have the same time.
    return f"{lead}{stem}-{time:012.6f}s.png"


def _until(path: Path, last: int) -> Iterator[VideoFrame]:
    if last < 0:
        return
    for frame in frames_of(path):
        yield frame
        if frame.number >= last:
            return
