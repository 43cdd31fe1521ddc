"""One photo of a source: checked, its mask joined, undistorted and shrunk."""

import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.images import coverage, image_size, read_image, read_srgb
from stages.readers.source import SourceCamera, SourceScene
from stylerf.errors import InvalidValue
from stylerf.geometry.camera_conventions import checked_pose
from stylerf.geometry.cameras import Camera
from stylerf.geometry.distortion import pinhole_of, source_positions
from stylerf.geometry.resampling import nearest, shrunk

# The brightest pixel of a photo that shows anything: a covered lens stays below in 8 bits, including noise.
DARKEST_WHITE = 10 / 255
BAND_ROWS = 32


@dataclass(frozen=True, eq=False)
class Sized:
    """A source camera whose size and intrinsics are those of its photo. upright: the photo as EXIF turns it."""

    camera: SourceCamera
    upright: bool
    size: tuple[int, int]
    intrinsics: tuple[float, float, float, float]
    pinhole: tuple[float, float, float, float]
    pose: np.ndarray

    @property
    def split(self) -> str:
        """train or test; train where the source has no split."""
        return self.camera.split or "train"


def sized(camera: SourceCamera, source: SourceScene, alike: dict) -> Sized:
    """Check pose, focal length and size against the photo's header. alike: cache of pinholes by their distortion.

    A photo is also rotated by EXIF if only then its size is that of its camera. BadInput names the photo and the
    problem.
    """
    where = camera.source
    try:
        pose = checked_pose(camera.world_from_camera)
    except InvalidValue as error:
        raise BadInput(f"{where}: {error}; remove the photo from the list or repair its pose") from error
    upright, size = source.upright, image_size(camera.photo, source.upright)
    if camera.size and not upright and not _fits(size, camera.size, source.rescalable):
        turned = image_size(camera.photo)
        if _fits(turned, camera.size, source.rescalable):
            upright, size = True, turned
    intrinsics = _intrinsics(camera, size, source.rescalable)
    key = (size, intrinsics, camera.distortion)
    if key not in alike:
        try:
            alike[key] = pinhole_of(*key)
        except InvalidValue as error:
            raise BadInput(f"{where}: {error}") from error
    return Sized(camera, upright, size, intrinsics, alike[key], pose)


def _fits(size: tuple[int, int], claimed: tuple[int, int], rescalable: bool) -> bool:
    # A copy shrunk by rounding keeps the aspect to half a pixel on each side.
    kx, ky = size[0] / claimed[0], size[1] / claimed[1]
    return size == claimed or (rescalable and abs(kx / ky - 1) <= 1 / min(size))


def _intrinsics(camera: SourceCamera, size: tuple[int, int], rescalable: bool) -> tuple[float, float, float, float]:
    claimed, where = camera.size or size, camera.source
    fx, fy, cx, cy = camera.intrinsics
    fx = _focal(fx, camera.angles[0], claimed[0], f"{where}: its horizontal")
    fy = _focal(fy, camera.angles[1], claimed[1], f"{where}: its vertical")
    fx, fy = (fy if np.isnan(fx) else fx), (fx if np.isnan(fy) else fy)
    cx, cy = (claimed[0] / 2 if np.isnan(cx) else cx), (claimed[1] / 2 if np.isnan(cy) else cy)
    if not (np.isfinite([fx, fy, cx, cy]).all() and fx > 0 and fy > 0):
        raise BadInput(f"{where}: focal length {fx:g} x {fy:g} must be positive; repair the camera")
    if claimed == size:
        return (fx, fy, cx, cy)
    if not _fits(size, claimed, rescalable):
        raise BadInput(
            f"{where}: the photo is {size[0]}x{size[1]}, but its camera expects {claimed[0]}x{claimed[1]}; restore "
            "the photo of that size" + ("" if rescalable else ", or name a folder of smaller copies with --images")
        )
    kx, ky = size[0] / claimed[0], size[1] / claimed[1]
    return (fx * kx, fy * ky, cx * kx, cy * ky)


def _focal(focal: float, angle: float, side: int, which: str) -> float:
    """Return the focal length of an axis in pixels: as given, else by its angle; NaN if both are missing."""
    if not np.isnan(focal) or np.isnan(angle):
        return focal
    if not 0 < angle < np.pi:
        raise BadInput(f"{which} field of view, {angle:g}, is not between 0 and pi; repair the camera")
    return side / 2 / float(np.tan(angle / 2))


def scale_of(size: tuple[int, int], downscale: float, max_side: int) -> float:
    """Return the factor, at most 1, by which a photo's sides are multiplied."""
    factor = 1 / downscale
    return min(factor, max_side / max(size)) if max_side else factor


