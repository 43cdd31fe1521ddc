"""Where the flow between two frames of a film comes from: the field's own depth and poses, or files."""

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
    """Flow by the depth of the first frame and the poses of both."""

    words = "flow by the field's own depth and poses, none where it is transparent"

    def between(self, first: Render, second: Render, _places: tuple[int, int]) -> np.ndarray:
        """[h, w, 2] from the first frame to the second, nan where it is transparent."""
        return field_flow(first.posed(), second.camera)


class FileFlows:
    """Flow from a folder of `FROM_to_TO.flo` or `.npy`; FROM and TO are frames' numbers as in png/NNNN.png.

    digest: of the flows, whose beginning a protocol tells beside the folder's name.
    """

    def __init__(self, folder: Path, frames: FrameViews, digest: str) -> None:
        self._folder, self._files = folder, {path.stem: path for path in flow_files(folder)}
        self._numbers = [PurePosixPath(view.png).stem for view in frames.frames.views]
        self.words = f"flow from files ({folder.name} {digest[:8]})"

    def require(self, pairs: Iterable[tuple[int, int]]) -> None:
        """BadInput unless there is a file for each of these pairs, first and second frame by place."""
        wanted = [self._name(first, second) for first, second in pairs]
        missing = [name for name in wanted if name not in self._files]
        if missing:
            raise BadInput(
                f"--flow {self._folder}: {len(missing)} of {len(wanted)} flows are missing ({listed(missing, 3)}); "
                f"expected FROM_to_TO.flo or .npy for both directions of every pair, such as {wanted[0]}.flo, "
                "numbered as the frames' pictures in png/ are (--pairs says how many pairs)"
            )

    def between(self, first: Render, second: Render, places: tuple[int, int]) -> np.ndarray:
        """[h, w, 2] from the first frame to the second, nan where it is unknown."""
        path = self._files[self._name(*places)]
        found = read_flow(path)
        height, width = first.alpha.shape
        if found.shape[:2] != (height, width):
            raise BadInput(
                f"flow {path} is {found.shape[1]}x{found.shape[0]} where frame {first.name} is {width}x{height}; a "
                "flow cannot be resized without scaling it: compute it at the frames' size"
            )
        return found

    def _name(self, first: int, second: int) -> str:
        return f"{self._numbers[first]}_to_{self._numbers[second]}"


def flow_files(folder: Path) -> list[Path]:
    """The flow files in a folder; BadInput where there is none."""
    found = sorted(one for one in folder.glob("*") if one.suffix.lower() in FLOW_SUFFIXES and one.is_file())
    if not found:
        raise BadInput(f"--flow {folder}: expected a folder of .flo or .npy files, found none")
    return found


def flows_digest(folder: Path) -> str:
    """Over the names and contents of the flows in a folder."""
    return digest_of({one.name: file_sha256(one) for one in flow_files(folder)})
