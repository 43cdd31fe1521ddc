"""Judges whether a reconstruction is plausible, since COLMAP returns any result without complaint."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from stages.sfm.silhouettes import OUTSIDE
from stylerf.environment.colmap import pycolmap
from stylerf.geometry.camera_conventions import from_colmap
from stylerf.geometry.cameras import epipolar_distance, essential, largest_parallax

# Two photos are expected to match if at least SHARE of each one's points project near a point that the other sees:
# within NEAR of the image diagonal and DEPTH of the distance, from directions less than ANGLE degrees apart, at
# distances less than a factor of SCALE apart.
SHARE, NEAR, DEPTH, ANGLE, SCALE = 0.5, 0.05, 0.1, 20.0, 1.5
# Such a pair is silent with fewer matches than this share of the points that the poorer photo of the two sees. Good
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
        """Share of silent pairs among those that must match; 0 if there are none."""
        return len(self.silent) / max(1, self.count)

    @property
    def count(self) -> int:
        """How many pairs must match."""
        return len(self.silent) + len(self.matched)


def expected(model, pairs: list, compared: set[tuple[str, str]]) -> Expected:
    """Return what must match by the model's poses. pairs: see matched_pairs; compared: names of the pairs tried."""
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
        """Return the share of this photo's points among the other's, seen from nearly the same side and distance."""
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


FEWEST_PHOTOS = 3
REFUSED_SHARE, WORRYING_SHARE = 0.5, 0.8
LARGEST_ERROR = 2.0  # pixels of the copies, mean over all points
MIN_PARALLAX, LITTLE_PARALLAX = 1.0, 3.0  # degrees, median over points
REFUSED_AGREEMENT, WORRYING_AGREEMENT = 0.5, 0.8
AGREEING_DISTANCE = 4.0  # pixels, the tolerance that matches were verified with
# Of the pairs that must match 29 % were silent on a folded lego, 1 of 1,167 on eight sound captures (decision 0044).
FOLDED_SHARE, FOLDED_PAIRS = 0.1, 4
# Cameras refuted by their silhouettes are left out, up to this share of them; beyond it the result is rejected.
MOST_REFUTED = 0.2
TURNED_SHARE, TURNED_DISTANCE = 0.9, 2.0  # share of pairs that a turn alone explains, to this median in pixels
# A pair is checked if it has this many matches, and points if they are on this many tracks.
MATCHES_TO_TELL, POINTS_SAMPLED = 30, 2000


@dataclass(frozen=True)
class Quality:
    """Figures of a reconstruction.

    error_px: mean reprojection error in pixels of the copies. parallax_deg: median over points of the widest angle
    between their rays. agreement: share of matched pairs whose own two-view matches fit the poses, of pairs_checked.
    flat_share: share of all matched pairs that a plane or a turn on the spot explains. turned_share: share of
    pairs_checked that a turn alone explains. models: photos of each model. silent_share: of pairs_expected, those of
    photos that must have matches by their poses and have next to none.
    refuted_share: of the placed cameras, those that their silhouettes refute (silhouettes.py).
    """

    photos: int
    registered: int
    points: int
    error_px: float
    track_length: float
    parallax_deg: float
    agreement: float
    pairs_checked: int
    flat_share: float
    turned_share: float
    models: tuple[int, ...]
    refined: bool
    silent_share: float = 0.0
    pairs_expected: int = 0
    refuted_share: float = 0.0

    @property
    def folded(self) -> bool:
        """Whether photos that have nothing in common were placed next to each other."""
        return self.silent_share > FOLDED_SHARE and self.silent_share * self.pairs_expected > FOLDED_PAIRS - 0.5


def quality(models: list, photos: int, pairs: list, keypoints: dict[str, np.ndarray], refined: bool) -> Quality:
    """Return the figures of models[0] (others are only counted); all zero without a model. pairs: see matched_pairs."""
    flat = (pycolmap.TwoViewGeometryConfiguration.PLANAR, pycolmap.TwoViewGeometryConfiguration.PANORAMIC,
            pycolmap.TwoViewGeometryConfiguration.PLANAR_OR_PANORAMIC)  # fmt: skip
    flat_share = float(np.mean([float(geometry.config in map(int, flat)) for *_, geometry in pairs] or [0.0]))
    if not models:
        return Quality(photos, 0, 0, 0.0, 0.0, 0.0, 0.0, 0, flat_share, 0.0, (), False)
    model = models[0]
    agreements = pair_agreements(model, pairs, keypoints)
    turned = [
        _turn_distance(*rays) * focal < TURNED_DISTANCE for *_, rays, focal in _known_pairs(model, pairs, keypoints)
    ]
    return Quality(
        photos=photos,
        registered=model.num_reg_images(),
        points=model.num_points3D(),
        error_px=float(model.compute_mean_reprojection_error()),
        track_length=float(model.compute_mean_track_length()),
        parallax_deg=_median_parallax(model),
        agreement=float(np.mean(agreements)) if agreements else 0.0,
        pairs_checked=len(agreements),
        flat_share=flat_share,
        turned_share=float(np.mean(turned)) if turned else 0.0,
        models=tuple(one.num_reg_images() for one in models),
        refined=refined,
    )


