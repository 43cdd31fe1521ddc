"""Which pixels of a view show the region of a local edit: from the regions' cells, or from mask images."""

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

import numpy as np
from skimage.transform import resize

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from schemas.images import coverage, read_image
from schemas.work_folder import Artifact
from stages.artifacts.field import load_field
from stages.artifacts.region import regions_among
from stages.evaluation.test_views import FrameViews, Render
from stages.run.progress import Context
from stylerf.editing.edit_grid import march_view
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.rendering.rays import alpha_inside

REGION_THRESHOLD = 0.5  # coverage above which a pixel belongs to the region
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
ASPECT_TOLERANCE = 0.02  # relative difference of the aspect ratios of a mask and its view


class RegionMasks:
    """Masks from regions: alpha_E of the unedited field, the part of a pixel's opacity inside their cells."""

    description = (
        "whose alpha_E (the part of the unedited field's opacity inside the region) is above 0.5, and all within "
        "{margin} pixels of them,"
    )

    def __init__(self, regions: Mapping[str, Artifact], base: Artifact, context: Context) -> None:
        self._field, _ = load_field(base)
        self._regions = regions_among(regions, self._field.space)
        self._context = context

    def inside(self, frames: FrameViews, index: int, render: Render) -> np.ndarray:
        """Pixels [h, w] where view `index` of the unedited field's frames shows any of the regions."""
        inside = np.zeros(render.alpha.shape, bool)
        missing = []
        for name, region in self._regions.items():
            mask = frames.mask(index, name, region.digest)
            if mask is None or mask.shape != inside.shape:
                missing.append(region.cells)
            else:
                inside |= mask > REGION_THRESHOLD
        return inside | self._march(render, missing) if missing else inside

    def march(self, render: Render) -> np.ndarray:
        """Pixels [h, w] where the unedited field shows any of the regions, for cameras it was not rendered from."""
        return self._march(render, [region.cells for region in self._regions.values()])

    def _march(self, render: Render, regions: list[np.ndarray]) -> np.ndarray:
        threads = set_threads(self._context.threads)
        inside = np.zeros(render.alpha.size, bool)
        with compiling_note(self._context.progress.say):
            for rays, samples in march_view(self._field, render.camera, threads):
                for cells in regions:
                    inside[rays] |= alpha_inside(cells, samples, threads) > REGION_THRESHOLD
        return inside.reshape(render.alpha.shape)


class ImageMasks:
    """Masks from images in a folder, named like the views; the region is opaque, or white (the brightest value).

    Attributes:
        missing: views without a mask.
        nonempty: for each other view measured so far, whether its mask shows anything.
    """

    description = "where the given mask, divided by its maximum and resized, is above 0.5"

    def __init__(self, folder: Path, names: Iterable[str]) -> None:
        self._folder = folder
        self._files = {path.relative_to(folder).with_suffix("").as_posix(): path for path in mask_files(folder)}
        self._base_names = Counter(PurePosixPath(name).name for name in map(_stem, names))
        self.missing: list[str] = []
        self.nonempty: list[bool] = []

    def inside(self, frames: FrameViews, index: int, render: Render) -> np.ndarray | None:
        """Pixels [h, w] inside the view's mask; None if there is none, which is recorded in `missing`."""
        path = self.file_of(render.name)
        if path is None:
            self.missing.append(render.name)
            return None
        inside = resized_mask(read_image(path).pixels, render.alpha.shape, path)
        self.nonempty.append(bool(inside.any()))
        return inside

    def file_of(self, name: str) -> Path | None:
        """DIR/<name>.png or DIR/<name>_mask.png; the view's own folders may be left out where the name stays unique."""
        stem = _stem(name)
        base = PurePosixPath(stem).name
        for known in (stem, base) if self._base_names[base] == 1 else (stem,):
            for suffix in ("", "_mask"):
                if known + suffix in self._files:
                    return self._files[known + suffix]
        return None


def mask_files(folder: Path) -> list[Path]:
    """List the images in a folder and below; BadInput if there are none."""
    found = sorted(one for one in folder.rglob("*") if one.suffix.lower() in SUFFIXES and one.is_file())
    if not found:
        raise BadInput(f"--masks {folder}: expected mask images named like the views, found none")
    return found


def masks_digest(folder: Path) -> str:
    """Digest of the names and contents of the images in a folder."""
    return digest_of({one.relative_to(folder).as_posix(): file_sha256(one) for one in mask_files(folder)})


def resized_mask(pixels: np.ndarray, size: tuple[int, int], path: Path) -> np.ndarray:
    """Threshold an image [rows, columns, 1, 3 or 4] as a mask [h, w] of the given size."""
    height, width = size
    if abs(pixels.shape[1] * height / (pixels.shape[0] * width) - 1) > ASPECT_TOLERANCE:
        raise BadInput(
            f"{path} is {pixels.shape[1]}x{pixels.shape[0]} but the view is {width}x{height}: expected a mask of the "
            "same aspect ratio, at any size"
        )
    gray = coverage(pixels)
    if gray.shape != size:
        gray = resize(gray, size, order=1, anti_aliasing=True)
    return gray > REGION_THRESHOLD


def _stem(name: str) -> str:
    path = PurePosixPath(name)
    return path.with_suffix("").as_posix() if path.suffix.lower() in SUFFIXES else path.as_posix()