def scene_camera(one: Sized, factor: float, scene_from_source_pose: np.ndarray) -> Camera:
    """The undistorted camera at the size that the scene holds, with its pose in scene units."""
    return Camera(one.camera.name, *one.size, *one.pinhole, scene_from_source_pose).scaled(factor)


class Developer:
    """Turns photos into the scene's pictures, in any thread; the map of positions is kept for photos of one camera."""

    def __init__(self) -> None:
        self._key: tuple | None = None
        self._positions = np.empty(0)
        self._undistorting = threading.Lock()  # kernels run on all cores; numba's own threads take one at a time

    def picture(self, one: Sized, size: tuple[int, int]) -> np.ndarray:
        """[height, width, 3 or 4] float32, straight alpha, of size (width, height); 4 channels where any pixel is not
        opaque. BadInput for a black, damaged or wrongly masked photo."""
        pixels = read_srgb(one.camera.photo, one.upright).pixels
        pixels = masked(pixels, one.camera.mask, one.camera.hides, one.upright)
        if _brightest(pixels) < DARKEST_WHITE:
            if pixels.shape[2] == 3 or pixels[..., 3].max() > 0.5:
                raise BadInput(f"{one.camera.image} is black; remove it from the capture")
        cut = pixels.shape[2] == 4 and pixels[..., 3].min() < 1
        pixels = np.ascontiguousarray(pixels if cut else pixels[..., :3])
        if cut:
            pixels[..., :3] *= pixels[..., 3:]
        if not one.camera.distortion.none:
            # Imported late: the kernel takes a second to load, which pinhole sources do not need.
            from stylerf.kernels.cpu.photos import remapped

            with self._undistorting:
                pixels = remapped(pixels, self._map(one))
        pixels = shrunk(pixels, size)
        if cut:
            pixels[..., :3] /= np.maximum(pixels[..., 3:], 1e-6)
            pixels[..., :3].clip(0, 1, out=pixels[..., :3])
        return pixels

    def _map(self, one: Sized) -> np.ndarray:
        key = (one.size, one.pinhole, one.intrinsics, one.camera.distortion)
        if key != self._key:
            self._key, self._positions = key, source_positions(*key)
        return self._positions


def _brightest(pixels: np.ndarray) -> float:
    """Return the largest value of a color times its alpha; in bands of rows, as photos can be large."""
    if pixels.shape[2] == 3:
        return float(pixels.max())
    bands = (pixels[top : top + BAND_ROWS] for top in range(0, len(pixels), BAND_ROWS))
    return max(float((band[..., :3] * band[..., 3:]).max()) for band in bands)


def masked(pixels: np.ndarray, mask: Path | None, hides: Path | None, upright: bool) -> np.ndarray:
    """Return the photo [h, w, 1, 3 or 4] as [h, w, 3 or 4], transparent where the mask does not keep it or `hides`
    hides it.

    BadInput for a mask of another shape.
    """
    pixels = pixels if pixels.shape[2] >= 3 else np.repeat(pixels, 3, axis=2)
    kept = [pixels[..., 3]] if pixels.shape[2] == 4 else []
    if mask:
        kept.append(_fitted(coverage(read_image(mask, upright).pixels), mask, pixels))
    if hides:
        shown = (read_image(hides, upright).pixels[..., :3] == 0).all(axis=2).astype(np.float32)
        kept.append(_fitted(shown, hides, pixels) == 1)
    return np.dstack([pixels[..., :3], np.prod(kept, axis=0, dtype=np.float32)]) if kept else pixels


def _fitted(mask: np.ndarray, path: Path, photo: np.ndarray) -> np.ndarray:
    """Return a mask [h, w] at the size of its photo [h, w, ...]; masks of smaller or larger copies are resized."""
    size, there = (photo.shape[1], photo.shape[0]), (mask.shape[1], mask.shape[0])
    if size == there:
        return mask
    if not (_fits(size, there, True) or _fits(there, size, True)):
        raise BadInput(
            f"{path} is {there[0]}x{there[1]}, but its photo is {size[0]}x{size[1]}; make them the same size"
        )
    return shrunk(mask[..., None], size)[..., 0] if size < there else nearest(mask, size)


def lens_without_photo(camera: SourceCamera, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a camera whose photo need not exist. size: its picture's, if the camera has none."""
    return _intrinsics(camera, camera.size or size, rescalable=True)


def present(cameras: list[SourceCamera]) -> tuple[list[SourceCamera], list[SourceCamera]]:
    """Return the cameras with a photo, and those without."""
    return [one for one in cameras if one.image is not None], [one for one in cameras if one.image is None]
