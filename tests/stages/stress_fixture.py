"""A tiny capture to be damaged, and outcomes of runs that were never made."""

import numpy as np

from schemas.images import write_png
from schemas.scene import Bounds, Scene, View, as_matrix, write_scene
from schemas.work_folder import Artifact, WorkFolder
from stages.stress.outcomes import Outcome
from stylerf.procedural.still_life import dome_cameras
from tests.stages.evaluation_fixture import camera_entry, commit

SIZE, TRAIN, TEST = 24, 10, 3


def photo_of(index: int, alpha: bool = True) -> np.ndarray:
    """[SIZE, SIZE, 4] uint8: smooth, another for each view; the rim is transparent."""
    rows, columns = np.mgrid[0:SIZE, 0:SIZE]
    rgb = 120 + 40 * np.sin(rows[..., None] / 5 + columns[..., None] / 7 + index + np.arange(3))
    seen = (np.minimum(rows, columns) > 2) & (np.maximum(rows, columns) < SIZE - 3)
    return np.dstack([rgb, 255 * seen if alpha else np.full((SIZE, SIZE), 255)]).astype(np.uint8)


def make_capture(
    work: WorkFolder, layout: str = "object", tests: int = TEST, train: int = TRAIN, background: str = "alpha"
) -> Artifact:
    """Scene `main`: views train_000 ... and test_000 ... on a dome of radius 4.03."""

    def write(folder) -> None:
        cameras = [*dome_cameras(train, SIZE, "train", 0), *dome_cameras(tests, SIZE, "test", 9)]
        views = []
        for index, camera in enumerate(cameras):
            write_png(folder / f"images/{index:03d}.png", photo_of(index, background == "alpha"))
            split = camera.name.partition("_")[0]
            views.append(View(camera.name, f"images/{index:03d}.png", split, **camera_entry(camera)))
        bounds = Bounds(((-1, -1, -1), (1, 1, 1)), 0.5, 8.0)
        write_scene(folder, Scene(tuple(views), layout, "made up", bounds, background, as_matrix(np.eye(4))))

    return commit(work, "scene", "main", "pose_import", {}, write)


def outcome(method="fit", fault="seeds", seed=0, score: float | None = 20.0, ok=True, **more) -> Outcome:
    why = "" if ok else "too far off"
    given = {"key": "k", "remedies": False, "why": why, "figures": {}, "seconds": 2.0, "picture": ""}
    return Outcome(method=method, fault=fault, seed=seed, score=score, ok=ok, **{**given, **more})
