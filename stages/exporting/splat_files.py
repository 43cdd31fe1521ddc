"""Splats as PLY, SPZ, binary glTF and USD files. y is up in all but PLY."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import BadInput, OutOfResources
from stages.configs.export import ExportConfig
from stages.exporting import usd_stage
from stages.exporting.libraries import needed
from stylerf.geometry.spherical_harmonics import C0
from stylerf.kernels.cpu.splats import Gaussians
from stylerf.srgb import decoded

SPZ_FRACTION_BITS = 12  # of 24-bit positions, where they fit; small splats get more
SPZ_MOST_BITS = 24
SPZ_LARGEST = 2**23  # of a position's fixed-point number
SPZ_LOG_SCALES = -10.0, 255 / 16 - 10  # the smallest and the largest size, natural logarithms
SPZ_STEP = 0.1  # of positions, in sizes of a splat, that bits are given for
GLTF_EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _POINTS, _VERTICES = 5126, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
USD_SPLATS = f"{usd_stage.ROOT}/splats"
USD_REACH = 3.0  # standard deviations that the extent encloses


def write_ply(path: Path, splats: Gaussians) -> None:
    """Write the PLY format of 3D Gaussian splatting (Kerbl et al. 2023), which most viewers and editors read.

    One vertex each: x y z, f_dc_* and f_rest_* (coefficients of spherical harmonics, f_rest channel by channel),
    opacity as a logit, scale_* as natural logarithms, rot_* as a quaternion w x y z. Normals, which the format has and
    nothing reads, are 0.
    """
    n, bands = splats.harmonics.shape[:2]
    rest = splats.harmonics[:, 1:].transpose(0, 2, 1).reshape(n, 3 * (bands - 1))
    columns = {
        **dict(zip(("x", "y", "z"), splats.centers.T, strict=True)),
        **dict.fromkeys(("nx", "ny", "nz"), np.zeros(n, np.float32)),
        **{f"f_dc_{k}": splats.harmonics[:, 0, k] for k in range(3)},
        **{f"f_rest_{k}": rest[:, k] for k in range(rest.shape[1])},
        "opacity": splats.logits,
        **{f"scale_{k}": splats.log_scales[:, k] for k in range(3)},
        **{f"rot_{k}": splats.quaternions[:, k] for k in range(4)},
    }
    table = np.stack(list(columns.values()), 1).astype("<f4")
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header = "\n".join([*lines, *(f"property float {name}" for name in columns), "end_header\n"])
    with path.open("wb") as file:
        file.write(header.encode("ascii"))
        file.write(table.tobytes())


def write_spz(path: Path, splats: Gaussians) -> int:
    """Write SPZ (Niantic) version 3, a tenth of the size of PLY: 8 to 24 bits per number, compressed by gzip.

    Returns the fractional bits of positions: as many as leave room, at most those that splats of this size need.
    """
    gsply = needed("gsply", "--format spz")
    reach = float(np.abs(splats.centers).max(initial=0.0))
    wanted = int(np.ceil(-np.log2(SPZ_STEP * _median_size(splats))))
    room = int(np.floor(np.log2((SPZ_LARGEST - 1) / max(reach, 1e-9))))
    bits = min(max(SPZ_FRACTION_BITS, wanted), room, SPZ_MOST_BITS)
    if bits < 1:
        raise BadInput(
            f"{path.name}: splats reach {reach:.3g} units from the origin, beyond the {SPZ_LARGEST / 2:.2g} that SPZ "
            "can store; export with --units scene, or to another format"
        )
    higher = splats.harmonics[:, 1:] if splats.harmonics.shape[1] > 1 else None
    data = gsply.GSData.from_arrays(
        splats.centers, splats.log_scales, splats.quaternions, splats.logits, splats.harmonics[:, 0], higher
    )
    gsply.write_spz(path, data, version=3, fractional_bits=bits)
    return bits


def lost_in_spz(splats: Gaussians, bits: int) -> str:
    """Describe what SPZ cannot store of the splats; "" if nothing significant.

    Args:
        bits: behind the point of positions.
    """
    low, high = SPZ_LOG_SCALES
    clamped = int(((splats.log_scales < low - 1 / 32) | (splats.log_scales > high + 1 / 32)).any(1).sum())
    words = []
    if clamped:
        words.append(
            f"{clamped:,} of {len(splats.centers):,} splats are smaller than {np.exp(low):.2g} or larger than "
            f"{np.exp(high):.3g} units and were clamped"
        )
    if 2.0**-bits > (size := _median_size(splats)):
        words.append(f"positions are rounded to steps of {2.0**-bits:.2g} units, and splats measure {size:.2g}")
    return "; ".join(words)


def _median_size(splats: Gaussians) -> float:
    """Return the median of the splats' largest standard deviations."""
    return float(np.exp(np.median(splats.log_scales.max(1))))