def pair_agreements(model, pairs: list, keypoints: dict[str, np.ndarray]) -> list[bool]:
    """Return for each pair of registered photos with enough matches whether their median distance from the epipolar
    lines of the poses is within tolerance. Poses that contradict the photos fail here regardless of their reprojection
    error."""
    agreeing = []
    for first, second, rays, focal in _known_pairs(model, pairs, keypoints):
        poses = [from_colmap(np.asarray(image.cam_from_world().matrix())) for image in (first, second)]
        distances = focal * epipolar_distance(essential(*poses), *rays)
        agreeing.append(bool(np.median(distances) < AGREEING_DISTANCE))
    return agreeing


def _known_pairs(model, pairs: list, keypoints: dict[str, np.ndarray]):
    """Yield (image, image, rays [n, 2] of the matches in each, larger focal length) of pairs with enough matches."""
    images = {model.images[number].name: model.images[number] for number in model.reg_image_ids()}
    for first, second, geometry in pairs:
        matches = geometry.inlier_matches
        if first not in images or second not in images or len(matches) < MATCHES_TO_TELL:
            continue
        rays, focal = [], 0.0
        for name, column in ((first, 0), (second, 1)):
            camera = model.cameras[images[name].camera_id]
            rays.append(camera.cam_from_img(keypoints[name][matches[:, column]].astype(np.float64)))
            focal = max(focal, float(camera.mean_focal_length()))
        yield images[first], images[second], rays, focal


def _turn_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Median angle, radians, that the best single rotation of rays [n, 2] (at depth 1) leaves to their matches."""
    units = [np.append(rays, np.ones((len(rays), 1)), 1) for rays in (first, second)]
    units = [rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in units]
    left, _, right = np.linalg.svd(units[1].T @ units[0])
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    return float(np.median(np.linalg.norm(units[0] @ turn.T - units[1], axis=1)))


def _median_parallax(model) -> float:
    points = [model.points3D[number] for number in sorted(model.points3D)]
    if not points:
        return 0.0
    centers = {number: model.images[number].projection_center() for number in model.reg_image_ids()}
    sampled = points[:: max(1, len(points) // POINTS_SAMPLED)]
    angles = [
        largest_parallax(point.xyz, np.array([centers[element.image_id] for element in point.track.elements]))
        for point in sampled
    ]
    return float(np.median(angles))


def verdict(found: Quality) -> tuple[str, list[str]]:
    """Return why the reconstruction is rejected (empty if it is not), and warnings."""
    remedy = "photograph in small steps (each thing in three photos or more), move between photos, keep them sharp"
    still = "; an object turning in front of a static background needs masks (masks/NAME.png)"
    if not found.registered:
        cause = "too few matches between any two photos"
        if found.flat_share > 0.5:
            cause = f"{found.flat_share:.0%} of the matched pairs show only turns in place or a flat surface"
        return f"structure from motion found no poses: {cause}; {remedy}{still}", []
    share = found.registered / found.photos
    placed = f"{found.registered} of {found.photos} photos"
    if found.registered < FEWEST_PHOTOS or share < REFUSED_SHARE:
        return f"structure from motion placed only {placed}; {remedy}, or remove photos of other things{still}", []
    if found.error_px > LARGEST_ERROR:
        return (
            f"the reconstruction is off by {found.error_px:.2f} px on average (limit {LARGEST_ERROR:g}); {remedy}",
            [],
        )
    if found.parallax_deg < MIN_PARALLAX:
        return (
            f"the camera hardly moved: points have {found.parallax_deg:.2f} degrees of parallax (at least "
            f"{MIN_PARALLAX:g} is needed); step sideways between photos instead of turning"
        ), []
    if found.turned_share >= TURNED_SHARE:
        return (
            f"the camera turns in place: a rotation alone explains {found.turned_share:.0%} of the matched pairs, so "
            "depth cannot be determined; step sideways between photos instead of turning"
        ), []
    if found.pairs_checked and found.agreement < REFUSED_AGREEMENT:
        return (
            f"the poses contradict the photos: only {found.agreement:.0%} of {found.pairs_checked} matched pairs fit "
            f"them; similar-looking things may have been mistaken for one: {remedy}"
        ), []
    if found.folded:
        return (
            f"the poses fold the scene onto itself: {found.silent_share:.0%} of {found.pairs_expected} pairs of "
            "photos that should show the same thing from the same side have no matches, so similar-looking sides were "
            "mistaken for one: add photos between the sides, in small steps, or import known poses"
        ), []
    if found.refuted_share > MOST_REFUTED:
        return (
            f"the poses contradict the silhouettes: for {found.refuted_share:.0%} of the placed photos more than "
            f"{OUTSIDE:.0%} of the object's points are outside what its mask or transparency keeps; check the masks, "
            f"or {remedy}"
        ), []
    return "", _warnings(found, placed, share)


def _warnings(found: Quality, placed: str, share: float) -> list[str]:
    warnings = []
    if share < WORRYING_SHARE:
        warnings.append(f"warning: only {placed} were placed; parts of the scene may be missing")
    if found.parallax_deg < LITTLE_PARALLAX:
        warnings.append(f"warning: the camera moved little ({found.parallax_deg:.1f} degrees of parallax)")
    if found.agreement < WORRYING_AGREEMENT:
        warnings.append(f"warning: {found.agreement:.0%} of the matched pairs fit the poses; look at the result")
    if len(found.models) > 1:
        sizes = ", ".join(map(str, found.models))
        warnings.append(
            f"warning: the photos fell apart into {len(found.models)} groups ({sizes} photos); the largest is used"
        )
    return warnings
