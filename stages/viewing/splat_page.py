"""A scene as one HTML file that opens without a server: its exported splats in viser's own page."""

from pathlib import Path
from typing import Any

import numpy as np

from schemas.atomic_write import make_folder, write_bytes
from schemas.splat_ply import StoredSplats, read_splat_ply
from stages.viewing.guard import Guard
from stylerf.geometry.spherical_harmonics import C0

MOST_SPLATS = 400_000  # splats of a page: 25 bytes each when packed
# A page from a file has no origin that browsers start a worker's blob for; without blobs viser sends it as a data URL.
WORKERS_FROM_DATA = (
    "<script>{const plain=URL.createObjectURL;"
    'URL.createObjectURL=one=>/javascript/.test(one.type)?"":plain.call(URL,one)}</script>'
)
# Scene units from the origin beyond which splats are drawn nearer, within twice that: viser draws nothing beyond 1000
# units, and its half floats cannot store the covariance of a splat larger than 255.
NEAR_ENOUGH = 400.0
OPAQUE_ENOUGH = 0.02  # fainter splats are left out


def gaussians(stored: StoredSplats, most: int = MOST_SPLATS) -> dict[str, np.ndarray]:
    """Return what viser draws: centers [n, 3], covariances [n, 3, 3], rgbs [n, 3] in 0..1, opacities [n, 1].

    Colors are those of the mean direction, since viser draws no spherical harmonics. Of more than `most` splats the
    most visible are kept: opacity times extent. Those of a far background are moved towards the origin and shrunk by
    the same factor, so that they look the same from cameras near it.
    """
    turns = stored.quaternions / np.linalg.norm(stored.quaternions, axis=1, keepdims=True)
    w, x, y, z = turns.T
    rotations = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        1,
    )
    scales = np.exp(stored.log_scales)
    distances = np.maximum(np.linalg.norm(stored.centers, axis=1), NEAR_ENOUGH)
    nearer = (NEAR_ENOUGH * (2 - NEAR_ENOUGH / distances) / distances)[:, None]  # 1 up to there; the order stays
    scaled = rotations * (scales * nearer)[:, None, :]  # R S
    opacities = 1 / (1 + np.exp(-np.clip(stored.logits, -60, 60)))
    seen = opacities * np.sort(scales, 1)[:, 1:].prod(1)
    kept = np.flatnonzero(opacities > OPAQUE_ENOUGH)
    kept = kept[np.argsort(-seen[kept], kind="stable")[:most]]
    return {
        "centers": (stored.centers * nearer)[kept].astype(np.float32),
        "covariances": (scaled @ scaled.transpose(0, 2, 1))[kept].astype(np.float32),
        "rgbs": np.clip(0.5 + C0 * stored.harmonics[kept, 0], 0, 1).astype(np.float32),
        "opacities": opacities[kept, None].astype(np.float32),
    }


def write_page(splats: Path, target: Path, camera: Any, up: np.ndarray) -> Path:
    """Write the splats of a PLY as a page; return its path.

    Args:
        camera: the initial camera of the viewer's own page, which this one opens with.
        up: direction [3] that is up.
    """
    import rich
    import viser

    rich.get_console().quiet = True  # viser prints its address
    parts = gaussians(read_splat_ply(splats))
    with Guard().set_over_servers():
        server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    try:
        server.scene.set_up_direction(tuple(up.tolist()))
        for name in ("position", "look_at", "up", "fov"):
            setattr(server.initial_camera, name, getattr(camera, name))
        server.scene.add_gaussian_splats(
            "/scene", parts["centers"], parts["covariances"], parts["rgbs"], parts["opacities"]
        )
        text = server.get_scene_serializer().as_html(dark_mode=True)
    finally:
        server.stop()
    make_folder(target.parent)
    write_bytes(target, text.replace("<head>", "<head>" + WORKERS_FROM_DATA, 1).encode())
    return target
