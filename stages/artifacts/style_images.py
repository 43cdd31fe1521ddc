"""Reads style images and references (Ref-NPR): stylized views, from files or stylized from a photo on the fly."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from schemas.canonical_json import file_sha256
from schemas.errors import BadInput
from schemas.images import read_srgb
from stages.artifacts.scene import SceneData, view_index
from stages.configs.stylize import RefNprConfig
from stages.configs.view_syntax import file_of
from stages.weights.resolve import resolve, resolve_decoder
from stylerf.editing.edit_grid import Region
from stylerf.editing.region_style import crop_of
from stylerf.errors import InvalidValue
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.rendering.ray_registration import best_reference, few_points
from stylerf.style.feature_extractor import FeatureExtractor, resized
from stylerf.style.frame import frame_of
from stylerf.style.image_stylization import Decoder, adain_picture
from stylerf.style.style_features import stroke_picture
from stylerf.style.transparency import without_hidden_colors

SMALLEST_SIDE = 16  # pixels of a style image


def read_colors(path: Path) -> np.ndarray:
    """[h, w, 3] float32 sRGB 0..1; transparent parts are white, grays have three channels."""
    pixels = read_srgb(path).pixels
    if pixels.shape[2] == 4:
        return pixels[..., :3] * pixels[..., 3:] + (1 - pixels[..., 3:])
    return np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels


def read_shown(path: Path, crop: tuple[int, ...] = ()) -> np.ndarray:
    """[h, w, 3] float32 sRGB 0..1; of an image with transparent parts [h, w, 4], see without_hidden_colors.

    Args:
        path: Any image.
        crop: x, y, size: read only this square.

    Raises:
        BadInput: It is not an image, is fully transparent, or the crop does not fit.
    """
    pixels = read_srgb(path).pixels
    try:
        if crop:
            pixels = crop_of(torch.from_numpy(pixels).permute(2, 0, 1), *crop).permute(1, 2, 0).numpy()
        if pixels.shape[2] == 4:
            return without_hidden_colors(pixels)
    except InvalidValue as error:
        raise BadInput(f"{path}: {error}") from error
    return np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels


def read_style_image(
    path: Path,
    keep_frame: bool = False,
    say: Callable[[str], object] = lambda text: None,
    crop: tuple[int, ...] = (),
) -> torch.Tensor:
    """Read a style image without its frame and what it hides.

    Args:
        path: Any image.
        keep_frame: Leave a painting's frame, or the paper around it, in place (see style/frame.py).
        say: Called with a line that says what is left out.
        crop: x, y, size: use this square of the image, as it is.

    Returns:
        [3, h, w] float32 sRGB 0..1; [4, h, w], with an alpha of 0 or 1, if parts are transparent.

    Raises:
        BadInput: It is not an image, is fully transparent, has fewer than 16 pixels per side, or the crop does not fit.
    """
    pixels = read_shown(path, crop)
    _check_size(path, pixels)
    if not (keep_frame or crop) and pixels.shape[2] == 3 and (frame := frame_of(pixels)):
        say(f"{path.name}: left out a frame of {frame}; --keep-frame keeps it")
        pixels = frame.without(pixels)
    return _tensor(path, pixels)


def _check_size(path: Path, pixels: np.ndarray) -> None:
    if min(pixels.shape[:2]) < SMALLEST_SIDE:
        raise BadInput(
            f"{path} is {pixels.shape[1]}x{pixels.shape[0]}; a style image needs at least {SMALLEST_SIDE} pixels per "
            "side"
        )


def _tensor(path: Path, pixels: np.ndarray) -> torch.Tensor:
    _check_size(path, pixels)
    return torch.from_numpy(np.ascontiguousarray(pixels)).permute(2, 0, 1).contiguous()


LIKE = 0.01  # the most that a picture's aspect ratio may differ from its view's: one pixel of a small picture


def digest_of(references: Sequence[str]) -> str:
    """Return the digest of the views and files of VIEW=FILE texts; BadInput if one is missing or not a picture."""
    total = hashlib.sha256()
    for text in references:
        view, path = file_of(text)
        if not path.is_file():
            raise BadInput(f"--reference {text}: image not found")
        _tensor(path, read_colors(path))
        total.update(f"{view}={file_sha256(path)}\n".encode())
    return total.hexdigest() if references else ""


def training_view(scene: SceneData, name: str, flag: str) -> int:
    """Return a view's position among the training views, by its name or by its number in the scene."""
    index, train = view_index(scene, name, flag), scene.splits["train"]
    if index not in train:
        raise BadInput(f"{flag}: view {name} is held out for evaluation; choose a training view")
    return train.index(index)


