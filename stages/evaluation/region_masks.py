"""Where a view shows the region of a local edit: by the regions' cells, or by pictures of masks."""

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
from stages.artifacts.region_masks import regions_among
from stages.evaluation.test_views import FrameViews, Render
from stages.run.progress import Context
from stylerf.editing.edit_grid import march_view
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.rendering.region_alpha import alpha_inside

SHOWN = 0.5  # coverage from which a pixel counts as the region's
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
SIDES_DIFFER = 0.02  # how far the sides' ratio of a mask may be from the view's


class RegionMasks:
    """Masks by regions: alpha_E of the unedited field, the part of each pixel's opacity that lies in their cells."""

    words = (
        "whose alpha_E (the part of the unedited field's opacity that lies in the region) is over 0.5, and all within "
        "{margin} pixels of them,"
    )

    def __init__(self, regions: Mapping[str, Artifact], base: Artifact, context: Context) -> None:
        self._field, _ = load_field(base)
        self._regions = regions_among(regions, self._field.space)
        self._context = context

    def inside(self, frames: FrameViews, index: int, render: Render) -> np.ndarray:
        """[h, w] bool: what view `index` of the unedited field's frames shows of any of the regions."""
        shown = np.zeros(render.alpha.shape, bool)
        missing = []
        for name, region in self._regions.items():
            mask = frames.mask(index, name, region.digest)
            if mask is None or mask.shape != shown.shape:
                missing.append(region.cells)
            else:
                shown |= mask > SHOWN
        return shown | self._marched(render, missing) if missing else shown

    def seen_from(self, render: Render) -> np.ndarray:
        """[h, w] bool: what the unedited field shows of any of the regions where only another field was rendered."""
        return self._marched(render, [region.cells for region in self._regions.values()])

    def _marched(self, render: Render, marked: list[np.ndarray]) -> np.ndarray:
        threads = set_threads(self._context.threads)
        shown = np.zeros(render.alpha.size, bool)
        with compiling_note(self._context.progress.say):
            for part, samples in march_view(self._field, render.camera, threads):
                for cells in marked:
                    shown[part] |= alpha_inside(cells, samples, threads) > SHOWN
        return shown.reshape(render.alpha.shape)


class PictureMasks:
    """Masks by pictures in a folder, named like the views: opaque, or else white (or the brightest), is the region.

    absent: views without one; held: of the others, whether it holds anything.
    """

    words = "where the given mask, over its largest value and resized, is over 0.5"

    def __init__(self, folder: Path, names: Iterable[str]) -> None:
        self._folder = folder
        self._files = {path.relative_to(folder).with_suffix("").as_posix(): path for path in mask_files(folder)}
        self._bare = Counter(PurePosixPath(name).name for name in map(_stem, names))
        self.absent: list[str] = []
        self.held: list[bool] = []

    def inside(self, frames: FrameViews, index: int, render: Render) -> np.ndarray | None:
        """[h, w] bool of the view's own picture; None, and `absent` grows, where there is none."""
        path = self._file(render.name)
        if path is None:
            self.absent.append(render.name)
            return None
        inside = mask_of(read_image(path).pixels, render.alpha.shape, path)
        self.held.append(bool(inside.any()))
        return inside

    def _file(self, name: str) -> Path | None:
        """DIR/<name>.png or DIR/<name>_mask.png; without the name's own folders where no other view is called so."""
        stem = _stem(name)
        bare = PurePosixPath(stem).name
        for wanted in (stem, bare) if self._bare[bare] == 1 else (stem,):
            for end in ("", "_mask"):
                if wanted + end in self._files:
                    return self._files[wanted + end]
        return None


def mask_files(folder: Path) -> list[Path]:
    """The pictures in a folder and below; BadInput where there is none."""
    found = sorted(one for one in folder.rglob("*") if one.suffix.lower() in SUFFIXES and one.is_file())
    if not found:
        raise BadInput(f"--masks {folder}: expected a folder of masks named like the views, found no picture")
    return found


def masks_digest(folder: Path) -> str:
    """Over the names and contents of the pictures in a folder."""
    return digest_of({one.relative_to(folder).as_posix(): file_sha256(one) for one in mask_files(folder)})


def mask_of(pixels: np.ndarray, size: tuple[int, int], path: Path) -> np.ndarray:
    """bool [h, w] of a picture [rows, columns, 1, 3 or 4]: what it covers, resized to `size`, over 0.5."""
    height, width = size
    if abs(pixels.shape[1] * height / (pixels.shape[0] * width) - 1) > SIDES_DIFFER:
        raise BadInput(
            f"{path} is {pixels.shape[1]}x{pixels.shape[0]} where the view is {width}x{height}: a mask has to show the "
            "whole view, at any size"
        )
    gray = coverage(pixels)
    if gray.shape != size:
        gray = resize(gray, size, order=1, anti_aliasing=True)
    return gray > SHOWN


def _stem(name: str) -> str:
    path = PurePosixPath(name)
    return path.with_suffix("").as_posix() if path.suffix.lower() in SUFFIXES else path.as_posix()
