"""COLMAP models, binary or text."""

from pathlib import Path

from schemas.errors import BadInput
from stages.readers import model_folders
from stages.readers.colmap_model import Model, read_model
from stages.readers.source import (
    SourceCamera,
    SourcePoints,
    SourceScene,
    bare,
    find_image,
    image_folder,
    natural,
    with_masks,
)
from stylerf.errors import InvalidValue
from stylerf.geometry import distortion
from stylerf.geometry.conventions import from_colmap


def read(source: Path, images: str) -> SourceScene:
    """A folder with sparse/0 and images, or a model's own folder with images beside it or at --images.

    COLMAP makes several models where photos fall apart into groups: the one of most photos counts.
    """
    folders = model_folders(source)
    if not folders:
        raise BadInput(f"{source} holds no COLMAP model (cameras.bin or cameras.txt, also in sparse/0)")
    models = {one: read_model(one) for one in folders}
    largest = max(folders, key=lambda one: len(models[one].images))
    kind = "COLMAP model"
    if len(folders) > 1:
        others = ", ".join(f"{len(models[one].images)} in {one.name}" for one in folders if one != largest)
        kind += f" {largest.name}, of {len(models[largest].images)} photos ({others}; name another's folder for it)"
    root = _root(source, largest)
    folder = image_folder(root, images) if images else root / "images"
    return scene_of(models[largest], folder, root, kind, bool(images))


def scene_of(model: Model, folder: Path, root: Path, kind: str, rescalable: bool = False) -> SourceScene:
    """The posed photos of a model whose photos lie in `folder`, in the order of their names."""
    cameras = []
    for image in sorted(model.images, key=lambda one: natural(one.name)):
        camera = model.cameras[image.camera]
        try:
            intrinsics, warp = distortion.from_colmap(camera.model, list(camera.params))
        except InvalidValue as error:
            raise BadInput(f"{image.name}: {error}") from error
        photo = find_image(folder / image.name)
        cameras.append(
            SourceCamera(
                name=str(bare(Path(image.name))),
                source=image.name,
                image=photo,
                world_from_camera=from_colmap(image.camera_from_world),
                size=(camera.width, camera.height),
                intrinsics=intrinsics,
                distortion=warp,
            )
        )
    points = SourcePoints(model.xyz, model.rgb, model.error) if len(model.xyz) else None
    return SourceScene(kind, with_masks(cameras, root), points, rescalable=rescalable)


def _root(source: Path, model: Path) -> Path:
    """Where `images` lies: the source, or the nearest folder above the model that has it."""
    for folder in (source, *model.parents[:3]):
        if (folder / "images").is_dir():
            return folder
    return source
