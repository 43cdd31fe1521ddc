"""A small made-up work folder: a textured wall with a ball before it, seen by known cameras, with exact depth."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.exr import FAR_Z, ExrView, write_exr
from schemas.frames import Frame, FrameCamera, Frames, write_frames
from schemas.images import linear_from_srgb, write_png
from schemas.scene import Bounds, Scene, Truth, View, as_matrix, write_scene
from schemas.work_folder import Artifact, Recipe, WorkFolder
from stages import render
from stylerf.geometry.cameras import Camera

NEAR, FAR = 0.5, 20.0


@dataclass(frozen=True, eq=False)
class Seen:
    """Exact picture of the world: rgb [h, w, 3] sRGB straight, alpha and planar z [h, w]."""

    rgb: np.ndarray
    alpha: np.ndarray
    z: np.ndarray


def camera(x: float, name: str, size: tuple[int, int] = (96, 72)) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = x
    return Camera(name, *size, 90.0, 90.0, size[0] / 2, size[1] / 2, pose)


def look(view: Camera, wall: bool = True) -> Seen:
    """A ball of radius 0.6 at (0, 0, 3) and, if asked, a wall at z = 5."""
    origins, directions = (array.astype(np.float64) for array in view.rays())
    center = np.array([0, 0, 3.0])
    b = ((origins - center) * directions).sum(axis=1)
    under = b**2 - ((origins - center) ** 2).sum(axis=1) + 0.36
    t_ball = np.where(under > 0, -b - np.sqrt(np.maximum(under, 0)), np.inf)
    t_wall = (5 - origins[:, 2]) / directions[:, 2] if wall else np.full(len(origins), np.inf)
    t = np.minimum(t_ball, t_wall)
    points = origins + np.where(np.isfinite(t), t, 0)[:, None] * directions
    phase = points @ np.array([[4.0, 2.0, 3.0], [1.0, 5.0, 2.0], [2.0, 1.0, 4.0]])
    rgb = 0.5 + 0.35 * np.sin(phase)
    rgb[t_ball < t_wall] = rgb[t_ball < t_wall] * [1.0, 0.5, 0.4]
    shape = (view.height, view.width)
    alpha = np.isfinite(t).reshape(shape).astype(np.float32)
    z = np.where(alpha > 0, np.where(np.isfinite(t), t, 0).reshape(shape) * view.ray_cosines(), FAR_Z)
    return Seen(rgb.reshape(*shape, 3).astype(np.float32), alpha, z.astype(np.float32))


def camera_entry(view: Camera) -> dict:
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    return {**{key: getattr(view, key) for key in keys}, "world_from_camera": as_matrix(view.world_from_camera)}


def commit(
    work: WorkFolder, kind: str, name: str, stage: str, inputs: dict[str, Artifact], write, **manifest
) -> Artifact:
    revision, config = manifest.pop("revision", 1), manifest.pop("config", {})
    recipe = Recipe(stage, revision, config, [a.reference(role) for role, a in inputs.items()], 0)
    partial = work.begin(kind, name, recipe)
    write(partial.path)
    return partial.commit(**manifest)


def make_scene(
    work: WorkFolder,
    positions: list[float],
    background: str = "none",
    depth: bool = True,
    size: tuple[int, int] = (96, 72),
    layout: str = "",
    split: str = "test",
) -> Artifact:
    """Every view is a test view: evaluation does not look at the others. layout: an object where photos have alpha."""
    layout = layout or ("object" if background == "alpha" else "forward")
    cameras = [camera(x, f"photo_{i:02d}", size) for i, x in enumerate(positions)]

    def write(folder: Path) -> None:
        views = []
        for i, view in enumerate(cameras):
            seen = look(view, wall=background != "alpha")
            pixels = np.concatenate([seen.rgb, seen.alpha[..., None]], -1) if background == "alpha" else seen.rgb
            write_png(folder / f"images/{i:03d}.png", np.round(pixels * 255).astype(np.uint8))
            if depth:
                write_exr(folder / f"truth/depth_{i:03d}.exr", exr_of(view, seen))
            views.append(View(view.name, f"images/{i:03d}.png", split, **camera_entry(view)))
        truth = Truth("truth/depth_000.exr") if depth else Truth()
        bounds = Bounds(((-4, -4, 1), (4, 4, 6)), NEAR, FAR)
        identity = as_matrix(np.eye(4))
        write_scene(folder, Scene(tuple(views), layout, "made up", bounds, background, identity, truth=truth))

    return commit(work, "scene", "wall", "import", {}, write, seconds=1.5, peak_memory_mb=80)


def exr_of(view: Camera, seen: Seen) -> ExrView:
    linear = linear_from_srgb(np.clip(seen.rgb, 0, 1)) * seen.alpha[..., None]
    distance = np.where(seen.alpha > 0, seen.z / view.ray_cosines(), FAR_Z)
    return ExrView(
        linear, seen.alpha, seen.z, distance, view.world_from_camera, (view.fx, view.fy, view.cx, view.cy), NEAR, FAR
    )


def make_frames(
    work: WorkFolder,
    name: str,
    path: str,
    cameras: list[Camera],
    pictures: list[Seen],
    field: Artifact,
    matched: bool = True,
    config: dict | None = None,
    revision: int = render.SPEC.revision,
) -> Artifact:
    """Frames as `render` writes them; `matched`: frame k repeats view k of the scene."""

    def write(folder: Path) -> None:
        frames = []
        for i, (view, seen) in enumerate(zip(cameras, pictures, strict=True)):
            exr, png = f"exr/{i:04d}.exr", f"png/{i:04d}.png"
            write_exr(folder / exr, exr_of(view, seen))
            write_png(folder / png, np.round(np.clip(seen.rgb, 0, 1) * 255).astype(np.uint8))
            frames.append(Frame(view.name, exr, png, FrameCamera(**camera_entry(view)), i if matched else None))
        write_frames(folder, Frames(field.name, path, tuple(frames), None if path == "test" else 24.0))

    reported = {"seconds": 3.0, "peak_memory_mb": 120, "config": config or {}, "revision": revision}
    return commit(work, "frames", name, "render", {"field": field}, write, **reported)


def make_field(work: WorkFolder, name: str, stage: str, inputs: dict[str, Artifact], **manifest) -> Artifact:
    """A stand-in, of bytes of its own, with its style image: evaluation reads nothing else of a field."""
    style = Path(manifest.get("config", {}).get("style", ""))

    def write(folder: Path) -> None:
        if style.is_file():
            shutil.copy(style, folder / f"style{style.suffix}")
        (folder / "field.bin").write_bytes(name.encode().ljust(4096, b"\0"))

    return commit(work, "field", name, stage, inputs, write, **manifest)
