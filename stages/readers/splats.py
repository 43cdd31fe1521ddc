"""Splats as a source: a PLY of 3D Gaussian splatting, seen from the cameras that it was made from, or others.

3DGS's output folder holds point_cloud/iteration_N/point_cloud.ply and cameras.json; --cameras names other cameras:
such a list, a COLMAP model or a transforms.json, all in the splats' frame. Photos need not exist.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from schemas.errors import BadInput, OutOfResources
from schemas.images import image_size, to_uint8, write_png
from schemas.journal import Journal
from schemas.safe_names import check_utf8, printable
from schemas.safe_reading import allowance, read_json
from schemas.splat_ply import is_splat_ply, read_splat_ply
from stages.readers.checked_values import entry_of, number, row, size
from stages.readers.photos import lens_without_photo
from stages.readers.source import SourceCamera, SourcePoints, SourceScene
from stages.run.progress import Context
from stylerf.errors import InvalidValue
from stylerf.geometry.camera_conventions import checked_pose
from stylerf.geometry.cameras import Camera
from stylerf.geometry.distortion import pinhole_of

if TYPE_CHECKING:  # imports numba, which no other import needs
    from stylerf.kernels.cpu.splats import Gaussians

# Longest side of a picture: 3DGS trains on at most this many columns, and shows no finer detail.
LONGEST = 1600
NEAR = 0.2  # least depth of a splat, in the file's units: 3DGS neither trains nor shows nearer ones
# Alpha from which a pixel is treated as opaque: splats let a little light through what they were trained to cover.
OPAQUE = 0.98
MOST_CAMERAS = 20_000
# Number of splats kept as the scene's sparse points: the most opaque.
MOST_POINTS, POINT_OPACITY = 50_000, 0.5
_C0 = 0.28209479177387814


@dataclass(frozen=True)
class SplatFiles:
    """The files of a source: the PLY, and the cameras: a file or a folder."""

    splats: Path
    cameras: Path


def splats_in(source: Path) -> Path | None:
    """Find the splats at `source`: a PLY of splats, or the last iteration in 3DGS's output folder."""
    if source.is_file():
        return source if source.suffix.lower() == ".ply" else None
    found: list[tuple[int, Path]] = []
    for path in source.glob("point_cloud/iteration_*/point_cloud.ply"):
        digits = path.parent.name.removeprefix("iteration_")
        if digits.isascii() and digits.isdecimal() and len(digits) < 10 and path.is_file():
            found.append((int(digits), path))
    if found:
        return max(found)[1]
    plain = source / "point_cloud.ply"
    return plain if plain.is_file() and is_splat_ply(plain) else None


def files_of(source: Path, cameras: str) -> SplatFiles:
    """Return the splats and their cameras: --cameras, or the cameras.json of the folder; BadInput if one is missing."""
    splats = splats_in(source)
    if splats is None:
        raise BadInput(
            f"{source} contains no splats; give a .ply of splats or the output folder of 3D Gaussian splatting"
        )
    if cameras:
        given = Path(cameras)
        if not given.exists():
            raise BadInput(f"--cameras {cameras}: no such file or folder")
        check_utf8(given)
        return SplatFiles(splats, given)
    above = [source] if source.is_dir() else [splats.parent, *splats.parents[1:3]]
    for folder in above:
        if (folder / "cameras.json").is_file():
            return SplatFiles(splats, folder / "cameras.json")
    raise BadInput(
        f"{source} comes without cameras; give them with --cameras: a 3DGS cameras.json, a COLMAP model or a "
        "transforms.json"
    )


def pose_files(files: SplatFiles) -> list[Path]:
    """List the files that the cameras are read from."""
    from stages.readers import read_source

    if _is_list(files.cameras):
        return [files.cameras]
    scene = read_source(files.cameras)
    return list(scene.files) or ([files.cameras] if files.cameras.is_file() else sorted(files.cameras.glob("*.json")))


def rendered(files: SplatFiles, folder: Path, context: Context) -> SourceScene:
    """Render the splats from the cameras to PNGs in `folder`; finished ones of an interrupted run are kept.

    Raises:
        BadInput: A file is damaged, or the cameras see nothing.
        OutOfResources: The splats do not fit in memory.
    """
    cameras, kind = _cameras(files.cameras)
    stored = read_splat_ply(files.splats)
    from stylerf.kernels.cpu.splats import Gaussians

    gaussians = Gaussians(stored.centers, stored.log_scales, stored.quaternions, stored.logits, stored.harmonics)
    context.progress.say(f"{len(stored.centers)} splats seen by {len(cameras)} cameras ({kind})")
    journal = Journal(folder / "whole.jsonl", folder)
    context.progress.start("rendering splats", len(cameras), "view")
    found, empty = [], []
    for index, one in enumerate(cameras):
        camera = _pinhole(one)
        name = f"{index:05d}.png"
        if not journal.holds([name]):
            write_png(folder / name, _seen(gaussians, camera, files.splats, context.threads))
            journal.add([name])
        if _is_empty(folder / name):
            empty.append((one.source, "it sees no splats"))
        else:
            found.append(_of_render(one, camera, folder / name))
        context.progress.update(index + 1)
    context.progress.finish()
    if not found:
        raise BadInput(
            f"{printable(str(files.cameras))}: no camera sees any splat of {printable(str(files.splats))}; give "
            "cameras in the coordinate frame of the splats"
        )
    return SourceScene(f"splats, {kind}", found, _points(gaussians), skipped=tuple(empty))


