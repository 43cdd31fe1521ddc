"""Real spherical harmonics up to degree 2, with the order and signs customary for radiance fields."""

import numpy as np

BANDS = {0: 1, 1: 4, 2: 9}
C0 = 0.28209479177387814
_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)


def harmonics(directions: np.ndarray, degree: int) -> np.ndarray:
    """Return the basis at unit vectors [n, 3], [n, (degree + 1)^2] float32."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    out = np.empty((len(directions), BANDS[degree]), np.float32)
    out[:, 0] = C0
    if degree > 0:
        out[:, 1], out[:, 2], out[:, 3] = -_C1 * y, _C1 * z, -_C1 * x
    if degree > 1:
        out[:, 4], out[:, 5] = _C2[0] * x * y, -_C2[0] * y * z
        out[:, 6] = _C2[1] * (3 * z * z - 1)
        out[:, 7], out[:, 8] = -_C2[0] * x * z, _C2[2] * (x * x - y * y)
    return out
