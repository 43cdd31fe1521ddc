"""A scene's photos as training wants them: in memory while they fit, else read from a file that has no name."""

import mmap
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from schemas.atomic_write import TEMPORARY_SUFFIX, writing
from stages.artifacts.scene import SceneData
from stages.run.memory import available_bytes, in_words
from stages.run.progress import Context
from stylerf.fields.radiance_field import RadianceField
from stylerf.rendering.view import render_view
from stylerf.training.common.pixels import STRETCH, Pixels
from stylerf.training.common.ray_dataset import HIDDEN, RayDataset

# What training takes beside its photos, as measured: a field of 256^3, its moments and two copies of it; and for each
# thread a buffer of its gradients.
WORKING_BYTES = 1.2e9
THREAD_BYTES = 4 * 8.3e6
LEAST_BYTES = 64e6  # of photos that may be in memory, however little of it is left


def bank_of(scene: SceneData, views: list[int], folder: Path, context: Context) -> RayDataset:
    """Rays of the views, in this order. With and without alpha together: those without are opaque.

    Every photo is decoded once. Where they do not fit in the memory that is left, they go to a file in `folder`.
    """
    cameras = [scene.cameras[i] for i in views]
    channels = max(scene.channels(i) for i in views)
    size = sum(c.width * c.height for c in cameras) * channels
    left = max(available_bytes(context.memory) - WORKING_BYTES - THREAD_BYTES * context.threads, LEAST_BYTES)
    if size <= left:
        pixels = Pixels(np.empty(size, np.uint8), channels)
        _fill(lambda at, photo: pixels.values.__setitem__(slice(at, at + len(photo)), photo), scene, views, channels)
        return RayDataset(cameras, pixels)
    context.progress.say(
        f"{len(views)} photos take {in_words(size)}, more than the {in_words(left)} of memory that training leaves "
        "them: they are read from a file while it runs"
    )
    return RayDataset(cameras, _on_disk(scene, views, channels, size, left, folder))


def _fill(put: Callable[[int, np.ndarray], None], scene: SceneData, views: list[int], channels: int) -> None:
    """put(place, bytes) for every view in turn."""
    at = 0
    for index in views:
        photo = (scene.images(index) * 255 + 0.5).astype(np.uint8)
        if photo.shape[2] < channels:
            photo = np.dstack([photo, np.full(photo.shape[:2], 255, np.uint8)])
        put(at, photo.reshape(-1))
        at += photo.size


def _on_disk(scene: SceneData, views: list[int], channels: int, size: int, most: float, folder: Path) -> Pixels:
    """The photos in a file of `folder` without a name: the system deletes it with the process, however that ends.

    most: bytes of it that may be in this process's memory. What the system keeps of it beside it takes back by itself.
    """
    with writing(folder), tempfile.TemporaryFile(dir=folder, prefix=".photos.", suffix=TEMPORARY_SUFFIX) as file:
        if hasattr(os, "posix_fallocate"):  # a full disk is met here, on macOS as the photos are written
            os.posix_fallocate(file.fileno(), 0, size)
        _fill(lambda at, photo: file.write(photo.data), scene, views, channels)
        file.flush()
        mapped = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)
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
    """[h, w, 3] float32, sRGB 0..1, over a background of one gray level."""
    pixels = scene.images(index)
    if pixels.shape[2] == 4:
        pixels = pixels[..., :3] * pixels[..., 3:] + (1 - pixels[..., 3:]) * np.float32(level)
    return np.ascontiguousarray(pixels, dtype=np.float32)


def photo_for(field: RadianceField, scene: SceneData, index: int, level: float, chunks: int) -> np.ndarray:
    """As photo_over, for what teaches colors to a field's shapes.

    Nothing of a closed space is transparent: what a mask hides there is what the field shows already.
    """
    pixels = scene.images(index)
    if pixels.shape[2] != 4 or not field.opaque_background:
        return photo_over(scene, index, level)
    shown = pixels[..., 3:] > HIDDEN
    seen = pixels if shown.all() else render_view(field, scene.cameras[index], threads=chunks).rgb
    return np.where(shown, pixels[..., :3], seen[..., :3]).astype(np.float32)


def level_of(background: str) -> float:
    """Gray level of what stands behind a field in pictures."""
    return 1.0 if background == "white" else 0.0
