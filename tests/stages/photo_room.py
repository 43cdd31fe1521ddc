"""Procedural photos with exactly known cameras: the corner of a room whose three faces bear fine random texture."""

import numpy as np
import OpenImageIO as oiio

from schemas.images import to_uint8, write_png
from stylerf.geometry.cameras import Camera

SIDE, TEXELS = 5.0, 1000


def look_at(center, target, name="camera", width=320, height=240, focal=300.0) -> Camera:
    """A level camera, z up, at `center` looking at `target`."""
    center, target = np.asarray(center, float), np.asarray(target, float)
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(forward, right), forward, center])
    return Camera(name, width, height, focal, focal, width / 2, height / 2, pose)


def walk(count: int, turn: tuple[float, float] = (0.35, 1.2), **size) -> list[Camera]:
    """Cameras on an arc about the corner between two angles (radians), looking at it from a little above."""
    angles = np.linspace(*turn, count)
    return [
        look_at(
            (3.2 * np.cos(a), 3.2 * np.sin(a), 1.3 + 0.2 * np.sin(5 * a)), (0.3, 0.3, 0.8 + 0.1 * np.cos(3 * a)),
            f"p{index:02d}", **size,
        )
        for index, a in enumerate(angles)
    ]  # fmt: skip


def textures(seed: int, finest: float = 0.15) -> list[np.ndarray]:
    """Three [TEXELS, TEXELS, 3] pictures 0..1 with detail at every scale down to `finest` cycles a texel."""
    random = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(TEXELS), np.fft.rfftfreq(TEXELS), indexing="ij"))
    shape = 1 / np.maximum(frequency, 2 / TEXELS) ** 1.1 * np.exp(-((frequency / finest) ** 2))
    faces = []
    for _ in range(3):
        noise = [np.fft.irfft2(np.fft.rfft2(random.normal(size=(TEXELS, TEXELS))) * shape) for _ in range(3)]
        face = np.stack(noise, axis=-1)
        faces.append(np.clip(0.5 + 0.22 * face / face.std(), 0, 1))
    return faces


def photo(camera, faces: list[np.ndarray]) -> np.ndarray:
    """[height, width, 3] float 0..1: each ray meets the first of the faces x = 0, y = 0, z = 0."""
    origins, directions = (np.asarray(values, np.float64) for values in camera.rays())
    distance = np.where(directions < -1e-9, -origins / np.minimum(directions, -1e-9), np.inf)  # [n, 3]
    axis = distance.argmin(axis=1)
    hit = origins + directions * distance[np.arange(len(axis)), axis][:, None]
    out = np.zeros((len(axis), 3))
    for number in range(3):
        rows = axis == number
        u, v = (hit[rows][:, other] / SIDE % 1 * TEXELS for other in range(3) if other != number)
        out[rows] = _bilinear(faces[number], u, v)
    return out.reshape(camera.height, camera.width, 3)


def _bilinear(face, u, v):
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    a, b = (u - i)[:, None], (v - j)[:, None]
    i, j = i % TEXELS, j % TEXELS
    k, m = (i + 1) % TEXELS, (j + 1) % TEXELS
    return (1 - a) * ((1 - b) * face[i, j] + b * face[i, m]) + a * ((1 - b) * face[k, j] + b * face[k, m])


def write_photos(folder, cameras: list[Camera], seed: int = 0) -> None:
    """folder/NAME.png for each camera."""
    faces = textures(seed)
    for camera in cameras:
        write_png(folder / f"{camera.name}.png", to_uint8(photo(camera, faces)))


def write_tagged(path, stored: np.ndarray, orientation: int) -> None:
    """uint8 pixels as a photo with an EXIF orientation."""
    image = oiio.ImageBuf(np.ascontiguousarray(stored))
    image.orientation = orientation
    assert image.write(str(path))


def aligned(found: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """After the best similarity (Umeyama 1991): angles in degrees and distances as a share of the extent, per pose."""
    p, q = found[:, :3, 3], known[:, :3, 3]
    left, values, right = np.linalg.svd((q - q.mean(0)).T @ (p - p.mean(0)) / len(p))
    sign = np.diag([1, 1, np.sign(np.linalg.det(left @ right))])
    rotation = left @ sign @ right
    scale = (values * np.diag(sign)).sum() / ((p - p.mean(0)) ** 2).sum(1).mean()
    moved = scale * (p - p.mean(0)) @ rotation.T + q.mean(0)
    cosines = [(np.trace((rotation @ a[:3, :3]).T @ b[:3, :3]) - 1) / 2 for a, b in zip(found, known)]
    return np.degrees(np.arccos(np.clip(cosines, -1, 1))), np.linalg.norm(moved - q, axis=1) / np.ptp(q, axis=0).max()
