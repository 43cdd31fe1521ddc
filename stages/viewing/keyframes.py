"""A camera path being edited: keyframes, the spline through them, and its file for `stylerf render --path`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.atomic_write import make_folder, write_json
from schemas.errors import UsageError
from schemas.scene import as_matrix
from stages.viewing.cameras import Pose
from stylerf.geometry.camera_paths import spline_pose
from stylerf.geometry.cameras import Camera

MOST_KEYFRAMES, MOST_FRAMES = 500, 10_000
KEYS = ("width", "height", "fx", "fy", "cx", "cy")


@dataclass(frozen=True)
class Keyframes:
    """Poses to pass through, in order; frames from each to the next."""

    poses: tuple[Pose, ...] = ()
    between: int = 24

    def __post_init__(self) -> None:
        if len(self.poses) > MOST_KEYFRAMES or not 1 <= self.between <= MOST_FRAMES:
            raise UsageError(f"a path takes up to {MOST_KEYFRAMES} keyframes, 1 to {MOST_FRAMES} frames between them")

    @property
    def count(self) -> int:
        """Number of frames."""
        return (len(self.poses) - 1) * self.between + 1 if self.poses else 0

    def pose(self, frame: int) -> np.ndarray:
        """Return world_from_camera [4, 4] of a frame."""
        return spline_pose(np.array([one.matrix for one in self.poses]), frame / max(self.count - 1, 1))

    def fov(self, frame: int) -> float:
        """Return the vertical field of view of a frame, radians, linear between keyframes."""
        at = frame / max(self.count - 1, 1) * (len(self.poses) - 1)
        return float(np.interp(at, np.arange(len(self.poses)), [one.fov for one in self.poses]))

    def cameras(self, like: Camera) -> list[Camera]:
        """Return the cameras of all frames, of the size of `like`."""
        made = []
        for frame in range(self.count):
            focal = like.height / 2 / np.tan(self.fov(frame) / 2)
            middle = like.width / 2, like.height / 2
            made.append(Camera(f"{frame:04d}", like.width, like.height, focal, focal, *middle, self.pose(frame)))
        return made

    def save(self, path: Path, like: Camera) -> Path:
        """Write the camera list for `stylerf render --path`.

        Raises:
            UsageError: there are fewer than two keyframes, or too many frames.
        """
        if len(self.poses) < 2 or self.count > MOST_FRAMES:
            raise UsageError(f"a path needs at least two keyframes and at most {MOST_FRAMES} frames")
        entries = [
            {**{key: getattr(one, key) for key in KEYS}, "world_from_camera": as_matrix(one.world_from_camera)}
            for one in self.cameras(like)
        ]
        make_folder(path.parent)
        write_json(path, {"views": [{"camera": one} for one in entries]})
        return path
