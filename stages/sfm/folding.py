"""Whether a reconstruction folds an object or a building onto itself: photos placed where others were taken that share
no matches with them (decision 0044).

Where two sides look alike, matches between them are consistent with poses that lay one side over the other, and every
matched pair agrees. What disagrees are pairs without matches: two photos that see points at one place from one side
must have matches in common.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

# Two photos must match where at least this share of the points of each lies, in the other, among points that it sees:
# under NEAR of the picture's diagonal and DEPTH of the distance away, from directions that differ by less than ANGLE
# degrees, at distances that differ by less than SCALE.
SHARE, NEAR, DEPTH, ANGLE, SCALE = 0.5, 0.05, 0.1, 20.0, 1.5
# Such a pair is silent with fewer matches than this share of the points that the poorer photo of the two sees. Sound
# captures had 0.10 to 0.38 in their worst pair, the other side of a folded lego 0.
SILENT_SHARE = 0.05
POINTS_A_PHOTO = 400


@dataclass(frozen=True)
class Expected:
    """Pairs of photos, by name, that were compared and must match where the poses are right: those that do and those
    that do not."""

    matched: tuple[tuple[str, str], ...]
    silent: tuple[tuple[str, str], ...]

    @property
    def silent_share(self) -> float:
        """Of the pairs that must match; 0 where there are none."""
        return len(self.silent) / max(1, self.count)

    @property
    def count(self) -> int:
        """How many pairs must match."""
        return len(self.silent) + len(self.matched)


def expected(model, pairs: list, compared: set[tuple[str, str]]) -> Expected:
    """What must match by the poses of the model. pairs: see matched_pairs; compared: names of the pairs tried."""
    inliers = {frozenset(pair[:2]): len(pair[2].inlier_matches) for pair in pairs}
    seen = {model.images[number].name: _Seen(model, model.images[number]) for number in model.reg_image_ids()}
    matched: list[tuple[str, str]] = []
    silent: list[tuple[str, str]] = []
    for first, second in sorted(compared):
        if first not in seen or second not in seen:
            continue
        one, two = seen[first], seen[second]
        if one.overlap(two) < SHARE or two.overlap(one) < SHARE:
            continue
        fewest = SILENT_SHARE * min(one.count, two.count)
        (silent if inliers.get(frozenset((first, second)), 0) < fewest else matched).append((first, second))
    return Expected(tuple(matched), tuple(silent))


class _Seen:
    """The points that one photo sees."""

    def __init__(self, model, image) -> None:
        elements = [element for element in image.points2D if element.has_point3D()]
        self.count = len(elements)
        kept = elements[:: max(1, len(elements) // POINTS_A_PHOTO)]
        self.xyz = np.array([model.points3D[one.point3D_id].xyz for one in kept]).reshape(-1, 3)
        self.camera = model.cameras[image.camera_id]
        self.camera_from_world = np.asarray(image.cam_from_world().matrix())
        self.center = image.projection_center()
        self.diagonal = np.hypot(self.camera.width, self.camera.height)
        self.depths = self._local(self.xyz)[:, 2]
        self.tree = cKDTree(np.array([one.xy for one in kept]).reshape(-1, 2)) if kept else None

    def _local(self, xyz: np.ndarray) -> np.ndarray:
        return xyz @ self.camera_from_world[:, :3].T + self.camera_from_world[:, 3]

    def overlap(self, other: "_Seen") -> float:
        """Share of this photo's points that lie among the other's, seen from nearly the same side and distance."""
        if self.tree is None or other.tree is None:
            return 0.0
        mine, theirs = self.xyz - self.center, self.xyz - other.center
        far, near = np.linalg.norm(mine, axis=1), np.linalg.norm(theirs, axis=1)
        local = other._local(self.xyz)
        alike = (mine * theirs).sum(1) > np.cos(np.radians(ANGLE)) * far * near
        alike &= (local[:, 2] > 0) & (far < SCALE * near) & (near < SCALE * far)
        if alike.mean() < SHARE:
            return 0.0
        distances, nearest = other.tree.query(other.camera.img_from_cam(local[alike]))
        depths = local[alike, 2]
        among = (distances < NEAR * other.diagonal) & (np.abs(other.depths[nearest] - depths) < DEPTH * depths)
        return float(among.sum() / len(self.xyz))
