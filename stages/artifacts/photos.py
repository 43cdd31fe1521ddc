"""A scene's photos for training and editing, in memory if they fit, otherwise memory-mapped from an unnamed file."""

import mmap
import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from schemas.atomic_write import TEMPORARY_SUFFIX, writing
from schemas.work_folder import Artifact
from stages.artifacts.field import load_field
from stages.artifacts.provenance import shows_its_pictures
from stages.artifacts.scene import SceneData, load_scene
from stages.run.memory import available_bytes, in_words
from stages.run.progress import Context
from stylerf.fields.radiance_field import RadianceField
from stylerf.rendering.view import render_view
from stylerf.training.common.ray_dataset import HIDDEN, STRETCH, Pixels, RayDataset

# Measured memory of training besides its photos: a field of 256^3, its moments and two copies of it; and for each
# thread a buffer of its gradients.
WORKING_BYTES = 1.2e9
THREAD_BYTES = 4 * 8.3e6
MIN_BYTES = 64e6  # of photos that may always be in memory, however little is left


def bank_of(scene: SceneData, views: list[int], folder: Path, context: Context) -> RayDataset:
    """Return the rays of the views, in this order. Photos without alpha among others are opaque.

    Every photo is decoded once. Photos that do not fit in the available memory go to a file in `folder`.
    """
    cameras = [scene.cameras[i] for i in views]
    channels = max(scene.channels(i) for i in views)
    size = sum(c.width * c.height for c in cameras) * channels
    left = max(available_bytes(context.memory) - WORKING_BYTES - THREAD_BYTES * context.threads, MIN_BYTES)
    if size <= left:
        pixels = Pixels(np.empty(size, np.uint8), channels)
        for at, photo in _photos(scene, views, channels):
            pixels.values[at : at + len(photo)] = photo
        return RayDataset(cameras, pixels)
    context.progress.say(
        f"{len(views)} photos need {in_words(size)}, more than the {in_words(left)} of memory that training leaves "
        "free: reading them from a temporary file"
    )
    return RayDataset(cameras, _on_disk(scene, views, channels, size, left, folder))


def _photos(scene: SceneData, views: list[int], channels: int) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the offset and the bytes of every view's photo."""
    at = 0
    for index in views:
        photo = (scene.images(index) * 255 + 0.5).astype(np.uint8)
        if photo.shape[2] < channels:
            photo = np.dstack([photo, np.full(photo.shape[:2], 255, np.uint8)])
        yield at, photo.reshape(-1)
        at += photo.size


def _on_disk(scene: SceneData, views: list[int], channels: int, size: int, most: float, folder: Path) -> Pixels:
    """Map the photos from an unnamed file in `folder`, which the system deletes when the process ends.

    most: bytes of it that may be in this process's memory; the system reclaims its own cache on demand.
    """
    with writing(folder), tempfile.TemporaryFile(dir=folder, prefix=".photos.", suffix=TEMPORARY_SUFFIX) as file:
        if hasattr(os, "posix_fallocate"):  # reports a full disk here; on macOS writing does
            os.posix_fallocate(file.fileno(), 0, size)
        for _, photo in _photos(scene, views, channels):
            file.write(photo.data)
        file.flush()
        mapped = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
    if not hasattr(mapped, "madvise"):  # Windows takes pages back as it sees fit
        return Pixels(np.frombuffer(mapped, np.uint8), channels)
    mapped.madvise(mmap.MADV_RANDOM)
    looked_at = 0

    def read(places: int) -> None:
        nonlocal looked_at
        looked_at += places * STRETCH
        if looked_at > most:
            mapped.madvise(mmap.MADV_DONTNEED)
            looked_at = 0

    return Pixels(np.frombuffer(mapped, np.uint8), channels, read)


def photo_over(scene: SceneData, index: int, level: float) -> np.ndarray:
    """Return the photo over a background of one gray level, [h, w, 3] float32, sRGB 0..1."""
    pixels = scene.images(index)
    if pixels.shape[2] == 4:
        pixels = pixels[..., :3] * pixels[..., 3:] + (1 - pixels[..., 3:]) * np.float32(level)
    return np.ascontiguousarray(pixels, dtype=np.float32)


def photo_for(field: RadianceField, scene: SceneData, index: int, level: float, threads: int) -> np.ndarray:
    """Return the photo as photo_over does, for training the colors of a field.

    With an opaque background nothing is transparent: there masked pixels are those that the field renders.
    """
    pixels = scene.images(index)
    if pixels.shape[2] != 4 or not field.opaque_background:
        return photo_over(scene, index, level)
    shown = pixels[..., 3:] > HIDDEN
    seen = pixels if shown.all() else render_view(field, scene.cameras[index], threads=threads).rgb
    return np.where(shown, pixels[..., :3], seen[..., :3]).astype(np.float32)


def level_of(background: str) -> float:
    """Return the gray level of a background."""
    return 1.0 if background == "white" else 0.0


def load_pictures(artifact: Artifact, of: Artifact, threads: int) -> SceneData:
    """Return the scene as an edit of field `of` sees it: the look of a stylized or recolored field is in no photo."""
    scene = load_scene(artifact, of)
    if shows_its_pictures(of):
        return scene
    field, background = load_field(of)

    def retaken(index: int) -> np.ndarray:
        seen = render_view(field, scene.cameras[index], threads=threads)
        alpha = seen.alpha[..., None]
        if scene.channels(index) == 4:
            return np.concatenate([(seen.rgb / np.maximum(alpha, 1e-6)).clip(0, 1), alpha], axis=2)
        return (seen.rgb + (1 - alpha) * np.float32(level_of(background))).clip(0, 1)

    return replace(scene, retaken=retaken)
