"""A whole shot as one USD file: the animated camera of a path and the field as a mesh or splats, y up."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from stages.artifacts.camera_shots import shots_along
from stages.artifacts.world_axes import scale_of
from stages.exporting import splat_files, splats, usd_stage
from stages.exporting.cameras import placed_cameras
from stages.exporting.job import ExportedFile, ExportJob
from stages.exporting.surface import surface_of
from stylerf.splats.similarity import moved_gaussians


class _Geometry(NamedTuple):
    """The field in a shot.

    Attributes:
        notes: The meaning of its colors, for export.json.
        add: Adds it to the stage of a file and returns its extent [2, 3].
        beside: Files that are already written next to it.
    """

    notes: dict[str, object]
    add: Callable[[Any, ExportedFile], np.ndarray]
    figures: dict
    beside: list[ExportedFile]


def write(job: ExportJob) -> tuple[list[ExportedFile], dict]:
    """Write the shot in every chosen format; return the files and the figures."""
    cameras = [camera for camera, _ in shots_along(job.scene, job.config.along, job.config.count)]
    geometry = _splats(job) if job.config.geometry == "splats" else _mesh(job)
    bounds, files = job.scene.bounds, geometry.beside
    for name in job.config.chosen:
        to = job.placed(
            f"shot.{name}", "y", camera_axes="OpenGL", fps=job.config.fps,
            meters_per_unit=job.config.meters_per_unit, **geometry.notes,
        )  # fmt: skip
        scale, placed = scale_of(to.file_from_scene), placed_cameras(cameras, to)
        stage = usd_stage.new_stage(job.folder / to.path, job.config)
        far = max(bounds.far * scale, usd_stage.farthest(placed, geometry.add(stage, to)))
        usd_stage.add_camera(stage, placed, (splats.NEAR * bounds.near * scale, far))
        usd_stage.save(stage)
        files.append(to)
    return files, {"cameras": len(cameras), **geometry.figures}


def _mesh(job: ExportJob) -> _Geometry:
    surface = surface_of(job)

    def add(stage: Any, to: ExportedFile) -> np.ndarray:
        placed = surface.placed(to)
        return usd_stage.add_mesh(stage, placed.mesh.vertices, placed.mesh.faces, placed.normals, placed.linear_colors)

    figures = {"vertices": len(surface.mesh.vertices), "faces": len(surface.mesh.faces)}
    return _Geometry({"vertex_colors": "linear Rec.709"}, add, figures, [])


def _splats(job: ExportJob) -> _Geometry:
    splat_files.check_usd()  # before anything is computed
    made, figures = splats.splats_of(job)

    def add(stage: Any, to: ExportedFile) -> np.ndarray:
        return splat_files.add_splats(stage, moved_gaussians(made, to.file_from_scene))

    return _Geometry({"colors": splats.COLORS}, add, figures, [splats.written(job, "ply", made)])
