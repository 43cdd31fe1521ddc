"""Readers of sources: one module per format of poses, each returning a SourceScene, and one of plain photos."""

from pathlib import Path

from schemas.errors import BadInput
from stages.readers.source import SourceScene

FORMATS = ("transforms", "colmap", "llff")


def detected(source: Path) -> list[str]:
    """Which of FORMATS lie at `source` (a folder, or one file of it), the most telling first; none: no poses.

    transforms.json tells lens and splits, a COLMAP model lens and points, LLFF neither.
    """
    if source.is_file():
        named = {"poses_bounds.npy": ["llff"]}.get(source.name, [])
        return ["transforms"] if source.suffix == ".json" else named
    signs = (any(source.glob("transforms*.json")), model_folder(source), (source / "poses_bounds.npy").is_file())
    return [kind for kind, sign in zip(FORMATS, signs, strict=True) if sign]


def model_folder(source: Path) -> Path | None:
    """The folder of a COLMAP model: `source` itself or one of the usual places in it."""
    for folder in (source, source / "sparse" / "0", source / "sparse", source / "colmap" / "sparse" / "0"):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    return None


def read_source(source: Path, format: str = "auto", images: str = "") -> SourceScene:
    """The posed photos at `source`; images: a folder of photos to use in place of the source's own.

    BadInput where nothing is found, or what is found is damaged.
    """
    if not source.exists():
        raise BadInput(f"{source} does not exist; give a folder of photos with poses")
    kind = next(iter(detected(source)), None) if format == "auto" else format
    if kind == "transforms":
        from stages.readers.transforms import read
    elif kind == "colmap":
        from stages.readers.colmap import read
    elif kind == "llff":
        from stages.readers.llff import read
    else:
        raise BadInput(
            f"{source} holds no transforms.json, no COLMAP model (sparse/0) and no poses_bounds.npy; give a folder "
            "that has one of them"
        )
    return read(source, images)
