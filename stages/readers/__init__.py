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
    signs = (any(source.glob("transforms*.json")), model_folders(source), (source / "poses_bounds.npy").is_file())
    return [kind for kind, sign in zip(FORMATS, signs, strict=True) if sign]


def model_folders(source: Path) -> list[Path]:
    """Folders of COLMAP models: `source` itself, or those in one of the usual places of it, by their numbers."""
    numbered = [
        sorted((item for item in folder.glob("*") if item.name.isdecimal()), key=lambda item: int(item.name))
        for folder in (source / "sparse", source / "colmap" / "sparse")
    ]
    for folders in ([source], numbered[0], [source / "sparse"], numbered[1]):
        if found := [one for one in folders if any((one / f"cameras{end}").is_file() for end in (".bin", ".txt"))]:
            return found
    return []


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
