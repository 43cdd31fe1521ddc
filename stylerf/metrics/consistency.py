"""Consistency of two views of a field: one is warped to the other using the field's depth and poses.

The surface point of each target pixel, from the target's depth, is projected into the source view, whose color is read
there (backward warping). No optical flow is estimated, so there are no flow errors.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera

PixelDistance = Callable[[np.ndarray, np.ndarray], np.ndarray]  # two [h, w, 3] images -> [h, w]


@dataclass(frozen=True, eq=False)
class PosedView:
    """A rendered view.

    Attributes:
        image: [h, w, 3] sRGB 0..1, composited on the background.
        alpha: [h, w] 0..1.
        z: [h, w] planar depth, scene units; ignored where alpha <= 0.5.
    """

    camera: Camera
    image: np.ndarray
    alpha: np.ndarray
    z: np.ndarray

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        if self.image.shape != (*size, 3) or self.alpha.shape != size or self.z.shape != size:
            raise InvalidValue(
                f"view {self.camera.name}: image {self.image.shape}, alpha {self.alpha.shape} and depth "
                f"{self.z.shape} do not fit its camera of {size[1]}x{size[0]}"
            )


@dataclass(frozen=True)
class PairConsistency:
    """Consistency of a pair of views.

    Attributes:
        rmse: Root mean square difference over visible pixels and RGB; None if no pixel is visible.
        perceptual: Mean of the perceptual distance; None without one.
        share: Visible pixels divided by opaque pixels of the target.
        pixels: Number of visible pixels.
    """

    rmse: float | None
    perceptual: float | None
    share: float
    pixels: int


def warp(
    source: PosedView, target: PosedView, tolerance: float = 0.02, erode: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Warp the source view to the target view.

    A target pixel is visible if its alpha exceeds 0.5, its point projects into the source image, and each of the four
    source pixels around the projection has an alpha above 0.5 and the point's depth, within the relative `tolerance`.
    Requiring all four excludes edges, where rendered depth blends two surfaces.

    Args:
        source: The view from which colors are sampled, bilinearly.
        target: The view to warp to.
        tolerance: Relative depth tolerance.
        erode: Pixels by which the visible area is eroded.

    Returns:
        Colors [h, w, 3], undefined where not visible, and visibility [h, w] bool.
    """
    camera = target.camera
    rows, columns = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    opaque = (target.alpha > 0.5) & np.isfinite(target.z) & (target.z > 0)
    depth = np.where(opaque, target.z, 1.0).reshape(-1).astype(np.float64)  # any finite depth where it is ignored
    points = camera.unproject(np.stack([columns.reshape(-1), rows.reshape(-1)], axis=-1), depth)
    pixels, z_in_source = source.camera.project(points)
    corners, weights, inside = _bilinear(pixels, source.camera.width, source.camera.height)
    visible = opaque.reshape(-1) & inside & (z_in_source > 0)
    solid = ((source.alpha > 0.5) & np.isfinite(source.z)).reshape(-1)
    source_z = np.where(solid, source.z.reshape(-1), np.inf)  # matches no depth
    warped = np.zeros((len(points), 3))
    for corner, weight in zip(corners, weights, strict=True):
        visible &= np.abs(source_z[corner] - z_in_source) <= tolerance * np.abs(z_in_source)
        warped += weight[:, None] * source.image.reshape(-1, 3)[corner]
    shape = (camera.height, camera.width)
    return warped.reshape(*shape, 3), _eroded(visible.reshape(shape), erode)


def pair_consistency(
    source: PosedView,
    target: PosedView,
    perceptual: PixelDistance | None = None,
    tolerance: float = 0.02,
    erode: int = 1,
    within: np.ndarray | None = None,
) -> PairConsistency:
    """Compare the warped source to the target over the visible pixels.

    Args:
        source, target, tolerance, erode: As in warp().
        perceptual: Returns a distance map of two images. Invisible pixels are filled with the target's colors, so they
            only affect receptive fields that cross the border.
        within: [h, w] bool, pixels of the target to compare; None for all.
    """
    warped, visible = warp(source, target, tolerance, erode)
    selected = np.ones_like(visible) if within is None else within
    visible &= selected
    opaque = int(((target.alpha > 0.5) & selected).sum())
    count = int(visible.sum())
    if count == 0:
        return PairConsistency(None, None, 0.0, 0)
    if not np.isfinite((warped - target.image)[visible]).all():
        raise InvalidValue(f"views {source.camera.name} and {target.camera.name} hold colors that are not finite")
    return PairConsistency(*differences(warped, target.image, visible, perceptual), count / opaque, count)


def differences(
    warped: np.ndarray, target: np.ndarray, where: np.ndarray, perceptual: PixelDistance | None
) -> tuple[float, float | None]:
    """Return the RMS difference and the mean perceptual distance of images [h, w, 3] over pixels [h, w] bool."""
    distance = None
    if perceptual is not None:
        patched = np.where(where[..., None], warped, target).astype(np.float32)
        distance = float(perceptual(patched, target.astype(np.float32))[where].mean())
    return float(np.sqrt(((warped - target)[where] ** 2).mean())), distance


def seen_through(view: PosedView, other: PosedView, tolerance: float = 0.05) -> float | None:
    """Return the fraction of a view's surface points that another view sees through, an indication of floaters.

    Only points that project to opaque pixels of the other view count; None for fewer than a hundred. A point is seen
    through if all four depths around its projection exceed its own by more than the relative `tolerance`. Silhouettes,
    where rendered depth blends two surfaces, keep the result slightly above zero.
    """
    camera = view.camera
    rows, columns = np.nonzero((view.alpha > 0.5) & np.isfinite(view.z) & (view.z > 0))
    points = camera.unproject(np.stack([columns + 0.5, rows + 0.5], axis=-1), view.z[rows, columns].astype(np.float64))
    pixels, z_in_other = other.camera.project(points)
    corners, _, inside = _bilinear(pixels, other.camera.width, other.camera.height)
    judged = inside & (z_in_other > 0)
    behind = np.ones(len(points), bool)
    solid, other_z = ((other.alpha > 0.5) & np.isfinite(other.z)).reshape(-1), other.z.reshape(-1)
    for corner in corners:
        judged &= solid[corner]
        behind &= other_z[corner] > z_in_other * (1 + tolerance)
    return float(behind[judged].mean()) if int(judged.sum()) >= 100 else None


def _bilinear(pixels: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return flat indices [4, n] and bilinear weights [4, n] of the pixels around positions [n, 2], and validity [n].

    Positions are valid between the centers of the outermost pixels, so colors are never extrapolated.
    """
    slack = 1e-6  # keeps rounding from moving a pixel on the border outside
    with np.errstate(invalid="ignore"):
        x, y = pixels[:, 0] - 0.5, pixels[:, 1] - 0.5
        inside = (x >= -slack) & (y >= -slack) & (x <= width - 1 + slack) & (y <= height - 1 + slack)
    x, y = np.clip(np.where(inside, x, 0), 0, width - 1), np.clip(np.where(inside, y, 0), 0, height - 1)
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    u, v = x - left, y - top
    corners = np.stack([top * width + left, top * width + right, bottom * width + left, bottom * width + right])
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    return corners, weights, inside


def _eroded(mask: np.ndarray, steps: int) -> np.ndarray:
    """Return a mask eroded `steps` times by 4-neighborhoods; the image border does not erode it."""
    for _ in range(steps):
        padded = np.pad(mask, 1, constant_values=True)
        mask = mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask
