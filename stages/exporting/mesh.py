"""The surface of a field as GLB, OBJ with MTL, or PLY, with vertex colors.

GLB and OBJ have y up, as glTF prescribes and importers of OBJ expect; PLY keeps the axes of the units, so that it lies
on sparse points and splats.
"""

from stages.exporting import mesh_files
from stages.exporting.job import ExportedFile, ExportJob
from stages.exporting.surface import surface_of

_UP = {"glb": "y", "obj": "y", "ply": ""}
_COLORS = {"glb": "linear Rec.709", "obj": "sRGB", "ply": "sRGB"}


def write(job: ExportJob) -> tuple[list[ExportedFile], dict]:
    """Write the mesh in every chosen format; return the files and the figures."""
    surface = surface_of(job)
    files = []
    for name in job.config.chosen:
        to = job.placed(f"mesh.{name}", _UP[name], vertex_colors=_COLORS[name])
        mesh_files.WRITERS[name](job.folder / to.path, surface.placed(to))
        files.append(to)
    mesh = surface.mesh
    return files, {"vertices": len(mesh.vertices), "faces": len(mesh.faces), "opacity_level": surface.level}
