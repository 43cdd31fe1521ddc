"""Splats as binary glTF with KHR_gaussian_splatting: linear scales, opacities 0..1, quaternions x y z w, y up.

Viewers that do not know the extension show points in their mean colors.
"""

import json
import struct
from pathlib import Path

import numpy as np

from stylerf.geometry.spherical_harmonics import C0
from stylerf.kernels.cpu.splats import Gaussians
from stylerf.srgb import decoded

EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _POINTS, _VERTICES = 5126, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def write_glb(path: Path, splats: Gaussians) -> None:
    """Write one mesh of points, in the display-referred sRGB colors that splats are blended in."""
    opacities = 1 / (1 + np.exp(-splats.logits))
    mean = decoded(np.clip(0.5 + C0 * splats.harmonics[:, 0], 0, 1))
    attributes = {
        "POSITION": splats.centers,
        "COLOR_0": np.concatenate([mean, opacities[:, None]], 1),
        f"{EXTENSION}:ROTATION": splats.quaternions[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": np.exp(splats.log_scales),
        f"{EXTENSION}:OPACITY": opacities[:, None],
    }
    for band in range(splats.harmonics.shape[1]):
        degree = int(band**0.5)
        attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{band - degree * degree}"] = splats.harmonics[:, band]
    accessors, views, blocks, at = [], [], [], 0
    for values in attributes.values():
        block = np.ascontiguousarray(values, "<f4")
        accessor = {
            "bufferView": len(views), "componentType": _FLOAT, "count": len(block), "type": _TYPES[block.shape[1]],
        }  # fmt: skip
        if not accessors:  # required of positions
            accessor |= {"min": block.min(0).tolist(), "max": block.max(0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": at, "byteLength": block.nbytes, "target": _VERTICES})
        blocks.append(block.tobytes())
        at += block.nbytes
    look = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "sortingMethod": "cameraDistance",
            "projection": "perspective"}  # fmt: skip
    primitive = {
        "attributes": {name: k for k, name in enumerate(attributes)}, "mode": _POINTS, "extensions": {EXTENSION: look},
    }  # fmt: skip
    document = {
        "asset": {"version": "2.0", "generator": "stylerf"},
        "extensionsUsed": [EXTENSION],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "splats"}],
        "meshes": [{"name": "splats", "primitives": [primitive]}],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": at}],
    }  # fmt: skip
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    with path.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + at))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", at, b"BIN\0"))  # a multiple of 4: all numbers are floats
        file.writelines(blocks)
