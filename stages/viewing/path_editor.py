"""A camera path being edited, its file in the viewer's folder, and the command that renders it."""

import threading
from dataclasses import replace
from pathlib import Path

from schemas.work_folder import valid_name
from stages.configs.render import RenderConfig
from stages.viewing.cameras import Pose
from stages.viewing.commands import command
from stages.viewing.keyframes import Keyframes
from stages.viewing.library import Library


class PathEditor:
    """Changes keyframes.

    Attributes:
        keyframes: The current ones.
    """

    def __init__(self, library: Library) -> None:
        self._library, self._lock = library, threading.Lock()
        self.keyframes = Keyframes()

    def add(self, pose: Pose) -> None:
        """Add a keyframe at the end."""
        with self._lock:
            self.keyframes = replace(self.keyframes, poses=(*self.keyframes.poses, pose))

    def drop(self) -> None:
        """Remove the last keyframe, if there is one."""
        with self._lock:
            self.keyframes = replace(self.keyframes, poses=self.keyframes.poses[:-1])

    def space(self, between: int) -> None:
        """Set the number of frames from each keyframe to the next."""
        with self._lock:
            self.keyframes = replace(self.keyframes, between=between)

    def file(self, name: str) -> Path:
        """Return the file for a path of this name."""
        return self._library.own / "paths" / f"{valid_name(name)}.json"

    def save(self, name: str) -> Path:
        """Write the path for `stylerf render --path`; return its file."""
        return self.keyframes.save(self.file(name), self._library.scene.cameras[0])

    def command(self, path: Path, field: str) -> list[str]:
        """Return the command that renders a field along a saved path."""
        return command("render", self._library.work.root, RenderConfig(path=str(path)), of=field)