def write_glb(path: Path, splats: Gaussians) -> None:
    """Write binary glTF with KHR_gaussian_splatting: one mesh of points, in display-referred sRGB, as splats blend.

    Scales are linear, opacities 0..1, quaternions x y z w. Viewers without the extension show points in mean colors.
    """
    opacities = 1 / (1 + np.exp(-splats.logits))
    mean = decoded(np.clip(0.5 + C0 * splats.harmonics[:, 0], 0, 1))
    attributes = {
        "POSITION": splats.centers,
        "COLOR_0": np.concatenate([mean, opacities[:, None]], 1),
        f"{GLTF_EXTENSION}:ROTATION": splats.quaternions[:, [1, 2, 3, 0]],
        f"{GLTF_EXTENSION}:SCALE": np.exp(splats.log_scales),
        f"{GLTF_EXTENSION}:OPACITY": opacities[:, None],
    }
    for band in range(splats.harmonics.shape[1]):
        degree = int(band**0.5)
        attributes[f"{GLTF_EXTENSION}:SH_DEGREE_{degree}_COEF_{band - degree * degree}"] = splats.harmonics[:, band]
    accessors: list[dict] = []
    views: list[dict] = []
    blocks, at = [], 0
    for values in attributes.values():
        block = np.ascontiguousarray(values, "<f4")
        accessor: dict = {
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
        "attributes": {name: k for k, name in enumerate(attributes)}, "mode": _POINTS,
        "extensions": {GLTF_EXTENSION: look},
    }  # fmt: skip
    document = {
        "asset": {"version": "2.0", "generator": "stylerf"},
        "extensionsUsed": [GLTF_EXTENSION],
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


def write_usd(path: Path, splats: Gaussians, config: ExportConfig) -> None:
    """Write a stage with one ParticleField3DGaussianSplat (OpenUSD 26.03): linear scales, opacities 0..1."""
    check_usd()
    stage = usd_stage.new_stage(path, config)
    add_splats(stage, splats)
    usd_stage.save(stage)


def check_usd() -> None:
    """Raise OutOfResources if the installed OpenUSD does not support splats."""
    volumes, usd = needed("pxr.UsdVol", "USD"), needed("pxr.Usd", "USD")
    if not hasattr(volumes, "ParticleField3DGaussianSplat"):
        year, month = usd.GetVersion()[1:]
        raise OutOfResources(
            f"USD splats need OpenUSD 26.03 or later, found {year}.{month:02}; pip install -U usd-core, or choose "
            "another format"
        )


def add_splats(stage: Any, splats: Gaussians) -> np.ndarray:
    """Add a prim of splats, which are in the coordinates of the stage; return its extent, as add_mesh does."""
    volumes, vt = needed("pxr.UsdVol", "USD"), needed("pxr.Vt", "USD")
    prim = volumes.ParticleField3DGaussianSplat.Define(stage, USD_SPLATS)

    def floats(values: np.ndarray, kind: str):
        return getattr(vt, kind).FromNumpy(np.ascontiguousarray(values, np.float32))

    scales = np.exp(splats.log_scales)
    reach = USD_REACH * scales.max(1, keepdims=True)
    bands = splats.harmonics.shape[1]
    prim.CreatePositionsAttr(floats(splats.centers, "Vec3fArray"))
    prim.CreateScalesAttr(floats(scales, "Vec3fArray"))
    # A quaternion's array is read as x y z w.
    prim.CreateOrientationsAttr(floats(splats.quaternions[:, [1, 2, 3, 0]], "QuatfArray"))
    prim.CreateOpacitiesAttr(floats(1 / (1 + np.exp(-splats.logits)), "FloatArray"))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(round(bands**0.5) - 1)
    # Particle by particle, as primvars with that many elements each are.
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(floats(splats.harmonics.reshape(-1, 3), "Vec3fArray"))
    extent = np.stack([(splats.centers - reach).min(0), (splats.centers + reach).max(0)])
    prim.CreateExtentAttr(floats(extent, "Vec3fArray"))
    return extent
