"""Splats as SPZ (Niantic), a tenth of the size: 8 to 24 bits a number, compressed by gzip. y is up."""

from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from stages.exporting.libraries import needed
from stylerf.kernels.cpu.splats import Gaussians

FRACTION_BITS = 12  # of positions of 24 bits, where they fit
LARGEST = 2**23  # of a position's fixed-point number


def write_spz(path: Path, splats: Gaussians) -> int:
    """Write SPZ version 3; returns the bits behind the point of positions, as many of FRACTION_BITS as leave room."""
    gsply = needed("gsply", "--format spz")
    reach = float(np.abs(splats.centers).max(initial=0.0))
    bits = min(FRACTION_BITS, int(np.floor(np.log2((LARGEST - 1) / max(reach, 1e-9)))))
    if bits < 0:
        raise BadInput(
            f"{path.name}: splats reach {reach:.3g} units from the origin, and SPZ ends at {LARGEST:.2g}; export with "
            "--units scene, or to another format"
        )
    higher = splats.harmonics[:, 1:] if splats.harmonics.shape[1] > 1 else None
    data = gsply.GSData.from_arrays(
        splats.centers, splats.log_scales, splats.quaternions, splats.logits, splats.harmonics[:, 0], higher
    )
    gsply.write_spz(path, data, version=3, fractional_bits=bits)
    return bits
