"""Measures of stylization by a reference picture (Ref-NPR): Ref-LPIPS, and Robustness.

Ref-LPIPS: LPIPS between a stylized picture of one view and the renders of the test views nearest to it. Robustness: the
renders of a stylized field serve as references for a second one; PSNR between the two fields' renders.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from skimage.transform import resize

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from stages.artifacts.style_images import read_colors
from stages.configs.views import file_of
from stages.evaluation.region_masks import SIDES_DIFFER
from stages.evaluation.test_views import FrameViews, Render, SceneViews
from stages.evaluation.view_metrics import HIGHEST_PSNR, ViewRow, spoiled_words
from stylerf.metrics.flow_consistency import ImageDistance
from stylerf.metrics.image_quality import psnr

NEAREST = 10  # test views that a reference is compared with


class References:
    """Reference pictures, and which test views each is compared with: the nearest by distance of camera centers."""

    def __init__(self, asked: Sequence[str], scene: SceneViews, frames: FrameViews) -> None:
        places = np.array([view.camera.world_from_camera for view in frames.frames.views])[:, :3, 3]
        self._pictures: list[np.ndarray] = []
        self._near: list[set[int]] = []
        for name, path in map(file_of, asked):
            away = np.linalg.norm(places - scene.center_of(name), axis=1)
            self._near.append(set(np.argsort(away, kind="stable")[:NEAREST].tolist()))
            self._pictures.append(picture_of(path))

    def measure(self, row: ViewRow, index: int, render: Render, distance: ImageDistance | None) -> None:
        """Mean distance of test view `index` from the references it is near to, under `ref_lpips`."""
        near = [self._pictures[i] for i, views in enumerate(self._near) if index in views]
        if not near or distance is None:
            return
        if render.spoiled:
            row.spoil(("ref_lpips",), spoiled_words(render))
        else:
            sized = [sized_as(picture, render) for picture in near]
            row.measure(("ref_lpips",), lambda: float(np.mean([distance(render.image, one) for one in sized])))


def checked(asked: Sequence[str], scene: SceneViews) -> None:
    """BadInput where a reference is of no view of the scene, before frames are rendered to compare it with."""
    for name, _ in map(file_of, asked):
        scene.center_of(name)


def picture_of(path: Path) -> np.ndarray:
    """[h, w, 3] sRGB 0..1; transparent parts are white. BadInput where there is no such file."""
    if not path.is_file():
        raise BadInput(f"--reference: no file {path}")
    return read_colors(path)


def sized_as(picture: np.ndarray, render: Render) -> np.ndarray:
    """The picture at the render's size, averaged down; BadInput where its sides are in another proportion."""
    height, width = render.alpha.shape
    if abs(picture.shape[1] * height / (picture.shape[0] * width) - 1) > SIDES_DIFFER:
        raise BadInput(
            f"a reference is {picture.shape[1]}x{picture.shape[0]} where view {render.name} is {width}x{height}: it "
            "has to show a whole view, at any size"
        )
    if picture.shape[:2] == (height, width):
        return picture.astype(np.float32)
    return np.clip(resize(picture, (height, width, 3), anti_aliasing=True), 0, 1).astype(np.float32)


def references_digest(asked: Sequence[str]) -> str:
    """Over the views and the contents of their pictures; BadInput where one is missing or no picture."""
    pairs = [file_of(text) for text in asked]
    for _, path in pairs:
        picture_of(path)
    return digest_of([[name, file_sha256(path)] for name, path in pairs])


def measure_robustness(row: ViewRow, render: Render, twins: FrameViews) -> None:
    """PSNR of a render against the same view of the field whose renders were the references, under `robustness`."""
    at = twins.showing(render.scene_view)
    if at is None:
        return
    twin = twins.render(at)
    if render.spoiled or twin.spoiled:
        words = spoiled_words(render) if render.spoiled else f"of the other field: {spoiled_words(twin)}"
        row.spoil(("robustness",), words)
    else:
        row.measure(("robustness",), lambda: min(psnr(render.image, twin.image), HIGHEST_PSNR))
