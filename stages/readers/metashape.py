"""Agisoft Metashape cameras: the XML of File > Export > Export Cameras.

Coordinate frame: the chunk's, not georeferenced. A camera's transform is camera-to-chunk with OpenCV axes. Lens
(Metashape's manual, appendix on camera models): pixels have their centers at (i + 0.5, j + 0.5),

    u = w/2 + cx + x' (f + b1) + y' b2        x' = x N(r^2) + p1 (r^2 + 2 x^2) + 2 p2 x y
    v = h/2 + cy + y' f                       y' = y N(r^2) + p2 (r^2 + 2 y^2) + 2 p1 x y

so that p1 and p2 are OpenCV's, swapped; for a fisheye, (x, y) is the direction of (X, Y) times atan of X/Z, Y/Z.
"""

import math
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from schemas.errors import BadInput
from schemas.safe_names import printable
from schemas.safe_reading import read_bytes
from stages.readers import metashape_file
from stages.readers.checked_values import row
from stages.readers.listed_photos import Folder
from stages.readers.photo_folder import folder_of
from stages.readers.source import SourceCamera, SourceScene, bare, folders_of_photos, images_in, natural, with_masks
from stylerf.geometry.camera_conventions import with_last_row
from stylerf.geometry.distortion import Distortion

MOST_BYTES = 256 << 20  # cameras with their covariances take some 2 kB each
# Pixels by which skew may shift the picture's edge: less is ignored, because our cameras have none.
MOST_SKEW_PX = 0.5
EXPORT = "export the cameras again (File > Export > Export Cameras, Agisoft XML)"


def read(source: Path, images: str) -> SourceScene:
    """Read the aligned cameras of the only chunk; cameras that are not aligned, or disabled, are skipped."""
    path = metashape_file(source)
    if path is None:
        raise BadInput(f"{source} contains no Metashape cameras.xml; {EXPORT}")
    chunk = _chunk(path)
    root = source.parent if source.is_file() else source
    photos = _Photos(folder_of(root, images), f"{path}")
    sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    entries, skipped = _aligned(chunk, sensors)
    frames, apart = _frames(chunk, [one for one, _ in entries])
    cameras = []
    for entry, sensor in entries:
        label, component = entry.get("label", ""), entry.get("component_id")
        if component not in frames:
            skipped.append((label, "in another Metashape component, whose position is unknown"))
            continue
        where = f"{path}: camera {printable(label)}"
        size, intrinsics, lens = _lens(sensor, where)
        name, photo = photos.photo(label)
        pose = with_last_row(_numbers(entry, "transform", 16, where).reshape(4, 4))
        cameras.append(
            SourceCamera(
                name=name, source=label, image=photo, world_from_camera=_moved(pose, frames[component]), size=size,
                intrinsics=intrinsics, distortion=lens,
            )
        )  # fmt: skip
    doubled = [label for label, count in Counter(one.source for one in cameras).items() if count > 1]
    if doubled:
        raise BadInput(
            f"{path}: two cameras are named {printable(doubled[0])!r}; rename one of the photos, and {EXPORT}"
        )
    if not cameras:
        raise BadInput(f"{path} contains no aligned camera; align the photos, and {EXPORT}")
    cameras = with_masks(sorted(cameras, key=lambda one: natural(one.source)), root)
    return SourceScene(
        "cameras of Metashape", cameras, rescalable=bool(images), skipped=tuple(skipped),
        remarks=(*photos.remarks(), *apart), files=(path,),
    )  # fmt: skip


class _Plain(ElementTree.TreeBuilder):
    """Builds elements and rejects a document type, the only place where entities are declared."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise BadInput("it declares a document type, which Metashape never writes")


def _chunk(path: Path) -> ElementTree.Element:
    parser = ElementTree.XMLParser(target=_Plain())
    try:
        parser.feed(read_bytes(path, MOST_BYTES))
        document = parser.close()
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise BadInput(f"{path} is not a Metashape XML file ({error}); {EXPORT}") from error
    except BadInput as error:
        raise BadInput(f"{path}: {error}; {EXPORT}") from error
    chunks = [document] if document.tag == "chunk" else document.findall("chunk")
    if len(chunks) != 1:
        raise BadInput(f"{path} contains {len(chunks)} chunks, expected one; {EXPORT}")
    return chunks[0]


def _aligned(chunk, sensors: dict) -> tuple[list, list[tuple[str, str]]]:
    """Return the usable cameras with their sensors, and the labels of the others with the reason."""
    found, skipped = [], []
    for entry in chunk.iterfind("cameras//camera"):
        sensor = sensors.get(entry.get("sensor_id"))
        if entry.get("enabled", "true").lower() in ("0", "false"):
            skipped.append((entry.get("label", ""), "disabled in Metashape"))
        elif entry.find("transform") is None:
            skipped.append((entry.get("label", ""), "not aligned by Metashape"))
        elif sensor is None or sensor.find("calibration") is None:
            skipped.append((entry.get("label", ""), "its sensor has no calibration"))
        else:
            found.append((entry, sensor))
    return found, skipped


def _frames(chunk, entries: list) -> tuple[dict[str | None, np.ndarray], tuple[str, ...]]:
    """Return for each component the [4, 4] to a common frame of all cameras.

    Cameras of a single component stay in its frame. Several are joined by their transforms; if one has none, only the
    component with most cameras is used.
    """
    counts = Counter(entry.get("component_id") for entry in entries)
    if len(counts) < 2:
        return {component: np.eye(4) for component in counts}, ()
    placed = {one.get("id"): one.find("transform") for one in chunk.iterfind("components/component")}
    if all(placed.get(component) is not None for component in counts):
        return {component: _similarity(placed[component], f"component {component}") for component in counts}, ()
    largest, most = counts.most_common(1)[0]
    remark = f"{len(counts)} components are not aligned with each other: the largest, of {most} photos, is used"
    return {largest: np.eye(4)}, (remark,)


def _similarity(transform, where: str) -> np.ndarray:
    """[4, 4] of a component's rotation, translation and scale."""
    whole = np.eye(4)
    scale = _numbers(transform, "scale", 1, where)[0] if transform.find("scale") is not None else 1.0
    rotation = _numbers(transform, "rotation", 9, where) if transform.find("rotation") is not None else np.eye(3)
    if transform.find("translation") is not None:
        whole[:3, 3] = _numbers(transform, "translation", 3, where)
    if not scale > 0:
        raise BadInput(f"{where}: its scale is {scale:g}, expected more than 0; {EXPORT}")
    whole[:3, :3] = scale * rotation.reshape(3, 3)
    return whole


