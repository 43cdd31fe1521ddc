"""COLMAP models, binary or text, in the folder layouts of COLMAP, 3DGS and nerfstudio."""

from dataclasses import replace
from pathlib import Path

from schemas.errors import BadInput
from schemas.safe_names import printable
from stages.readers import model_folders
from stages.readers.colmap_model import Model, files_of, read_model
from stages.readers.listed_photos import Folder
from stages.readers.source import SourceCamera, SourcePoints, SourceScene, image_folder, natural, with_masks
from stages.readers.split_lists import lists_of, with_splits
from stylerf.errors import InvalidValue
from stylerf.geometry import distortion
from stylerf.geometry.camera_conventions import from_colmap

PHOTOS = ("images", "input")


def read(source: Path, images: str) -> SourceScene:
    """Read a folder with sparse/0 and images, or a model's own folder with images next to it or at --images.

    COLMAP makes several models if photos fall apart into groups: the one with most photos is used.
    """
    folders = model_folders(source)
    if not folders:
        raise BadInput(f"{source} contains no COLMAP model (cameras.bin or cameras.txt, there or in sparse/0)")
    models, faults = _models(folders)
    largest = max(models, key=lambda one: len(models[one].images))
    kind = "COLMAP model"
    if len(models) > 1:
        others = ", ".join(f"{len(models[one].images)} in {one.name}" for one in models if one != largest)
        kind += (
            f" {largest.name}, of {len(models[largest].images)} photos ({others}; to import another, give its folder)"
        )
    root, below = _photos(source, largest)
    folder = image_folder(root, images) if images else below
    scene = scene_of(models[largest], folder, root, kind, bool(images), above=None if images else root)
    lists = lists_of(root, largest)
    cameras, skipped, remarks = with_splits(scene.cameras, lists)
    return replace(
        scene,
        cameras=cameras,
        skipped=tuple(skipped),
        remarks=(*faults, *models[largest].remarks, *scene.remarks, *remarks),
        files=(*(path for one in folders for path in files_of(one)), *(path for path, _ in lists)),
    )


def _models(folders: list[Path]) -> tuple[dict[Path, Model], list[str]]:
    """Return the intact models, and what is wrong with the others; BadInput if none is intact."""
    models, faults = {}, []
    for folder in folders:
        try:
            models[folder] = read_model(folder)
        except BadInput as error:
            faults.append(error)
    if not models:
        raise faults[0]
    return models, [f"{error}; using another model" for error in faults]


def scene_of(
    model: Model, folder: Path, root: Path, kind: str, rescalable: bool = False, above: Path | None = None
) -> SourceScene:
    """Return the posed photos of a model whose photos are in `folder` (or `above`), by name."""
    cameras, photos = [], Folder(folder, above, "the COLMAP model")
    for image in sorted(model.images, key=lambda one: natural(one.name)):
        camera = model.cameras[image.camera]
        try:
            intrinsics, warp = distortion.from_colmap(camera.model, list(camera.params))
        except InvalidValue as error:
            raise BadInput(f"{printable(image.name)}: {error}") from error
        name, photo = photos.photo(image.name)
        cameras.append(
            SourceCamera(
                name=name,
                source=image.name,
                image=photo,
                world_from_camera=from_colmap(image.camera_from_world),
                size=(camera.width, camera.height),
                intrinsics=intrinsics,
                distortion=warp,
            )
        )
    points = SourcePoints(model.xyz, model.rgb, model.error) if len(model.xyz) else None
    return SourceScene(kind, with_masks(cameras, root), points, rescalable=rescalable, remarks=photos.remarks())


def _photos(source: Path, model: Path) -> tuple[Path, Path]:
    """Return the source, or the nearest folder above the model that contains photos, and its folder of photos.

    3DGS's convert.py reconstructs input/ in distorted/sparse, and writes images/ without distortion.
    """
    names = PHOTOS[::-1] if "distorted" in model.parts[-3:] else PHOTOS
    for folder in (source, *model.parents[:3]):
        for name in names:
            if (folder / name).is_dir():
                return folder, folder / name
    return source, source / "images"