def read_references(
    scene: SceneData, references: Sequence[str], cameras: Sequence[Camera]
) -> dict[int, np.ndarray | None]:
    """Return the stylized pictures, [h, w, 3] sRGB 0..1, by position among the training views.

    cameras: of the training views, in the size that pictures get; others may follow.
    """
    found: dict[int, np.ndarray | None] = {}
    for text in references:
        name, file = file_of(text)
        place = training_view(scene, name, f"--reference {text}")
        camera = scene.cameras[scene.splits["train"][place]]
        picture = _tensor(file, read_colors(file))
        height, width = picture.shape[1:]
        if abs(width * camera.height / (height * camera.width) - 1) > LIKE:
            raise BadInput(
                f"{file} is {width}x{height}, but view {name} is {camera.width}x{camera.height}; give a reference of "
                "the same aspect ratio"
            )
        if place in found:
            raise BadInput(f"--reference {text}: view {name} already has a reference")
        found[place] = at_size_of(cameras[place], picture)
    return found


def at_size_of(camera: Camera, picture: torch.Tensor) -> np.ndarray:
    """Return a picture [3, h, w] resized to the camera's view, [height, width, 3]."""
    return resized(picture, camera.height, camera.width).permute(1, 2, 0).contiguous().numpy()


def chosen_view(
    scene: SceneData,
    field: RadianceField,
    cameras: list[Camera],
    config: RefNprConfig,
    weight_threshold: float,
    threads: int,
    region: Region | None = None,
) -> int:
    """Place among the training views of the one to make a reference: --reference-view, or the best seen by all.

    cameras: those of the training views first; others have no photo and cannot be chosen.
    region: what should be visible, instead of the whole scene.
    """
    if config.reference_view:
        return training_view(scene, config.reference_view, f"--reference-view {config.reference_view}")
    seen = few_points(field, cameras[: len(scene.splits["train"])], weight_threshold, threads)
    if region is not None:
        seen = [replace(one, there=one.there & region.holds(one.places)) for one in seen]
    return best_reference(seen)


def check_references(scene: SceneData, config: RefNprConfig) -> None:
    """Raise BadInput or UsageError for invalid options before any long computation."""
    read_references(scene, config.reference, [scene.cameras[i] for i in scene.splits["train"]])
    if config.reference_view:
        training_view(scene, config.reference_view, f"--reference-view {config.reference_view}")
    if config.reference_by == "adain":
        resolve_decoder()
        resolve("vgg19-wct")


def decoded_reference(
    photo: np.ndarray, style_image: torch.Tensor, scale: float, stroke: float, device: str
) -> np.ndarray:
    """Stylize a photo [h, w, 3] in one pass by AdaIN at conv3_1; UsageError if its weights are missing.

    scale: of the style image, relative to the photo. stroke: size of its strokes, relative to that.
    """
    decoder, found = resolve_decoder(), resolve("vgg19-wct")
    extractor = FeatureExtractor(found.state, "conv3_1", found.kind).to(device)
    there = torch.from_numpy(photo).permute(2, 0, 1).contiguous().to(device)
    picture = stroke_picture(style_image, max(1, round(max(photo.shape[:2]) * scale)), stroke).to(device)
    made = adain_picture(extractor, Decoder(decoder.state).to(device), there, picture)
    return made.permute(1, 2, 0).contiguous().cpu().numpy()
