"""Splats as the PLY file of 3D Gaussian splatting (Kerbl et al. 2023), which most viewers and editors read.

One vertex each: x y z, f_dc_* and f_rest_* (coefficients of spherical harmonics, f_rest channel by channel), opacity as
a logit, scale_* as natural logarithms, rot_* as a quaternion w x y z.
"""

from pathlib import Path

import numpy as np

from stylerf.kernels.cpu.splats import Gaussians


def write_ply(path: Path, splats: Gaussians) -> None:
    """Write binary little-endian PLY; normals, which the format has and nothing reads, are 0."""
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
