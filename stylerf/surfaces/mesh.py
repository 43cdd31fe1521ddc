"""Triangle meshes: their pieces, normals, and parts."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh. vertices: [n, 3] float64. faces: [m, 3] int64, counterclockwise seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray

    def with_faces(self, kept: np.ndarray) -> "Mesh":
        """Return the mesh of the faces marked in `kept` [m] bool, without unused vertices."""
        faces = self.faces[kept]
        used = np.zeros(len(self.vertices), bool)
        used[faces.ravel()] = True
        return Mesh(self.vertices[used], (np.cumsum(used) - 1)[faces])

    def crosses(self) -> np.ndarray:
        """Return each face's normal times twice its area, [m, 3]."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return np.cross(b - a, c - a)

    def areas(self) -> np.ndarray:
        """Return the faces' areas, [m]."""
        return np.asarray(np.linalg.norm(self.crosses(), axis=1) / 2)

    def normals(self) -> np.ndarray:
        """Return unit vertex normals [n, 3]: the area-weighted mean of the adjacent faces' normals."""
        crosses = self.crosses()
        sums = np.stack(
            [np.bincount(self.faces.ravel(), np.repeat(crosses[:, axis], 3), len(self.vertices)) for axis in range(3)],
            axis=1,
        )
        lengths = np.linalg.norm(sums, axis=1, keepdims=True)
        # A vertex whose faces all have zero area has no normal; any unit vector will do.
        return np.where(lengths > 1e-30, sums / np.maximum(lengths, 1e-30), [0.0, 0.0, 1.0])


def without_small_pieces(mesh: Mesh, share: float) -> Mesh:
    """Return the mesh without connected pieces that have less than `share` of the largest one's area."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(mesh.faces):
        return mesh
    first, second = mesh.faces[:, [0, 1]].ravel(), mesh.faces[:, [1, 2]].ravel()
    edges = coo_array((np.ones(len(first), bool), (first, second)), shape=(len(mesh.vertices),) * 2)
    _, labels = connected_components(edges, directed=False)
    of_faces = labels[mesh.faces[:, 0]]
    areas = np.bincount(of_faces, mesh.areas())
    return mesh.with_faces(areas[of_faces] >= share * areas.max())
