"""frames.json: rendered views of a field, in order, with their cameras."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from schemas.atomic_write import write_json
from schemas.errors import ArtifactDamaged
from schemas.json_numbers import FOCAL_LENGTHS, LARGEST_SIDE, matrix, number, whole
from schemas.safe_names import relative_path
from schemas.safe_reading import read_json
from schemas.scene import LensDistortion, Matrix, distortion_of

FRAMES_FILE = "frames.json"


@dataclass(frozen=True)
class FrameCamera:
    """A camera as in scene.json: fx, fy, cx, cy in pixels; world_from_camera 4x4 in scene units.

    distortion: Of the lens that the frame was rendered through, None for a pinhole.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: Matrix
    distortion: LensDistortion | None = None


@dataclass(frozen=True)
class Frame:
    """One rendered view.

    Attributes:
        exr: Path inside the artifact, "" if there is none.
        png: Likewise.
        scene_view: Index of the scene's view with this camera, if any.
        undistort, redistort: ST maps between the view's photo and its undistorted picture; "" without.
    """

    name: str
    exr: str
    png: str
    camera: FrameCamera
    scene_view: int | None = None
    undistort: str = ""
    redistort: str = ""


@dataclass(frozen=True)
class Frames:
    """The contents of frames.json.

    Attributes:
        path: `test`, `train`, `orbit` or another camera path.
        fps: Frames per second, None if the views are not a video.
        masks: EXR channel of each region in view, by the region's name.
    """

    field: str
    path: str
    views: tuple[Frame, ...]
    fps: float | None = None
    masks: dict[str, str] = dataclasses.field(default_factory=dict)  # `field` is an attribute here


def write_frames(folder: Path, frames: Frames) -> None:
    """Write frames.json into `folder`."""
    write_json(Path(folder) / FRAMES_FILE, frames)


def read_frames(folder: Path) -> Frames:
    """Read frames.json in `folder`, ignoring unknown entries; ArtifactDamaged if it is missing or invalid."""
    path = Path(folder) / FRAMES_FILE
    try:
        content = read_json(path, ArtifactDamaged)
        views = tuple(_frame(entry) for entry in content["views"])
        fps = content.get("fps")
        masks = {str(name): str(channel) for name, channel in content.get("masks", {}).items()}
        fps = None if fps is None else number(fps, "fps", 1e-3, 1e4)
        return Frames(str(content["field"]), str(content["path"]), views, fps, masks)
    except FileNotFoundError:
        raise ArtifactDamaged(f"{path} is missing; run `stylerf render` again") from None
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        reason = f"missing {error}" if isinstance(error, KeyError) else str(error)
        raise ArtifactDamaged(f"{path} is damaged ({reason}); run `stylerf render` again") from error


def _frame(entry: dict[str, Any]) -> Frame:
    values, where = entry["camera"], f"the camera of frame {entry['name']}: "
    width, height = (whole(values[key], where + key, 1, LARGEST_SIDE) for key in ("width", "height"))
    fx, fy = (number(values[key], where + key, *FOCAL_LENGTHS) for key in ("fx", "fy"))
    cx, cy = (number(values[key], where + key) for key in ("cx", "cy"))
    pose = matrix(values["world_from_camera"], where + "world_from_camera")
    distortion = values.get("distortion")
    distortion = None if distortion is None else distortion_of(distortion, where + "distortion")
    camera = FrameCamera(width, height, fx, fy, cx, cy, pose, distortion)
    relative_path(entry["name"], "name of a frame")
    files = {"exr": entry["exr"], "png": entry["png"]}
    files |= {key: entry.get(key, "") for key in ("undistort", "redistort")}
    for key, path in files.items():
        if path != "":
            relative_path(path, f"{key} of frame {entry['name']}")
    index = entry.get("scene_view")
    index = None if index is None else whole(index, f"frame {entry['name']}: scene_view", 0, 10**9)
    return Frame(str(entry["name"]), camera=camera, scene_view=index, **files)
