"""Recognizes poses of unsupported formats by their files, so that they are reported and not silently ignored."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

MOST_FILES = 20  # of one suffix that are opened
HEAD_BYTES = 4096
AS_COLMAP = "export its registration there as COLMAP text (cameras.txt, images.txt), into sparse/0 here"


@dataclass(frozen=True)
class UnsupportedPoses:
    """Poses of an unsupported tool. how: the way to convert them."""

    path: Path
    tool: str
    how: str


def foreign_poses(source: Path) -> list[UnsupportedPoses]:
    """List the poses of unsupported tools in the folder `source`."""
    if not source.is_dir():
        return []
    return [UnsupportedPoses(path, tool, how) for find, tool, how in KINDS if (path := next(find(source), None))]


def _named(*patterns: str) -> Callable[[Path], Iterator[Path]]:
    return lambda source: (path for pattern in patterns for path in sorted(source.glob(pattern)))


def _holding(suffix: str, *marks: bytes) -> Callable[[Path], Iterator[Path]]:
    """Return a search for files whose first bytes hold one of the marks."""

    def found(source: Path) -> Iterator[Path]:
        for folder in (source, source / "images"):
            for path in sorted(folder.glob(f"*{suffix}"))[:MOST_FILES]:
                if any(mark in head_of(path) for mark in marks):
                    yield path

    return found


def head_of(path: Path) -> bytes:
    """Return the first bytes of a regular file; none if it cannot be read."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as stream:
            return stream.read(HEAD_BYTES)
    except OSError:
        return b""


KINDS: tuple[tuple[Callable[[Path], Iterator[Path]], str, str], ...] = (
    (_holding(".csv", b"#name,", b"#cameras", b"Name,X,Y,Z,Heading"), "RealityCapture", AS_COLMAP),
    (_named("cameras.csv", "*.rcproj"), "RealityCapture", AS_COLMAP),
    (_holding(".xmp", b"xcr:Rotation", b"xcr:Position"), "RealityCapture", AS_COLMAP),
    (
        _named("*.sfm", "*.mg", "MeshroomCache"),
        "Meshroom",
        "convert them (aliceVision_exportColmap -i cameras.sfm -o FOLDER --copyImages 1) and import FOLDER",
    ),
    (
        _named("*.psx", "*.psz"),
        "Metashape",
        "export them there (File > Export > Export Cameras, Agisoft XML) as cameras.xml beside the photos",
    ),
    (_named("*.r3d"), "Record3D", "unpack it (it is a zip file) and import the folder"),
    (
        _named("sfm_data.json", "sfm_data.bin"),
        "OpenMVG",
        "convert them: openMVG_main_openMVG2Colmap -i sfm_data.bin -o sparse/0",
    ),
    (_named("*.nvm"), "VisualSFM", "export them there as a COLMAP model"),
    (_named("bundle.out", "bundle*.out"), "Bundler", "export a COLMAP model or a transforms.json instead"),
)
