"""The surface of a field as GLB, OBJ with MTL, or PLY, with vertex colors.

GLB and OBJ have y up, as glTF prescribes and importers of OBJ expect; PLY keeps the axes of the units, so that it
aligns with sparse points and splats.
"""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np

from schemas.atomic_write import write_bytes
from schemas.images import to_uint8
from stages.exporting.job import ExportedFile, ExportJob
from stages.exporting.libraries import needed
from stages.exporting.surface import Surface, surface_of

_UP = {"glb": "y", "obj": "y", "ply": ""}
_COLORS = {"glb": "linear Rec.709", "obj": "sRGB", "ply": "sRGB"}
MATERIAL = "surface"
_FLOAT, _UINT = 5126, 5125  # of glTF's component types
_VERTICES, _INDICES = 34962, 34963  # targets of its buffer views


def write(job: ExportJob) -> tuple[list[ExportedFile], dict]:
    """Write the mesh in every chosen format; return the files and the figures."""
    surface = surface_of(job)
    files = []
    for name in job.config.chosen:
        to = job.placed(f"mesh.{name}", _UP[name], vertex_colors=_COLORS[name])
        WRITERS[name](job.folder / to.path, surface.placed(to))
        files.append(to)
    mesh = surface.mesh
    return files, {"vertices": len(mesh.vertices), "faces": len(mesh.faces), "opacity_level": surface.level}


def write_glb(path: Path, surface: Surface) -> None:
    """Write glTF 2.0 with normals and linear vertex colors.

    The material is unlit: the colors hold the light of the photos.
    """
    gltf = needed("pygltflib", "--format glb")
    position = np.ascontiguousarray(surface.mesh.vertices, np.float32)
    arrays = [
        position,
        np.ascontiguousarray(surface.normals, np.float32),
        # Floats: 8 bits of linear light would band in the dark.
        np.ascontiguousarray(np.clip(surface.linear_colors, 0, 1), np.float32),
        np.ascontiguousarray(surface.mesh.faces.ravel(), np.uint32),
    ]
    blob, views, accessors = b"", [], []
    for index, array in enumerate(arrays):
        faces = index == len(arrays) - 1
        views.append(gltf.BufferView(
            buffer=0, byteOffset=len(blob), byteLength=array.nbytes, target=_INDICES if faces else _VERTICES
        ))  # fmt: skip
        accessors.append(gltf.Accessor(
            bufferView=index, componentType=_UINT if faces else _FLOAT, count=len(array),
            type="SCALAR" if faces else "VEC3",
            min=position.min(0).tolist() if index == 0 else None, max=position.max(0).tolist() if index == 0 else None,
        ))  # fmt: skip
        blob += array.tobytes()
    primitive = gltf.Primitive(
        attributes=gltf.Attributes(POSITION=0, NORMAL=1, COLOR_0=2), indices=3, material=0, mode=4
    )
    material = gltf.Material(
        name=MATERIAL, doubleSided=True, extensions={"KHR_materials_unlit": {}},
        pbrMetallicRoughness=gltf.PbrMetallicRoughness(metallicFactor=0.0, roughnessFactor=1.0),
    )  # fmt: skip
    whole = gltf.GLTF2(
        asset=gltf.Asset(version="2.0", generator="stylerf"), scene=0, scenes=[gltf.Scene(nodes=[0])],
        nodes=[gltf.Node(mesh=0, name="mesh")], meshes=[gltf.Mesh(primitives=[primitive], name="mesh")],
        materials=[material], extensionsUsed=["KHR_materials_unlit"], bufferViews=views, accessors=accessors,
        buffers=[gltf.Buffer(byteLength=len(blob))],
    )  # fmt: skip
    whole.set_binary_blob(blob)
    write_bytes(path, b"".join(whole.save_to_bytes()))


def write_obj(path: Path, surface: Surface) -> None:
    """Write OBJ with sRGB colors after the coordinates (v x y z r g b, as MeshLab and Blender read) and an MTL."""
    material = path.with_suffix(".mtl")
    write_bytes(material, f"newmtl {MATERIAL}\nKd 1 1 1\nKs 0 0 0\nillum 1\n".encode())
    text = io.StringIO()
    text.write(f"mtllib {material.name}\no mesh\n")
    np.savetxt(text, np.concatenate([surface.mesh.vertices, surface.colors], 1), "v %.9g %.9g %.9g %.4f %.4f %.4f")
    np.savetxt(text, surface.normals, "vn %.4f %.4f %.4f")
    text.write(f"usemtl {MATERIAL}\n")
    corners = np.repeat(surface.mesh.faces + 1, 2, axis=1)  # vertex and normal have the same index
    np.savetxt(text, corners, "f %d//%d %d//%d %d//%d")
    write_bytes(path, text.getvalue().encode())


def write_ply(path: Path, surface: Surface) -> None:
    """Write binary little-endian PLY with normals and 8-bit sRGB vertex colors."""
    names = ("x", "y", "z", "nx", "ny", "nz")
    channels = ("red", "green", "blue")
    layout = [(name, "<f4") for name in names] + [(name, "u1") for name in channels]
    vertices = np.empty(len(surface.mesh.vertices), layout)
    for name, column in zip(names, [*surface.mesh.vertices.T, *surface.normals.T], strict=True):
        vertices[name] = column
    for name, column in zip(channels, to_uint8(surface.colors).T, strict=True):
        vertices[name] = column
    faces = np.empty(len(surface.mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, surface.mesh.faces
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {name}" for name in names]
    header += [f"property uchar {name}" for name in channels]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    write_bytes(path, "\n".join(header).encode() + vertices.tobytes() + faces.tobytes())


WRITERS: dict[str, Callable[[Path, Surface], None]] = {"glb": write_glb, "obj": write_obj, "ply": write_ply}
