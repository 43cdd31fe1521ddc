"""Hard variants of the still life: without texture, with a repeating texture, or made of thin rods and rings.

The shapes and their exact distances are those of the still life; lighting is simple (one lamp and the sky, no shadows),
so a point has the same color from everywhere and only the surface matters.
"""

import numpy as np

from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.procedural import shapes
from stylerf.procedural.solids import TABLE_RADIUS, Solid, arrangement, standing, tipped
from stylerf.procedural.still_life import StillLife, TrueView

VARIANTS = ("textureless", "repeating", "thin")
PLASTER = 0.72  # sRGB level of untextured surfaces
PERIOD = 0.16  # scene units, of the texture, which repeats along all three axes
INKS = ((0.82, 0.74, 0.55), (0.10, 0.22, 0.38))
ROD, WIRE = 0.008, 0.007  # half a rod's side and radius of a ring's wire, scene units: less than a pixel of 200
LAMP = np.array([-0.4807, -0.5608, 0.6743])
NORMAL_STEP = 1e-3
FINER = 2  # rays per pixel and axis


def thin_arrangement(seed: int) -> list[Solid]:
    """Return twelve tilted rods and six rings on the still life's table, placed randomly by the seed."""
    random = np.random.default_rng([seed, 11])
    solids = [arrangement()[0]]
    for number in range(12):
        x, y = random.uniform(-0.5, 0.5, 2) * TABLE_RADIUS
        half, tilt = float(random.uniform(0.3, 0.55)), float(random.uniform(-25, 25))
        lift = half * np.cos(np.radians(tilt))
        pose = standing(x, y, float(random.uniform(0, 360)), lift) @ tipped(tilt)
        low, high = (-ROD, -ROD, -half), (ROD, ROD, half)
        solids.append(Solid(f"rod {number}", shapes.BOX, (*high, 0.3 * ROD), low, high, pose))
    for number in range(6):
        x, y = random.uniform(-0.5, 0.5, 2) * TABLE_RADIUS
        major = float(random.uniform(0.12, 0.3))
        pose = standing(x, y, float(random.uniform(0, 360)), major) @ tipped(90.0)
        reach = major + WIRE
        low, high = (-reach, -reach, -WIRE), (reach, reach, WIRE)
        solids.append(Solid(f"ring {number}", shapes.TORUS, (major, WIRE), low, high, pose))
    return solids


class HardStillLife:
    """A hard variant of the still life. kind: one of VARIANTS. seed: of the thin objects' poses; unused by others."""

    def __init__(self, kind: str, seed: int = 0) -> None:
        if kind not in VARIANTS:
            raise InvalidValue(f"{kind!r} is not a still life; there are {', '.join(VARIANTS)}")
        self.kind = kind
        self.life = StillLife(0, thin_arrangement(seed) if kind == "thin" else None)

    def albedo(self, points: np.ndarray, owners: np.ndarray) -> np.ndarray:
        """Return the sRGB colors [n, 3] of points [n, 3] on the solids with these indices [n]."""
        if self.kind == "textureless":
            return np.full((len(points), 3), PLASTER)
        if self.kind == "repeating":
            odd = np.floor(points / (0.5 * PERIOD) + 0.013).sum(1) % 2 > 0.5
            return np.where(odd[:, None], *INKS)
        turn = 2.4 * owners[:, None] + 2.0 * np.pi * np.array([0, 1, 2]) / 3
        return np.where(owners[:, None] == 0, PLASTER, 0.45 + 0.35 * np.sin(turn))

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return unit normals [n, 3]: the gradient of the distance by central differences."""
        steps = NORMAL_STEP * np.eye(3)
        found = np.stack([self.life.distance(points + s) - self.life.distance(points - s) for s in steps], -1)
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)

    def render(self, camera: Camera) -> TrueView:
        """Render a camera's view; every pixel is the mean of FINER^2 rays."""
        fine = camera.scaled(FINER)
        rows, columns = np.meshgrid(np.arange(fine.height) + 0.5, np.arange(fine.width) + 0.5, indexing="ij")
        pixels = np.stack([columns.ravel(), rows.ravel()], -1)
        directions = fine.unproject(pixels, np.ones(len(pixels))) - fine.center
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        distances, owners = self.life.trace_owners(fine.center[None], directions)
        hit = owners >= 0
        points = fine.center + distances[hit, None] * directions[hit]
        light = 0.55 + 0.45 * np.clip(self.normals(points) @ LAMP, 0, 1)
        colors = np.zeros((len(pixels), 4))
        colors[hit, :3], colors[hit, 3] = self.albedo(points, owners[hit]) * light[:, None], 1.0
        shape = (camera.height, FINER, camera.width, FINER, 4)
        mean = colors.reshape(shape).mean((1, 3))
        alpha = mean[..., 3:]
        rgba = np.concatenate([mean[..., :3] / np.maximum(alpha, 1e-6), alpha], -1).astype(np.float32)
        center = self.life.center_distances(camera)
        return TrueView(rgba, center.astype(np.float32), (center * camera.ray_cosines()).astype(np.float32))
