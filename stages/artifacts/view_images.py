"""What a local edit sees of a scene: its photos, or what the field shows where its colors are in no photo."""

from dataclasses import replace

import numpy as np

from schemas.work_folder import Artifact
from stages.artifacts.field import load_field
from stages.artifacts.photos import level_of
from stages.artifacts.provenance import shows_its_pictures
from stages.artifacts.scene import SceneData, load_scene
from stylerf.rendering.view import render_view


def load_pictures(artifact: Artifact, of: Artifact, chunks: int) -> SceneData:
    """The scene as an edit of field `of` sees it: the looks of a stylized or recolored one are in no photo."""
    scene = load_scene(artifact, of)
    if shows_its_pictures(of):
        return scene
    field, background = load_field(of)

    def retaken(index: int) -> np.ndarray:
        seen = render_view(field, scene.cameras[index], threads=chunks)
        alpha = seen.alpha[..., None]
        if scene.channels(index) == 4:
            return np.concatenate([(seen.rgb / np.maximum(alpha, 1e-6)).clip(0, 1), alpha], axis=2)
        return (seen.rgb + (1 - alpha) * np.float32(level_of(background))).clip(0, 1)

    return replace(scene, retaken=retaken)
