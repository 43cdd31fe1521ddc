"""Detects wrong cameras of an object by its silhouettes (decision 0046).

The cutout of every photo shows the whole object, so each of its points projects into the silhouette of every camera
that has it in view, occluded or not. For a wrong camera many of them project outside.
"""

from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter

from schemas.images import read_image
from stages.readers.background import Background, evidence_of
from stages.sfm.photo_copies import KEPT, MASKS, Copy

# A point is outside if it is further from the silhouette than this share of the longest side: 4 pixels of 400.
NEAR = 0.01
# A camera is refuted with more than this share of the points outside. Correct ones of lego had at most 0.02 (one off by
# 5 degrees 0.04), single wrong ones 0.16 and more, those of a folded lego 0.10 and more.
OUTSIDE = 0.1
MOST_POINTS = 5000
REASON = "its silhouette contradicts the pose that structure from motion found"


def of_object(folder: Path, copies: list[Copy]) -> dict[str, np.ndarray]:
    """Return silhouettes by name of the copy, [h, w] bool; none if the photos' masks do not cut out an object, or are
    all the same mask, which belongs to the lens."""
    background, found = Background("auto"), {}
    if not any(copy.cut_out for copy in copies):
        return {}
    for copy in copies:
        width, height = copy.size
        kept = np.ones((height, width), np.float32)
        if copy.cut_out:
            kept = read_image(folder / MASKS / f"{copy.file}.png").pixels.reshape(height, width, -1)[..., 0]
        found[copy.file] = kept >= KEPT
        background.seen(evidence_of(np.dstack([np.zeros((height, width, 3), np.float32), kept])))
    background.decide()
    return found if background.cuts_out and not background.one_mask() else {}


def outside(model, silhouettes: dict[str, np.ndarray]) -> dict[str, float]:
    """Return, by name of each registered photo with a silhouette, the share of its visible points that are outside."""
    points = [model.points3D[number].xyz for number in sorted(model.points3D)]
    xyz = np.array(points[:: max(1, len(points) // MOST_POINTS)]).reshape(-1, 3)
    found = {}
    for number in model.reg_image_ids():
        image = model.images[number]
        if image.name not in silhouettes:
            continue
        inside = silhouettes[image.name]
        height, width = inside.shape
        inside = maximum_filter(inside, 2 * round(NEAR * max(width, height)) + 1)
        camera_from_world = np.asarray(image.cam_from_world().matrix())
        local = xyz @ camera_from_world[:, :3].T + camera_from_world[:, 3]
        x, y = np.floor(model.cameras[image.camera_id].img_from_cam(local[local[:, 2] > 0])).astype(np.int64).T
        seen = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        found[image.name] = 1 - float(inside[y[seen], x[seen]].mean()) if seen.any() else 0.0
    return found


def refuted(model, silhouettes: dict[str, np.ndarray]) -> list[str]:
    """Return the names of the copies whose cameras their silhouettes refute."""
    return sorted(name for name, share in outside(model, silhouettes).items() if share > OUTSIDE)


def without(model, names: list[str]) -> None:
    """Remove the cameras from the model, and points that no two others see."""
    for number in list(model.reg_image_ids()):
        if model.images[number].name in names:
            model.deregister_frame(model.images[number].frame_id)
