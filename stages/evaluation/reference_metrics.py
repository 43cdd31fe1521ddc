"""Ref-NPR's metrics of stylization by reference: Ref-LPIPS and Robustness.

Ref-LPIPS: LPIPS between a stylized image of one view and the renders of the nearest test views. Robustness: PSNR
between the renders of a stylized field and those of a second field that took them as references.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from skimage.transform import resize

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from stages.artifacts.style_images import read_colors
from stages.configs.view_syntax import file_of
from stages.evaluation.region_masks import ASPECT_TOLERANCE
from stages.evaluation.test_views import FrameViews, Render, SceneViews
from stages.evaluation.view_metrics import HIGHEST_PSNR, ViewRow, nonfinite_message, skipped_nonfinite
from stylerf.metrics.flow_consistency import ImageDistance
from stylerf.metrics.image_quality import psnr

NEAREST = 10  # test views compared with each reference


class References:
    """Reference images and the test views each is compared with: those with the nearest camera centers."""

    def __init__(self, references: Sequence[str], scene: SceneViews, frames: FrameViews) -> None:
        centers = np.array([view.camera.world_from_camera for view in frames.frames.views])[:, :3, 3]
        self._images: list[np.ndarray] = []
        self._nearest: list[set[int]] = []
        for name, path in map(file_of, references):
            distances = np.linalg.norm(centers - scene.center_of(name), axis=1)
            self._nearest.append(set(np.argsort(distances, kind="stable")[:NEAREST].tolist()))
            self._images.append(read_reference(path))

    def measure(self, row: ViewRow, index: int, render: Render, distance: ImageDistance | None) -> None:
        """Mean distance of test view `index` to the references it is nearest to, under `ref_lpips`."""
        near = [self._images[i] for i, views in enumerate(self._nearest) if index in views]
        if not near or distance is None:
            return
        if render.nonfinite:
            row.skip(("ref_lpips",), nonfinite_message(render))
        else:
            sized = [resized_to(image, render) for image in near]
            row.measure(("ref_lpips",), lambda: float(np.mean([distance(render.image, image) for image in sized])))


def check_references(references: Sequence[str], scene: SceneViews) -> None:
    """Raise BadInput if a reference names no view of the scene."""
    for name, _ in map(file_of, references):
        scene.center_of(name)


def read_reference(path: Path) -> np.ndarray:
    """Read a reference as [h, w, 3] sRGB 0..1, composited on white. BadInput if the file is missing."""
    if not path.is_file():
        raise BadInput(f"--reference: {path} not found")
    return read_colors(path)


def resized_to(image: np.ndarray, render: Render) -> np.ndarray:
    """Resize an image to the size of a render; BadInput if their aspect ratios differ."""
    height, width = render.alpha.shape
    if abs(image.shape[1] * height / (image.shape[0] * width) - 1) > ASPECT_TOLERANCE:
        raise BadInput(
            f"a reference is {image.shape[1]}x{image.shape[0]} but view {render.name} is {width}x{height}: expected "
            "the same aspect ratio, at any size"
        )
    if image.shape[:2] == (height, width):
        return image.astype(np.float32)
    return np.clip(resize(image, (height, width, 3), anti_aliasing=True), 0, 1).astype(np.float32)


def references_digest(references: Sequence[str]) -> str:
    """Return the digest of the views and contents of the references; BadInput if one is missing or not an image."""
    pairs = [file_of(text) for text in references]
    for _, path in pairs:
        read_reference(path)
    return digest_of([[name, file_sha256(path)] for name, path in pairs])


def measure_robustness(row: ViewRow, render: Render, reference_frames: FrameViews) -> None:
    """PSNR against the same view of the field whose renders were the references, under `robustness`."""
    reference = reference_frames.same_view(render)
    if reference is None:
        return
    if not skipped_nonfinite(row, ("robustness",), render, reference, "reference field"):
        row.measure(("robustness",), lambda: min(psnr(render.image, reference.image), HIGHEST_PSNR))
