"""Readers of sources: one module per pose format, each returning a SourceScene, and one for plain photos."""

import importlib
from dataclasses import dataclass, replace
from pathlib import Path

from schemas.errors import BadInput
from schemas.safe_names import check_utf8, printable
from stages.configs.pose_import import FORMATS
from stages.readers.source import SourceScene

XML_MARKS = (b"<document", b"<chunk")


@dataclass(frozen=True)
class Found:
    """What a source contains. kind: one of FORMATS, photos, video or splats. also: other formats found. remarks: for
    the user."""

    kind: str
    also: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def found_in(source: Path, format: str = "auto") -> Found:
    """Pick the format to read: the requested one, or the most complete of those found; photos if there are no poses,
    and splats or video if there are no photos either.

    Raises:
        BadInput: `source` does not exist, its path is not UTF-8, or its only poses are of an unsupported format.
    """
    if not source.exists():
        raise BadInput(f"{source} does not exist; give a folder of photos")
    check_utf8(source)
    if format != "auto":
        return Found(format)
    from stages.readers.unsupported import foreign_poses

    kinds, foreign = detected(source), foreign_poses(source)
    if not kinds and foreign:
        one = foreign[0]
        raise BadInput(
            f"{printable(str(one.path))} contains poses of {one.tool}, which are not supported: {one.how}; or find "
            "new poses from the photos with --format photos"
        )
    if not kinds:
        return _without_poses(source)
    remarks = [f"poses of {one.tool} are not supported ({printable(one.path.name)})" for one in foreign]
    incomplete = [one for one in model_folders(source) if not whole_model(one)]
    if incomplete and kinds[0] != "colmap":
        remarks.append(f"the COLMAP model {incomplete[0]} lacks cameras or images and is not used")
    also = [kind for kind in kinds[1:] if not (kind == "colmap" and incomplete)]
    return Found(kinds[0], tuple(also), tuple(remarks))


def _without_poses(source: Path) -> Found:
    from stages.readers.photo_folder import folder_of
    from stages.readers.source import images_in
    from stages.readers.splats import splats_in
    from stages.readers.video import clips_of

    photos = source.is_dir() and images_in(folder_of(source))
    clips = clips_of(source)
    if not photos and splats_in(source):
        return Found("splats")
    if clips and not photos:
        return Found("video")
    names = ", ".join(printable(one.name) for one in clips[:3]) + (", ..." if len(clips) > 3 else "")
    remark = f"video is ignored because there are photos ({names}); --format video imports it"
    return Found("photos", remarks=(remark,) if clips else ())


def detected(source: Path) -> list[str]:
    """List those of FORMATS found at `source` (a folder, or one file of it), the most complete first.

    transforms.json has lens and splits, a COLMAP model lens and points, LLFF neither. A COLMAP model with missing files
    comes last: anything else is preferred to it.
    """
    if source.is_file():
        named = {"poses_bounds.npy": ["llff"], "reconstruction.json": ["opensfm"], "metadata.json": ["record3d"]}
        by_suffix = {".json": ["transforms"], ".xml": ["metashape"]}
        return named.get(source.name, by_suffix.get(source.suffix, []))
    signs = (
        any(source.glob("transforms*.json")),
        any(whole_model(folder) for folder in model_folders(source)),
        (source / "poses_bounds.npy").is_file(),
        metashape_file(source),
        opensfm_file(source),
        polycam_folder(source),
        record3d_file(source),
    )
    found = [kind for kind, sign in zip(FORMATS, signs, strict=True) if sign]
    return found + (["colmap"] if "colmap" not in found and model_folders(source) else [])


def model_folders(source: Path) -> list[Path]:
    """List the folders of COLMAP models: `source` itself, or those in its usual places, by number.

    The first place with a complete model is used, otherwise the first with any file of one.
    """
    places = [[source]]
    for folder in (source / "sparse", source / "colmap" / "sparse", source / "distorted" / "sparse"):
        numbered = (item for item in folder.glob("*") if item.name.isdecimal())
        places += [sorted(numbered, key=lambda item: (int(item.name), item.name)), [folder]]
    there = [[one for one in folders if _any_model(one)] for folders in places]
    for folders in there:
        if any(map(whole_model, folders)):
            return folders
    return next(filter(None, there), [])


def _any_model(folder: Path) -> bool:
    return any((folder / f"{name}{end}").is_file() for name in ("cameras", "images") for end in (".bin", ".txt"))


def whole_model(folder: Path) -> bool:
    """Return whether the folder holds both the cameras and the photos of a COLMAP model."""
    from stages.readers.colmap_model import whole

    return bool(whole(folder))


def metashape_file(source: Path) -> Path | None:
    """Find Metashape's exported cameras: cameras.xml, or the first XML file that looks like it."""
    from stages.readers.unsupported import MOST_FILES, head_of

    if source.is_file() or (source / "cameras.xml").is_file():
        return source if source.is_file() else source / "cameras.xml"
    files = sorted(source.glob("*.xml"))[:MOST_FILES]
    return next((path for path in files if all(mark in head_of(path) for mark in XML_MARKS)), None)


def opensfm_file(source: Path) -> Path | None:
    """Find OpenSfM's reconstruction.json, in the source or where OpenDroneMap puts it."""
    places = (source, source / "reconstruction.json", source / "opensfm" / "reconstruction.json")
    return next((path for path in places if path.is_file()), None)


def polycam_folder(source: Path) -> Path | None:
    """Find the folder of Polycam's cameras and images, optimized if available, otherwise as recorded."""
    for folder in (source / "keyframes", source):
        for cameras, images in POLYCAM:
            if (folder / images).is_dir() and keyframes_in(folder / cameras):
                return folder
    return None


def keyframes_in(folder: Path) -> list[Path]:
    """List the cameras in a Polycam folder, without the hidden files that macOS adds on foreign disks."""
    return [path for path in folder.glob("*.json") if path.name[0] != "."]


# Polycam's folders of cameras and images, in order of preference.
POLYCAM = (("corrected_cameras", "corrected_images"), ("cameras", "images"))


def record3d_file(source: Path) -> Path | None:
    """Record3D's metadata.json beside rgb/ or rgbd/, or that in EXR_RGBD/; `metadata` in an unpacked .r3d."""
    if source.is_file():
        return source
    for folder in (source, source / "EXR_RGBD"):
        if any((folder / name).is_dir() for name in ("rgb", "rgbd")):
            for name in ("metadata.json", "metadata"):
                if (folder / name).is_file():
                    return folder / name
    return None


def read_source(source: Path, format: str = "auto", images: str = "") -> SourceScene:
    """Read the posed photos at `source`. images: a folder of photos to use instead of the source's own.

    BadInput if nothing is found, or what is found is damaged.
    """
    found = found_in(source, format)
    if found.kind not in FORMATS:
        raise BadInput(
            f"{source} holds no transforms.json, no COLMAP model (sparse/0) and no poses_bounds.npy; give a folder "
            "that has one of them"
        )
    try:
        scene = importlib.import_module(f"stages.readers.{found.kind}").read(source, images)
    except BadInput as error:
        if found.also:
            raise BadInput(f"{error}; or use the other poses found, with --format {found.also[0]}") from error
        if FORMATS.index(found.kind) > 2:
            raise BadInput(f"{error}; or find new poses from the photos, with --format photos") from error
        raise
    return replace(scene, remarks=found.remarks + scene.remarks)