def _moved(pose: np.ndarray, similarity: np.ndarray) -> np.ndarray:
    """The pose in another frame, its rotation without the scale."""
    moved = similarity @ pose
    moved[:3, :3] /= np.cbrt(np.linalg.det(similarity[:3, :3]))
    return moved


def _lens(sensor, where: str) -> tuple[tuple[int, int], tuple[float, float, float, float], Distortion]:
    """Return size, (fx, fy, cx, cy) and distortion of the adjusted calibration, else of the only one."""
    found = sensor.findall("calibration")
    one = next((item for item in found if item.get("class") == "adjusted"), found[-1])
    kind = one.get("type") or sensor.get("type") or "frame"
    if kind not in ("frame", "fisheye"):
        raise BadInput(f"{where}: its sensor is of type {printable(kind)}, expected frame or fisheye")
    resolution = one.find("resolution") if one.find("resolution") is not None else sensor.find("resolution")
    sides = [resolution.get(name, "") if resolution is not None else "" for name in ("width", "height")]
    if not all(side.isdecimal() and len(side) < 8 and 0 < int(side) < 1_000_000 for side in sides):
        raise BadInput(f"{where}: its sensor has no resolution; {EXPORT}")
    width, height = map(int, sides)
    if one.find("f") is None:
        raise BadInput(
            f"{where}: its calibration has no f; calibrations of PhotoScan before 1.2 are not supported: {EXPORT}"
        )
    names = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
    values = {name: _numbers(one, name, 1, where)[0] if one.find(name) is not None else 0.0 for name in names}
    f, b1, b2 = values["f"], values["b1"], values["b2"]
    if not (f > 0 and f + b1 > 0):
        raise BadInput(f"{where}: its focal length {f:g} (b1 {b1:g}) must be positive; {EXPORT}")
    if abs(b2) * height / 2 / f > MOST_SKEW_PX or values["p3"] or values["p4"]:
        raise BadInput(
            f"{where}: its lens has skew (b2 {b2:g}) or p3, p4, which are not supported; calibrate without them, or "
            "export undistorted photos and their cameras"
        )
    radial = tuple(values[f"k{index}"] for index in range(1, 5))
    intrinsics = (f + b1, f, width / 2 + values["cx"], height / 2 + values["cy"])
    if kind == "frame":
        return (width, height), intrinsics, Distortion("brown", radial, (values["p2"], values["p1"]))
    if values["p1"] or values["p2"]:
        raise BadInput(
            f"{where}: a fisheye with p1, p2 is not supported; calibrate without them, or undistort the photos"
        )
    return (width, height), intrinsics, Distortion("fisheye", radial)


def _numbers(parent, name: str, count: int, where: str) -> np.ndarray:
    """The finite numbers in the text of a child element."""
    text = parent.findtext(name, "").split()
    try:
        values = [float(value) for value in text]
    except ValueError:
        values = [math.nan]
    return row(values, count, f"{where}: {name}")


class _Photos(Folder):
    """Finds photos by label: a name with or without its suffix, of a photo in the folder or anywhere below it."""

    def __init__(self, folder: Path, where: str) -> None:
        super().__init__(folder, None, where)
        self._searched = False
        self._below: dict[str, list[Path]] = {}

    def photo(self, listed: str) -> tuple[str, Path | None]:
        name, found = super().photo(listed)
        if found is None and not self._searched:
            self._searched = True
            for folder in folders_of_photos(self.folder):
                for photo in images_in(folder):
                    self._below.setdefault(photo.stem, []).append(photo)
        places = [] if found else self._below.get(bare(Path(listed)).name, [])
        if len(places) > 1:
            raise BadInput(f"{self.where}: {printable(listed)} could be {places[0]} or {places[1]}; rename one of them")
        if not places:
            return name, found
        return super().photo(str(places[0].relative_to(self.folder)))
