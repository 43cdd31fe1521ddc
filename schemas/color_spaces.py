"""Linear color spaces of EXR files, and the matrices between them."""

from dataclasses import dataclass

import numpy as np

# Bradford's cone responses of CIE XYZ (Lam 1985), as ACES and OpenColorIO use them.
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


@dataclass(frozen=True)
class ColorSpace:
    """A linear RGB space.

    Attributes:
        interop_id: Its name in the attribute colorInteropID (ASWF Color Interop Forum).
        chromaticities: CIE x, y of red, green, blue and white: 8 numbers.
    """

    interop_id: str
    chromaticities: tuple[float, ...]


REC709 = ColorSpace("lin_rec709_scene", (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290))
# Academy S-2014-004: primaries AP1, the white point near D60.
ACESCG = ColorSpace("lin_ap1_scene", (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767))
COLOR_SPACES = {"lin_rec709": REC709, "acescg": ACESCG}  # by the names of `render --colorspace`


def matrix_between(source: ColorSpace, target: ColorSpace) -> np.ndarray:
    """Return the matrix [3, 3] from linear `source` colors (columns) to `target`; white stays white.

    The white points are adapted by von Kries' scaling of Bradford's cone responses.
    """
    if source == target:
        return np.eye(3)
    whites = [_BRADFORD @ _xyz(space.chromaticities[6:]) for space in (source, target)]
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(whites[1] / whites[0]) @ _BRADFORD
    matrix: np.ndarray = np.linalg.inv(_xyz_from_rgb(target)) @ adapted @ _xyz_from_rgb(source)
    return matrix


def _xyz(xy: tuple[float, ...]) -> np.ndarray:
    x, y = xy
    return np.array([x / y, 1.0, (1 - x - y) / y])


def _xyz_from_rgb(space: ColorSpace) -> np.ndarray:
    """Columns: the primaries, scaled so that they add up to white of Y = 1 (SMPTE RP 177)."""
    xy = space.chromaticities
    primaries = np.stack([_xyz(xy[0:2]), _xyz(xy[2:4]), _xyz(xy[4:6])], axis=1)
    scaled: np.ndarray = primaries * np.linalg.solve(primaries, _xyz(xy[6:]))
    return scaled
