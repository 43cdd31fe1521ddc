"""The camera of a USD file for `render --path`, one view per time code."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import BadInput, OutOfResources
from schemas.safe_names import printable
from schemas.safe_reading import opened
from stages.artifacts.placed_cameras import CameraFile, check_count, in_scene
from stages.artifacts.scene import SceneData
from stylerf.errors import InvalidValue
from stylerf.geometry.camera_conventions import from_opengl
from stylerf.geometry.cameras import Camera

SUFFIXES = (".usd", ".usda", ".usdc")
MOST_BYTES = 1 << 30  # shots hold meshes too
MOST_SIDE = 32768  # pixels


def read_usd(path: Path, scene: SceneData, where: str) -> CameraFile:
    """Read a file's only camera, or that of its render settings, at every time code of the file.

    Pictures have the resolution of the render settings; without any, the width of the scene's first view and the
    aperture's aspect ratio. Coordinates are the source's, rotated so that the file's up axis is up.

    Raises:
        OutOfResources: usd-core is not installed.
        BadInput: it is not a USD file, refers to other files, or does not have exactly one camera.
    """
    try:
        from pxr import Sdf, Tf, Usd, UsdGeom
    except ImportError as error:
        raise OutOfResources(
            f"{where} needs usd-core, which cannot be imported ({error}); pip install 'stylerf[export]'"
        ) from error
    with opened(path) as stream:
        if (length := stream.seek(0, 2)) > MOST_BYTES:
            raise BadInput(f"{where} has {length / 1e6:.0f} MB; at most {MOST_BYTES / 1e6:.0f} MB can be read")
    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(path))
        if layer is None:
            raise BadInput(f"{where} is not a USD file")
        # Any other files that it names would be opened too, from anywhere.
        if others := layer.GetCompositionAssetDependencies():
            raise BadInput(f"{where} refers to other files ({printable(others[0])[:60]}); flatten it first: usdcat -f")
        if clips := _value_clips(layer):
            raise BadInput(
                f"{where} reads values from other files (clips of {printable(clips)[:60]}); flatten it first"
            )
        stage = Usd.Stage.Open(layer)
        prim, size = _camera_of(stage, where)
        up = str(UsdGeom.GetStageUpAxis(stage)).lower()
        if up not in ("y", "z"):
            raise BadInput(f"{where} has {printable(up.upper())[:40]} as its up axis, expected Y or Z")
        times = _times(stage, prim, where)
        check_count(len(times), where)
        cameras = [_camera(prim, time, index, size, scene, up, where) for index, time in enumerate(times)]
    except Tf.ErrorException as error:
        reasons = [one.commentary for one in error.args] or [str(error)]
        raise BadInput(f"{where} is not a valid USD file ({printable(' '.join(reasons[0].split()))[:200]})") from error
    unit, remarks = UsdGeom.GetStageMetersPerUnit(stage), []
    if not math.isclose(unit, 1.0):
        remarks.append(
            f"{path.name} is in units of {unit:g} m; its coordinates are assumed to be those of the scene's source"
        )
    return CameraFile(cameras, tuple(remarks))


def _value_clips(layer: Any) -> str:
    """Return the path of a prim with value clips, which open files without being composition arcs; "" without any."""
    from pxr import Sdf

    found: list[str] = []

    def look(path: Any) -> None:
        spec = layer.GetObjectAtPath(path)
        if spec is not None and any(map(spec.HasInfo, ("clips", "clipSets"))):
            found.append(str(path))

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return found[0] if found else ""


def _camera_of(stage: Any, where: str) -> tuple[Any, tuple[int, int, float] | None]:
    """Return the camera, and width, height and pixel aspect of its pictures if they are known."""
    from pxr import Usd, UsdGeom, UsdRender

    found = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
    sizes: dict[str, tuple[int, int, float]] = {}
    for prim in stage.Traverse():
        settings = UsdRender.Settings(prim)
        if settings and (targets := settings.GetCameraRel().GetTargets()):
            resolution = settings.GetResolutionAttr().Get()
            try:
                width, height = map(int, resolution)
            except (TypeError, ValueError, OverflowError) as error:
                shown = printable(str(resolution))[:40]
                raise BadInput(f"{where}: its render settings' resolution is {shown}, expected two numbers") from error
            aspect = _number(settings.GetPixelAspectRatioAttr(), Usd.TimeCode.Default(), f"{where}: render settings")
            if not (1 <= min(width, height) and max(width, height) <= MOST_SIDE and 0.01 < aspect < 100):
                raise BadInput(f"{where}: its render settings ask for {width}x{height} pixels of aspect {aspect:g}")
            sizes.setdefault(str(targets[0]), (width, height, aspect))
    chosen = found if len(found) == 1 else [prim for prim in found if str(prim.GetPath()) in sizes]
    if len(chosen) != 1:
        names = ", ".join(printable(str(prim.GetPath())) for prim in found[:5])
        raise BadInput(
            f"{where} has {len(found)} cameras{f' ({names})' if names else ''}; expected one, or render settings that "
            "name one"
        )
    return chosen[0], sizes.get(str(chosen[0].GetPath()))


def _number(attribute: Any, time: Any, where: str) -> float:
    """Return the value of an attribute at a time; BadInput if it is not a number."""
    value = attribute.Get(time)
    if not isinstance(value, int | float):
        raise BadInput(f"{where}: {attribute.GetName()} is {printable(str(value))[:40]}, expected a number")
    return float(value)


def _times(stage: Any, prim: Any, where: str) -> list[Any]:
    """Return whole time codes from the first to the last sample of the camera or its parents; else the default."""
    from pxr import Usd, UsdGeom

    samples: list[float] = []
    for attribute in prim.GetAttributes():
        samples += attribute.GetTimeSamples()[:1] + attribute.GetTimeSamples()[-1:]
    above = prim.GetParent()
    while above and not above.IsPseudoRoot():
        if xform := UsdGeom.Xformable(above):
            samples += xform.GetTimeSamples()[:1] + xform.GetTimeSamples()[-1:]
        above = above.GetParent()
    if not samples:
        return [Usd.TimeCode.Default()]
    first, last = min(samples), max(samples)
    if stage.HasAuthoredTimeCodeRange():
        first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not (math.isfinite(first) and math.isfinite(last) and last >= first):
        raise BadInput(f"{where}: time codes {first:g} to {last:g} are not a valid range of frames")
    check_count(int(min(last - first, 1e9)) + 1, where)
    return [Usd.TimeCode(first + index) for index in range(int(last - first) + 1)]


def _camera(
    prim: Any, time: Any, index: int, size: tuple[int, int, float] | None, scene: SceneData, up: str, where: str
) -> Camera:
    from pxr import UsdGeom

    camera, name = UsdGeom.Camera(prim), f"{where}: frame {index}"
    if (projection := camera.GetProjectionAttr().Get(time)) != UsdGeom.Tokens.perspective:
        raise BadInput(f"{name}: its projection is {printable(str(projection))[:40]}, expected perspective")
    attributes = (
        camera.GetFocalLengthAttr(), camera.GetHorizontalApertureAttr(), camera.GetVerticalApertureAttr(),
        camera.GetHorizontalApertureOffsetAttr(), camera.GetVerticalApertureOffsetAttr(),
    )  # fmt: skip
    focal, across, upward, right, above = (_number(one, time, name) for one in attributes)
    if not (min(focal, across, upward) > 0 and all(map(math.isfinite, (focal, across, upward, right, above)))):
        raise BadInput(f"{name}: its focal length {focal:g} or apertures {across:g} x {upward:g} are not positive")
    if size is None:
        width = scene.cameras[0].width
        height, aspect = min(max(1, round(width * upward / across)), MOST_SIDE), 1.0
    else:
        width, height, aspect = size
    # The film is widened to the picture's aspect, USD's expandAperture; the lesser differences are of rounding.
    wanted = width * aspect / height
    if across / upward > wanted * (1 + 1e-5):
        upward = across / wanted
    elif across / upward < wanted * (1 - 1e-5):
        across = upward * wanted
    fx, fy = width * focal / across, height * focal / upward
    matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time), float).T  # USD's acts on row vectors
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or not lengths.min() > 0:
        raise BadInput(f"{name}: its transform is singular or not finite")
    matrix[:3, :3] /= lengths  # a scale of its parents does not change what the camera sees
    pose = in_scene(from_opengl(matrix), scene, name, up)
    try:
        return Camera(
            f"{index:04d}", width, height, fx, fy, width / 2 - right * fx / focal, height / 2 + above * fy / focal, pose
        )
    except InvalidValue as error:
        raise BadInput(f"{name}: {error}") from error
