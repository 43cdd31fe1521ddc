"""Helpers of the tests of `import`: run the stage, and hold a scene against the source's own projection."""

import numpy as np

from schemas.scene import Scene, read_scene
from schemas.work_folder import Artifact, WorkFolder
from stages import pose_import
from stages.configs.pose_import import ImportOptions
from stages.pipeline.prerequisites import import_config
from stages.run.progress import Context, Silent
from stages.run.runner import execute


class Said(Silent):
    """Keeps what the stage says."""

    def __init__(self):
        self.lines = []

    def say(self, text):
        self.lines.append(text)


def imported(source, work, said=None, seed=0, **options) -> Artifact:
    """The scene artifact of `stylerf import source work` with these options."""
    config = import_config(source, ImportOptions(**options))
    context = Context(seed=seed, progress=said or Silent())
    return execute(pose_import.SPEC, pose_import.run, WorkFolder(work), "main", {}, config, context)[0]


def scene_of(artifact: Artifact) -> Scene:
    """Its scene.json."""
    return read_scene(artifact.path)


def psnr(one: np.ndarray, two: np.ndarray) -> float:
    """dB, of values 0..1."""
    return float(-10 * np.log10(np.mean((one - two) ** 2)))
