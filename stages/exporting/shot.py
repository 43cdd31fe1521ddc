"""A whole shot as one USD file: the animated camera of a path and the field's mesh, y up."""

from stages.artifacts.camera_shots import shots_along
from stages.artifacts.world_axes import scale_of
from stages.exporting import usd_stage
from stages.exporting.cameras import placed_cameras
from stages.exporting.job import ExportedFile, ExportJob
from stages.exporting.surface import surface_of


def write(job: ExportJob) -> tuple[list[ExportedFile], dict]:
    """Write the shot in every chosen format; return the files and the figures."""
    cameras = [camera for camera, _ in shots_along(job.scene, job.config.along, job.config.count)]
    surface, bounds, files = surface_of(job), job.scene.bounds, []
    for name in job.config.chosen:
        to = job.placed(
            f"shot.{name}", "y", camera_axes="OpenGL", fps=job.config.fps, vertex_colors="linear Rec.709",
            meters_per_unit=job.config.meters_per_unit,
        )  # fmt: skip
        placed, scale = surface.placed(to), scale_of(to.file_from_scene)
        stage = usd_stage.new_stage(job.folder / to.path, job.config)
        usd_stage.add_camera(stage, placed_cameras(cameras, to), (bounds.near * scale, bounds.far * scale))
        usd_stage.add_mesh(stage, placed.mesh.vertices, placed.mesh.faces, placed.normals, placed.linear_colors)
        usd_stage.save(stage)
        files.append(to)
    mesh = surface.mesh
    return files, {"cameras": len(cameras), "vertices": len(mesh.vertices), "faces": len(mesh.faces)}
