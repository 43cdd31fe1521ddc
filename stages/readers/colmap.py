"""COLMAP models, binary or text."""

from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.silence import native_output_silenced
from stages.readers import model_folder
from stages.readers.source import SourceCamera, SourcePoints, SourceScene, find_image, find_mask, image_folder, natural
from stylerf.errors import InvalidValue
from stylerf.geometry import distortion
from stylerf.geometry.conventions import from_colmap


def read(source: Path, images: str) -> SourceScene:
    """A folder with sparse/0 and images, or a model's own folder with images beside it or at --images."""
    model = model_folder(source)
    if model is None:
        raise BadInput(f"{source} holds no COLMAP model (cameras.bin or cameras.txt, also in sparse/0)")
    reconstruction = load(model)
    root = _root(source, model)
    folder = image_folder(root, images) if images else root / "images"
    return from_reconstruction(reconstruction, folder, root, "COLMAP model", bool(images))


def load(model: Path):
    """pycolmap.Reconstruction of a folder; BadInput where it is damaged: pycolmap answers that in several ways."""
    import pycolmap

    try:
        with native_output_silenced():
            reconstruction = pycolmap.Reconstruction(str(model))
    except (ValueError, IndexError, MemoryError, RuntimeError, OSError) as error:
        first = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise BadInput(f"the COLMAP model {model} cannot be read ({first}); export it again") from error
    if not reconstruction.num_reg_images():
        raise BadInput(f"the COLMAP model {model} holds no photo with a pose; reconstruct again")
    return reconstruction


def from_reconstruction(reconstruction, folder: Path, root: Path, kind: str, rescalable: bool = False) -> SourceScene:
    """The posed photos of a pycolmap.Reconstruction whose photos lie in `folder`, in the order of their names."""
    cameras = []
    for image in sorted(reconstruction.images.values(), key=lambda one: natural(one.name)):
        if not image.has_pose:
            continue
        camera = reconstruction.cameras[image.camera_id]
        try:
            intrinsics, warp = distortion.from_colmap(camera.model.name, list(camera.params))
        except InvalidValue as error:
            raise BadInput(f"{image.name}: {error}") from error
        photo = find_image(folder / image.name)
        cameras.append(
            SourceCamera(
                name=str(Path(image.name).with_suffix("")),
                source=image.name,
                image=photo,
                world_from_camera=from_colmap(np.asarray(image.cam_from_world().matrix())),
                size=(camera.width, camera.height),
                intrinsics=intrinsics,
                distortion=warp,
                mask=find_mask(root, photo),
            )
        )
    return SourceScene(kind, cameras, points_of(reconstruction), rescalable=rescalable)


def points_of(reconstruction) -> SourcePoints | None:
    """The sparse points, in the order of their numbers; None where there are none."""
    points = [reconstruction.points3D[key] for key in sorted(reconstruction.points3D)]
    if not points:
        return None
    return SourcePoints(
        np.array([point.xyz for point in points], dtype=np.float64),
        np.array([point.color for point in points], dtype=np.uint8),
        np.array([point.error for point in points], dtype=np.float32),
    )


def _root(source: Path, model: Path) -> Path:
    """Where `images` lies: the source, or the nearest folder above the model that has it."""
    for folder in (source, *model.parents[:3]):
        if (folder / "images").is_dir():
            return folder
    return source
