"""USD scenes: y up, cameras with time samples, meshes with vertex colors.

A USD matrix acts on row vectors, so it is the transpose of ours. A USD camera looks along -z, y up, and models film:
focal length, aperture and its offset are in tenths of a scene unit; only their ratios matter here.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from stages.configs.export import ExportConfig
from stages.exporting.camera_lists import opengl_pose
from stages.exporting.libraries import needed
from stylerf.geometry.cameras import Camera

APERTURE = 36.0  # horizontal; the width of 35 mm film
ROOT, CAMERA, MESH, SETTINGS = "/shot", "/shot/camera", "/shot/mesh", "/Render/settings"


def new_stage(path: Path, config: ExportConfig) -> Any:
    """Create a stage whose default prim is ROOT; nothing is written before save()."""
    usd, geometry = needed("pxr.Usd", "USD"), needed("pxr.UsdGeom", "USD")
    path.parent.mkdir(parents=True, exist_ok=True)
    stage = usd.Stage.CreateNew(str(path))
    geometry.SetStageUpAxis(stage, geometry.Tokens.y)
    geometry.SetStageMetersPerUnit(stage, config.meters_per_unit)
    stage.SetTimeCodesPerSecond(config.fps)
    stage.SetFramesPerSecond(config.fps)
    stage.SetDefaultPrim(geometry.Xform.Define(stage, ROOT).GetPrim())
    return stage


def add_camera(stage: Any, cameras: list[Camera], near_far: tuple[float, float]) -> None:
    """Add one camera that moves to each of `cameras` in turn, from time code 1, and its picture's size.

    Args:
        cameras: in the coordinates of the stage.
        near_far: clipping range, units of the stage; programs clip what is outside.
    """
    geometry, gf = needed("pxr.UsdGeom", "USD"), needed("pxr.Gf", "USD")
    prim = geometry.Camera.Define(stage, CAMERA)
    prim.CreateProjectionAttr(geometry.Tokens.perspective)
    prim.CreateClippingRangeAttr(gf.Vec2f(*map(float, near_far)))
    place = prim.AddTransformOp()
    films = [film_of(one) for one in cameras]
    attributes = {
        "focalLength": prim.CreateFocalLengthAttr(),
        "horizontalAperture": prim.CreateHorizontalApertureAttr(),
        "verticalAperture": prim.CreateVerticalApertureAttr(),
        "horizontalApertureOffset": prim.CreateHorizontalApertureOffsetAttr(),
        "verticalApertureOffset": prim.CreateVerticalApertureOffsetAttr(),
    }
    for name, attribute in attributes.items():
        values = [film[name] for film in films]
        if len(set(values)) == 1:
            attribute.Set(values[0])
        else:
            for time, value in enumerate(values, start=1):
                attribute.Set(value, time)
    for time, one in enumerate(cameras, start=1):
        place.Set(gf.Matrix4d(np.ascontiguousarray(opengl_pose(one).T).tolist()), time)
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(len(cameras))
    if len({(one.width, one.height) for one in cameras}) == 1:
        _add_settings(stage, cameras[0])


def farthest(cameras: list[Camera], extent: np.ndarray) -> float:
    """Return the largest depth, in any of the cameras, of a box given by its lower and upper corner [2, 3]."""
    corners = np.stack(np.meshgrid(*extent.T), -1).reshape(-1, 3)
    return max(float(((corners - one.center) @ one.forward).max()) for one in cameras)


def film_of(camera: Camera) -> dict[str, float]:
    """Return focal length, apertures and offsets of a camera, by the names of USD's attributes.

    The aperture is a window at the focal length in front of the pinhole: its sides are width / fx and height / fy of
    it, and its middle is off the axis by the principal point's distance from the picture's middle, right and up.
    """
    focal = APERTURE * camera.fx / camera.width
    return {
        "focalLength": focal,
        "horizontalAperture": APERTURE,
        "verticalAperture": camera.height / camera.fy * focal,
        "horizontalApertureOffset": (camera.width / 2 - camera.cx) / camera.fx * focal,
        "verticalApertureOffset": (camera.cy - camera.height / 2) / camera.fy * focal,
    }


def _add_settings(stage: Any, camera: Camera) -> None:
    render, gf, sdf = needed("pxr.UsdRender", "USD"), needed("pxr.Gf", "USD"), needed("pxr.Sdf", "USD")
    needed("pxr.UsdGeom", "USD").Scope.Define(stage, "/Render")
    settings = render.Settings.Define(stage, SETTINGS)
    settings.CreateResolutionAttr(gf.Vec2i(camera.width, camera.height))
    ratio = camera.fx / camera.fy
    settings.CreatePixelAspectRatioAttr(1.0 if math.isclose(ratio, 1, rel_tol=1e-6) else 1 / ratio)
    settings.CreateCameraRel().SetTargets([sdf.Path(CAMERA)])
    stage.SetMetadata("renderSettingsPrimPath", SETTINGS)


def add_mesh(stage: Any, points: np.ndarray, faces: np.ndarray, normals: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Add a triangle mesh with linear vertex colors; return its extent, lower and upper corner [2, 3].

    Args:
        points, normals: [n, 3], coordinates of the stage.
        faces: [m, 3], counterclockwise from outside.
        colors: [n, 3] in 0..1, linear Rec.709.
    """
    geometry, vt = needed("pxr.UsdGeom", "USD"), needed("pxr.Vt", "USD")
    mesh = geometry.Mesh.Define(stage, MESH)
    mesh.CreatePointsAttr(vt.Vec3fArray.FromNumpy(np.ascontiguousarray(points, np.float32)))
    mesh.CreateFaceVertexIndicesAttr(vt.IntArray.FromNumpy(np.ascontiguousarray(faces.ravel(), np.int32)))
    mesh.CreateFaceVertexCountsAttr(vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateNormalsAttr(vt.Vec3fArray.FromNumpy(np.ascontiguousarray(normals, np.float32)))
    mesh.SetNormalsInterpolation(geometry.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(geometry.Tokens.none)  # else viewers would smooth it as a subdivision surface
    extent = np.array([points.min(0), points.max(0)])
    mesh.CreateExtentAttr(vt.Vec3fArray.FromNumpy(extent.astype(np.float32)))
    color = mesh.CreateDisplayColorPrimvar(geometry.Tokens.vertex)
    color.Set(vt.Vec3fArray.FromNumpy(np.ascontiguousarray(colors, np.float32)))
    return extent


def save(stage: Any) -> None:
    """Write the stage to its file."""
    stage.GetRootLayer().Save()
