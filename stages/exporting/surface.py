"""The surface of the exported field with its colors, for meshes and shots."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from schemas.errors import BadInput
from schemas.images import linear_from_srgb
from stages.artifacts.scene import spread
from stages.artifacts.world_axes import applied
from stages.exporting.job import ExportedFile, ExportJob
from stages.exporting.libraries import needed
from stylerf.errors import InvalidValue
from stylerf.surfaces.field_surface import BEHIND, cell_size, field_surface, grid_size, seen_part, within_reach
from stylerf.surfaces.mesh import Mesh, without_small_pieces
from stylerf.surfaces.vertex_colors import vertex_colors
from stylerf.surfaces.visibility import DepthView

VIEWS = 48  # training views, at most, that decide what is seen and give the colors
SMALL_PIECE = 1e-3  # of the area of the largest piece


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh in scene units with unit normals [n, 3] and colors [n, 3], sRGB 0..1; level: opacity of a cell on it."""

    mesh: Mesh
    normals: np.ndarray
    colors: np.ndarray
    level: float

    def placed(self, to: ExportedFile) -> "Surface":
        """Return the surface in the coordinates of a file."""
        turn = to.file_from_scene[:3, :3] / np.cbrt(np.linalg.det(to.file_from_scene[:3, :3]))
        mesh = Mesh(applied(to.file_from_scene, self.mesh.vertices), self.mesh.faces)
        return Surface(mesh, self.normals @ turn.T, self.colors, self.level)

    @property
    def linear_colors(self) -> np.ndarray:
        """The colors in linear Rec.709, as glTF and USD have them."""
        return linear_from_srgb(self.colors)


def surface_of(job: ExportJob) -> Surface:
    """Return what the training cameras see of the field; BadInput if they see nothing."""
    config, field, progress, threads = job.config, job.field, job.context.progress, job.context.threads
    if config.faces:
        _simplifier(config.faces)  # before anything is computed
    train = job.scene.splits["train"]
    cameras = [job.scene.cameras[view] for view in spread(train, min(VIEWS, len(train)))]
    tolerance = BEHIND * cell_size(field.space, config.resolution)
    progress.start("surface", int(grid_size(field.space, config.resolution)[0]), "plane")
    try:
        whole, level = field_surface(field, cameras, config.resolution, threads, progress.update)
    except InvalidValue as error:
        raise BadInput(f"field {job.inputs['field'].name}: {error}") from error
    progress.finish()
    progress.start("depth of views", len(cameras), "view")
    views = []
    for camera in cameras:
        views.append(DepthView.of(field, camera, threads))
        progress.update(len(views))
    progress.finish()
    mesh = seen_part(within_reach(whole, field.space, config.reach), views, field.space, tolerance)
    mesh = mesh if config.keep_pieces else without_small_pieces(mesh, SMALL_PIECE)
    if not len(mesh.faces):
        raise BadInput(
            f"field {job.inputs['field'].name}: the training views see no surface"
            + ("" if field.space.kind == "box" else f" within --reach {config.reach:g}")
        )
    mesh = decimated(mesh, config.faces)
    job.check_precision(mesh.vertices[mesh.faces[:, 0]], np.sqrt(2 * mesh.areas()))
    normals = mesh.normals()
    progress.say(f"coloring {len(mesh.vertices):,} vertices of {len(mesh.faces):,} triangles")
    colors = vertex_colors(field, mesh.vertices, normals, views, tolerance, threads)
    return Surface(mesh, normals, colors, level)


def decimated(mesh: Mesh, faces: int) -> Mesh:
    """Return the mesh with at most `faces` faces (0: all), by quadric edge collapse (Garland and Heckbert 1997)."""
    if not 0 < faces < len(mesh.faces):
        return mesh
    library = _simplifier(faces)
    # Centered and scaled, because it computes in float32, whose precision large coordinates would exceed.
    middle = mesh.vertices.mean(0)
    size = max(float(np.abs(mesh.vertices - middle).max()), 1e-30)
    vertices, triangles = library.simplify(
        np.ascontiguousarray((mesh.vertices - middle) / size, np.float32),
        np.ascontiguousarray(mesh.faces, np.int32),
        target_count=faces,
    )
    made = Mesh(vertices.astype(np.float64) * size + middle, triangles.astype(np.int64))
    return made.with_faces(made.areas() > 0)


def _simplifier(faces: int) -> Any:
    return needed("fast_simplification", f"a mesh of at most {faces:,} triangles (--faces 0: of all)")
