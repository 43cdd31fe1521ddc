"""Optical flow between frames of a camera path: from the field's depth and poses, or from files."""

from collections.abc import Iterable
from pathlib import Path, PurePosixPath

import numpy as np

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from schemas.flow_files import FLOW_SUFFIXES, read_flow
from schemas.safe_names import listed
from stages.evaluation.test_views import FrameViews, Render
from stylerf.metrics.optical_flow import field_flow


class FieldFlows:
    """Flow from the depth of the first frame and the poses of both."""

    description = "flow from the field's depth and poses, none where it is transparent"

    def between(self, first: Render, second: Render, _indices: tuple[int, int]) -> np.ndarray:
        """Flow [h, w, 2] in pixels from the first frame to the second, NaN where the first is transparent."""
        return field_flow(first.posed(), second.camera)


class FileFlows:
    """Flow from a folder of `FROM_to_TO.flo` or `.npy`; FROM and TO are numbers of frames as in png/NNNN.png.

    digest: of the flow files; the protocol shows its first digits beside the folder's name.
    """

    def __init__(self, folder: Path, frames: FrameViews, digest: str) -> None:
        self._folder, self._files = folder, {path.stem: path for path in flow_files(folder)}
        self._numbers = [PurePosixPath(view.png).stem for view in frames.frames.views]
        self.description = f"flow from files ({folder.name} {digest[:8]})"

    def require(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Raise BadInput unless there is a file for each of these pairs of frame indices."""
        wanted = [self._name(first, second) for first, second in pairs]
        missing = [name for name in wanted if name not in self._files]
        if missing:
            raise BadInput(
                f"--flow {self._folder}: {len(missing)} of {len(wanted)} flows are missing ({listed(missing, 3)}); "
                f"expected FROM_to_TO.flo or .npy in both directions for every pair, such as {wanted[0]}.flo, numbered "
                "like the images in png/ (--pairs sets the number of pairs)"
            )

    def between(self, first: Render, second: Render, indices: tuple[int, int]) -> np.ndarray:
        """Flow [h, w, 2] in pixels from the first frame to the second, NaN where it is unknown."""
        path = self._files[self._name(*indices)]
        found = read_flow(path)
        height, width = first.alpha.shape
        if found.shape[:2] != (height, width):
            raise BadInput(
                f"flow {path} is {found.shape[1]}x{found.shape[0]} but frame {first.name} is {width}x{height}; compute "
                "the flow at the size of the frames"
            )
        return found

    def _name(self, first: int, second: int) -> str:
        return f"{self._numbers[first]}_to_{self._numbers[second]}"


def flow_files(folder: Path) -> list[Path]:
    """List the flow files in a folder; BadInput if there are none."""
    found = sorted(one for one in folder.glob("*") if one.suffix.lower() in FLOW_SUFFIXES and one.is_file())
    if not found:
        raise BadInput(f"--flow {folder}: expected .flo or .npy files, found none")
    return found


def flows_digest(folder: Path) -> str:
    """Digest of the names and contents of the flow files in a folder."""
    return digest_of({one.name: file_sha256(one) for one in flow_files(folder)})
