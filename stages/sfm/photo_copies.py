"""Working copies of the photos: upright, strictly read, of bounded size, with the lens according to their EXIF data.

What a mask or transparency cuts out of a photo may be static behind a turning object or walk through a room. The copy
is black there, since features near an outline are described by its surroundings, and has its own mask, by which COLMAP
drops the features inside. Of 14 lego photos in front of a static background the mask alone places 7, both place 14.

COLMAP itself accepts a truncated JPEG silently, drops a broken one, and handles orientation in its own way; the
copies keep all of that away from it.

A copy is made again if its bytes, or those of its mask or facts, no longer match the journal.
"""

import errno
import json
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path

import numpy as np

from schemas.atomic_write import replacing, write_json
from schemas.canonical_json import file_sha256
from schemas.errors import BadInput
from schemas.images import image_size, read_srgb, to_uint8, write_png
from schemas.journal import Journal
from stages.readers.photos import DARKEST_WHITE, masked
from stages.run.parallel import in_order
from stages.sfm.job import Job, JobProgress, journal_of
from stylerf.environment.colmap import pycolmap
from stylerf.geometry.resampling import shrunk

COPIES, MASKS = "copies", "masks"
JPEG_QUALITY = 95
BYTES_PER_PIXEL = 64  # of a photo while it is copied: measured 51
KEPT = 0.5  # coverage from which a pixel is kept


@dataclass(frozen=True)
class Copy:
    """One photo's copy. photo: the original's path; full_size: its upright (width, height); file: name of the copy;
    size: (width, height) of the copy.

    lens: photos with equal lens share a camera. focal: in pixels of the copy, by EXIF; 0 if EXIF has none.
    cut_out: masks/ holds a mask of the copy. unusable: why the photo is left out; empty if it is used.
    """

    photo: str
    full_size: tuple[int, int]
    file: str
    size: tuple[int, int]
    lens: str
    focal: float
    sha256: str
    cut_out: bool = False
    unusable: str = ""


def make_copies(job: Job, progress: JobProgress) -> list[Copy]:
    """Make copies of all photos, reusing those of an interrupted run; BadInput at the first damaged photo."""
    folder = Path(job.folder) / COPIES
    folder.mkdir(exist_ok=True)
    (folder.parent / MASKS).mkdir(exist_ok=True)
    progress.step("reading photos", len(job.photos), "photo")
    made: list[Copy] = []
    journal = journal_of(folder.parent)
    masks = job.masks or [("", "")] * len(job.photos)
    jobs = zip(count(), job.photos, masks)
    for copy in in_order(lambda one: _copy(folder, journal, job.side, *one), jobs, _at_once(job)):
        made.append(copy)
        progress.done(len(made))
    return _without_doubles(made)


def _at_once(job: Job) -> int:
    """Return how many photos may be decoded at a time, within the threads and the memory of the job."""
    largest = max((width * height for width, height in map(image_size, job.photos)), default=1)
    return max(1, min(job.threads, job.allowance // (BYTES_PER_PIXEL * largest)))


def restored(content: dict) -> Copy:
    """A Copy from its JSON form."""
    return Copy(**{**content, "full_size": tuple(content["full_size"]), "size": tuple(content["size"])})


def _copy(folder: Path, journal: Journal, side: int, index: int, photo: str, masks: tuple[str, str]) -> Copy:
    facts = folder / f"{index:05d}.json"
    if journal.holds([f"{COPIES}/{facts.name}"]):
        copy = restored(json.loads(facts.read_text("utf-8", "surrogatepass")))
        if journal.holds(_pictures(copy)):
            return copy
    image = read_srgb(photo)
    mask, hides = (Path(one) if one else None for one in masks)
    pixels, (width, height) = masked(image.pixels, mask, hides, True), image.size
    kept = pixels[..., 3] if pixels.shape[2] == 4 else np.ones((height, width), np.float32)
    pixels, cut_out = pixels[..., :3] * kept[..., None], bool(kept.min() < KEPT)
    factor = min(1.0, side / max(width, height))
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    lens, focal = _lens(photo, (width, height))
    copy = Copy(
        photo=photo,
        full_size=(width, height),
        file=f"{index:05d}.jpg",
        size=size,
        lens=f"{lens} {size[0]}x{size[1]}",
        focal=focal * size[0] / width,
        sha256=file_sha256(photo),
        cut_out=cut_out,
        unusable="it is fully masked" if kept.max() < KEPT else "it is black" if pixels.max() < DARKEST_WHITE else "",
    )
    if cut_out:
        small = shrunk(np.ascontiguousarray(kept[..., None]), size)
        write_png(folder.parent / MASKS / f"{copy.file}.png", to_uint8(small >= KEPT))
    write_jpeg(folder / copy.file, to_uint8(shrunk(np.ascontiguousarray(pixels), size)))
    write_json(facts, asdict(copy))
    journal.add([f"{COPIES}/{facts.name}", *_pictures(copy)])
    return copy


def _pictures(copy: Copy) -> list[str]:
    return [f"{COPIES}/{copy.file}"] + [f"{MASKS}/{copy.file}.png"] * copy.cut_out


def _lens(photo: str, size: tuple[int, int]) -> tuple[str, float]:
    """Return what identifies lens and zoom, and the focal length in pixels of the photo by EXIF, or 0."""
    try:
        camera = pycolmap.infer_camera_from_image(photo)
    except ValueError:  # COLMAP reads fewer formats than import: no WebP
        return "unknown", 0.0
    if not camera.has_prior_focal_length:
        return "unknown", 0.0
    focal = float(camera.mean_focal_length())
    plausible = 0.2 < focal / max(size) < 20
    return (f"{focal / max(size):.4f}", focal) if plausible else ("unknown", 0.0)


def write_jpeg(path: Path, pixels: np.ndarray) -> None:
    """Write [h, w, 1 or 3] uint8 atomically; OSError if the codec fails."""
    bitmap = pycolmap.Bitmap.from_array(np.ascontiguousarray(np.broadcast_to(pixels, (*pixels.shape[:2], 3))))
    bitmap.set_jpeg_quality(JPEG_QUALITY)
    with replacing(path) as temporary:
        if not bitmap.write(str(temporary)):
            raise OSError(errno.EIO, "the JPEG writer failed", str(path))


def _without_doubles(copies: list[Copy]) -> list[Copy]:
    """Mark photos whose bytes equal an earlier one's: a pair without a baseline only misleads."""
    first: dict[str, Copy] = {}
    marked = []
    for copy in copies:
        earlier = first.setdefault(copy.sha256, copy)
        if earlier is not copy and not copy.unusable:
            copy = Copy(**{**asdict(copy), "unusable": f"it is identical to {Path(earlier.photo).name}"})
        marked.append(copy)
    return marked


def usable(copies: list[Copy], fewest: int) -> list[Copy]:
    """Return the usable copies; BadInput if they are fewer than `fewest`."""
    kept = [copy for copy in copies if not copy.unusable]
    if len(kept) < fewest:
        first = next((copy for copy in copies if copy.unusable), None)
        why = f" ({Path(first.photo).name}: {first.unusable})" if first else ""
        raise BadInput(
            f"{len(kept)} of {len(copies)} photos can be used{why}; structure from motion needs at least {fewest} "
            "different ones, preferably 20 or more"
        )
    return kept
