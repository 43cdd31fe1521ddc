"""Distance between the color distributions of two images: sliced Wasserstein (Rabin et al. 2011) in CIELAB.

    d^2 = 3 / K sum_k W(<a, u_k>, <b, u_k>)^2

W is the 2-Wasserstein distance in one dimension: the root mean square difference of quantiles. The u_k are the 16 axes
of a regular icosahedron and dodecahedron; sum u_k u_k^T = K/3, so a shift of all colors by x has a distance of exactly
|x|, in CIE76 units: about 2.3 is just noticeable.

Color matching fits the mean and covariance of a Gaussian (`palette_distance` measures them); this distance also sees
what they miss, for example that a style image has three inks where the render has blends of them.
"""

import numpy as np
from skimage.color import rgb2lab

from stylerf.errors import InvalidValue

QUANTILES = 1024
CHUNK = 1 << 20  # colors to convert at once
GOLDEN = (1 + 5**0.5) / 2


def _axes() -> np.ndarray:
    """Return unit vectors [16, 3]: one per pair of opposite vertices of an icosahedron and a dodecahedron."""
    signs = (-1.0, 1.0)
    icosahedron = [np.roll((0.0, 1.0, s * GOLDEN), turn) for turn in range(3) for s in signs]
    dodecahedron = [np.roll((0.0, 1 / GOLDEN, s * GOLDEN), turn) for turn in range(3) for s in signs]
    cube = [np.array((1.0, s, t)) for s in signs for t in signs]
    vectors = np.array([*icosahedron, *dodecahedron, *cube])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


AXES = _axes()


def distance_of_quantiles(a: np.ndarray, b: np.ndarray) -> float:
    """Return d from the color_quantiles() of both images, which may differ in size.

    At most sqrt(3) times the 2-Wasserstein distance in three dimensions, in CIELAB (D65) units.
    """
    return float(np.sqrt(3 * np.square(a - b).mean()))


def color_quantiles(colors: np.ndarray) -> np.ndarray:
    """Return the quantiles of colors [n, 3], sRGB 0..1, along each axis: [16, QUANTILES], CIELAB.

    Raises:
        InvalidValue: There are no colors, or one is not finite.
    """
    if np.ndim(colors) != 2 or np.shape(colors)[1] != 3 or len(colors) == 0 or not np.isfinite(colors).all():
        raise InvalidValue(f"expected finite colors [n, 3], got an array of shape {np.shape(colors)}")
    # Single precision and one axis at a time: a scan of 24 megapixels then takes 0.5 GB instead of 7.
    lab = np.concatenate([rgb2lab(colors[i : i + CHUNK].astype(np.float64)[None])[0].astype(np.float32)
                          for i in range(0, len(colors), CHUNK)])  # fmt: skip
    places = np.ceil((np.arange(QUANTILES) + 0.5) / QUANTILES * len(lab)).astype(int) - 1
    # The inverse of the empirical distribution.
    return np.stack([np.sort(lab @ axis)[places] for axis in AXES.astype(np.float32)]).astype(np.float64)