def _is_list(path: Path) -> bool:
    """Return whether a file is 3DGS's cameras.json: a list, while transforms.json is an object."""
    return path.is_file() and path.suffix.lower() == ".json" and isinstance(read_json(path), list)


def _cameras(path: Path) -> tuple[list[SourceCamera], str]:
    from stages.readers import read_source

    if _is_list(path):
        return _listed(path), "cameras.json of 3DGS"
    scene = read_source(path)
    return scene.cameras, f"cameras of {scene.kind}"


def _listed(path: Path) -> list[SourceCamera]:
    """Read 3DGS's cameras.json: for each camera its center, rotation to the world by rows (OpenCV axes), and focal
    lengths.

    The principal point is the center, and there is no distortion: 3DGS supports neither.
    """
    entries, shown = read_json(path), printable(str(path))
    if not 0 < len(entries) <= MOST_CAMERAS:
        raise BadInput(f"{shown} lists {len(entries)} cameras; expected 1 to {MOST_CAMERAS}")
    cameras: dict[str, SourceCamera] = {}
    for place, entry in enumerate(entries):
        where = f"{shown}: camera {place}"
        name = printable(str(entry_of(entry, "img_name", where, f"{place:05d}")))[:200].replace("\\", "/").strip("/")
        rows = entry_of(entry, "rotation", where)
        if not isinstance(rows, list) or len(rows) != 3:
            raise BadInput(f"{where}: its rotation is not a list of 3 rows")
        pose = np.eye(4)
        pose[:3, :3] = [row(values, 3, f"{where}: its rotation") for values in rows]
        pose[:3, 3] = row(entry_of(entry, "position", where), 3, f"{where}: its position")
        width, height = size(entry, where)
        fx, fy = number(entry, "fx", where), number(entry, "fy", where)
        unique = name
        while not unique or unique in cameras:
            unique = f"{unique}-{place:05d}"
        cameras[unique] = SourceCamera(
            unique, unique, None, pose, (width, height), (fx, fy, width / 2, height / 2)
        )  # fmt: skip
    return list(cameras.values())


def _pinhole(one: SourceCamera) -> Camera:
    """Return the camera without its distortion, of at most LONGEST pixels per side."""
    if one.size is None and one.image is None:
        raise BadInput(f"{one.source}: its camera has no size, and its photo is missing; give w and h")
    full = one.size or image_size(one.photo)
    intrinsics = lens_without_photo(one, full)
    try:
        pose = checked_pose(one.world_from_camera)
        fx, fy, cx, cy = pinhole_of(full, intrinsics, one.distortion)
        camera = Camera(one.name, *full, fx, fy, cx, cy, pose)
    except InvalidValue as error:
        raise BadInput(f"{one.source}: {error}; repair the camera") from error
    return camera.scaled(min(1.0, LONGEST / max(full)))


def _seen(gaussians: "Gaussians", camera: Camera, path: Path, threads: int) -> np.ndarray:
    """[h, w, 3 or 4] uint8, straight alpha."""
    from stylerf.splats.forward import picture

    try:
        image = picture(gaussians, camera, near=NEAR, threads=threads, most_bytes=allowance() // 4)
    except InvalidValue as error:
        raise OutOfResources(f"{printable(str(path))}: {error}; remove large splats or raise --memory") from error
    alpha = np.where(image[..., 3:] >= OPAQUE, 1, image[..., 3:])
    if alpha.min() == 1:
        return to_uint8(image[..., :3].clip(0, 1))
    straight = image[..., :3] / np.maximum(alpha, 1e-6)
    return to_uint8(np.concatenate([straight, alpha], axis=2).clip(0, 1))


def _is_empty(path: Path) -> bool:
    from schemas.images import read_image

    pixels = read_image(path).pixels
    shown = pixels[..., :3] * pixels[..., 3:] if pixels.shape[2] == 4 else pixels
    return bool(shown.max() < 0.04)


def _of_render(one: SourceCamera, camera: Camera, path: Path) -> SourceCamera:
    return replace(
        SourceCamera(one.name, one.source, path, one.world_from_camera, split=one.split),
        size=(camera.width, camera.height), intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy),
    )  # fmt: skip


def _points(gaussians: "Gaussians") -> SourcePoints | None:
    """Return the centers of the most opaque splats with their mean colors."""
    opaque = np.flatnonzero(gaussians.logits > np.log(POINT_OPACITY / (1 - POINT_OPACITY)))
    order = np.argsort(-gaussians.logits[opaque], kind="stable")[:MOST_POINTS]
    chosen = np.sort(opaque[order])
    if not len(chosen):
        return None
    rgb = to_uint8((0.5 + _C0 * gaussians.harmonics[chosen, 0]).clip(0, 1))
    return SourcePoints(gaussians.centers[chosen].astype(np.float64), rgb, np.zeros(len(chosen), np.float32))
