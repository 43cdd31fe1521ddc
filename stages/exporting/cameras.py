"""Cameras of the scene's views, or of a path, as files of other programs.

Lists of cameras (transforms, colmap, camera-path, 3dgs) keep the axes of the units; scenes of 3D programs (chan, usd)
have y up, like exported meshes.
"""

from collections.abc import Callable
from dataclasses import replace

from stages.artifacts.camera_shots import shots_along
from stages.artifacts.world_axes import applied, scale_of
from stages.configs.export import WITH_PHOTOS
from stages.configs.render import OWN_VIEWS
from stages.exporting import camera_lists, usd_stage
from stages.exporting.job import ExportedFile, ExportJob
from stages.exporting.splats import FARTHEST, NEAR
from stylerf.geometry.cameras import Camera
from stylerf.geometry.scene_normalization import moved

PHOTOS = "images"


def write(job: ExportJob) -> tuple[list[ExportedFile], dict]:
    """Write the cameras in every chosen format; return the files and the figures."""
    shots = shots_along(job.scene, job.config.along, job.config.count)
    splits = {camera.name: "" if view is None else job.scene.views[view].split for camera, view in shots}
    files = []
    for name in job.config.chosen:
        files.append(_WRITERS[name](job, [camera for camera, _ in shots], splits))
    photos = job.config.along in OWN_VIEWS and job.config.photos and set(WITH_PHOTOS) & set(job.config.chosen)
    if photos:
        _copy_photos(job, [view for _, view in shots if view is not None])
    return files, {"cameras": len(shots), "photos": len(shots) if photos else 0}


def placed_cameras(cameras: list[Camera], to: ExportedFile) -> list[Camera]:
    """Return the cameras in the coordinates of a file."""
    return [replace(one, world_from_camera=moved(one.world_from_camera, to.file_from_scene)) for one in cameras]


def photo_of(camera: Camera) -> str:
    """Return the name of a camera's photo in the folder of photos."""
    return f"{camera.name}.png"


def _copy_photos(job: ExportJob, views: list[int]) -> None:
    """Copy the scene's pictures, undistorted as pinhole cameras require, under the names of the views."""
    job.context.progress.start("export", len(views), "photo")
    for done, view in enumerate(views, start=1):
        target = job.folder / PHOTOS / photo_of(job.scene.cameras[view])
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(job.scene.artifact.file(job.scene.views[view].image).read_bytes())
        job.context.progress.update(done)
    job.context.progress.finish()


def _transforms(job: ExportJob, cameras: list[Camera], splits: dict[str, str]) -> ExportedFile:
    to = job.placed("transforms.json", camera_axes="OpenGL")
    camera_lists.write_transforms(job.folder / to.path, placed_cameras(cameras, to), splits, f"{PHOTOS}/{{}}.png")
    return to


def _camera_path(job: ExportJob, cameras: list[Camera], splits: dict[str, str]) -> ExportedFile:
    to = job.placed("camera_path.json", camera_axes="OpenGL", fov="vertical, degrees", fps=job.config.fps)
    _say_of_centers(job, cameras, to.path)
    _say_of_sizes(job, cameras, to.path)
    camera_lists.write_camera_path(job.folder / to.path, placed_cameras(cameras, to), job.config.fps)
    return to


def _gaussians(job: ExportJob, cameras: list[Camera], splits: dict[str, str]) -> ExportedFile:
    to = job.placed("cameras.json", camera_axes="OpenCV")
    _say_of_centers(job, cameras, to.path, square=False)
    camera_lists.write_3dgs(job.folder / to.path, placed_cameras(cameras, to))
    return to


def _chan(job: ExportJob, cameras: list[Camera], splits: dict[str, str]) -> ExportedFile:
    to = job.placed(
        "cameras.chan", "y", camera_axes="OpenGL", columns=camera_lists.CHAN_COLUMNS, rotation_order="ZXY",
        fov="vertical, degrees", fps=job.config.fps,
    )  # fmt: skip
    _say_of_centers(job, cameras, to.path)
    _say_of_sizes(job, cameras, to.path)
    camera_lists.write_chan(job.folder / to.path, placed_cameras(cameras, to))
    return to


def _colmap(job: ExportJob, cameras: list[Camera], splits: dict[str, str], text: bool = False) -> ExportedFile:
    to = job.placed("sparse/0" if not text else "sparse_text/0", camera_axes="OpenCV")
    points = job.scene.points
    placed = None if points is None else replace(points, xyz=applied(to.file_from_scene, points.xyz))
    camera_lists.write_colmap(job.folder / to.path, placed_cameras(cameras, to), placed, photo_of, text)
    return to


def _colmap_text(job: ExportJob, cameras: list[Camera], splits: dict[str, str]) -> ExportedFile:
    return _colmap(job, cameras, splits, text=True)


def _usd(job: ExportJob, cameras: list[Camera], splits: dict[str, str]) -> ExportedFile:
    to = job.placed("cameras.usda", "y", camera_axes="OpenGL", fps=job.config.fps)
    bounds, scale = job.scene.bounds, scale_of(to.file_from_scene)
    stage = usd_stage.new_stage(job.folder / to.path, job.config)
    near_far = NEAR * bounds.near * scale, FARTHEST * bounds.far * scale  # for splats of the scene too
    usd_stage.add_camera(stage, placed_cameras(cameras, to), near_far)
    usd_stage.save(stage)
    return to


_Writer = Callable[[ExportJob, list[Camera], dict[str, str]], ExportedFile]
_WRITERS: dict[str, _Writer] = {
    "transforms": _transforms,
    "colmap": _colmap,
    "colmap-text": _colmap_text,
    "camera-path": _camera_path,
    "3dgs": _gaussians,
    "chan": _chan,
    "usd": _usd,
}


def _say_of_sizes(job: ExportJob, cameras: list[Camera], name: str) -> None:
    """Warn of what is lost in a format that has one size for all pictures, or none."""
    if len({(one.width, one.height) for one in cameras}) > 1:
        job.say(f"{name} cannot store different sizes for its views; transforms, colmap and 3dgs can")


def _say_of_centers(job: ExportJob, cameras: list[Camera], name: str, square: bool = True) -> None:
    """Warn of what is lost in a format without a principal point and, if `square`, with a single focal length."""

    def shift(one: Camera) -> float:
        off = max(abs(one.cx - one.width / 2), abs(one.cy - one.height / 2))
        return max(off, abs(one.fx / one.fy - 1) * one.width) if square else off

    if (largest := max(map(shift, cameras))) > 0.01:
        lenses = " and only one focal length" if square else ""
        job.say(
            f"{name} stores no principal point{lenses}: its cameras are off by up to {largest:.2g} pixels; "
            "transforms, colmap and usd store everything"
        )
