"""Recolor: change a decomposed field's palette, everywhere or around points, without training (PaletteNeRF)."""

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import PALETTE, by_column, changes_of, columns_and_shares, kept_details, save_palette
from stages.artifacts.field import load_field, save_field
from stages.artifacts.scene import SceneData, load_scene, view_index
from stages.configs.decompose import RecolorConfig
from stages.configs.view_syntax import pixel_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.editing.selection import ends_of_rays
from stylerf.errors import InvalidValue
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.palette_edits import Recoloring, SpaceFilter
from stylerf.fields.radiance_field import RadianceField
from stylerf.kernels.cpu.compiling import set_threads

SPEC = Spec(stage="recolor", verb="stylize", revision=3, writes="field")
REACH = 0.1  # of the distance from the camera
SEEN = 0.5  # alpha from which a pixel shows a surface


def run(inputs: dict[str, Artifact], config: RecolorConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the same field with the changes; return the figures."""
    source = inputs["field"]
    field, background = load_field(source)
    color = field.color
    if not isinstance(color, PaletteColor):
        raise BadInput(f"{source.path} has no palette; make one with `stylerf stylize --method palettenerf`")
    columns, shares = columns_and_shares(source, color.bases)
    changes = changes_of(config, color.present_palette[columns], np.array(shares)[columns])
    try:
        changes.check(len(columns))
    except InvalidValue as error:
        raise BadInput(f"{source.path}: {error}; see {source.path / PALETTE}") from error
    changes = by_column(changes, columns)
    try:
        within = None
        if config.local:
            within = _filter(load_scene(inputs["scene"]), field, config, set_threads(context.threads))
        edit = Recoloring(changes, config.offset_scale, config.view_scale, within)
        field.color = color.edited(edit)
    except InvalidValue as error:
        raise BadInput(f"{source.path}: {error}") from error
    totals = kept_details(source, changes)
    save_field(partial.path, field, background)
    save_palette(partial.path, color.palette, field.color.present_palette, shares, totals)
    return {
        **totals,
        "learned": source.name,
        "edit": edit.describe(),
        "edits": len(field.color.edits),
        "parameters": field.parameters,
    }


def _filter(scene: SceneData, field: RadianceField, config: RecolorConfig, threads: int) -> SpaceFilter:
    """Around the surface points that the pixels of --at show."""
    centers, reaches = [], []
    for text in config.at:
        name, column, row = pixel_of(text)
        camera = scene.cameras[view_index(scene, name, f"--at {text}")]
        if not (column < camera.width and row < camera.height):
            raise BadInput(f"--at {text}: view {name} has {camera.width}x{camera.height} pixels")
        pixel = np.array([int(row) * camera.width + int(column)])
        x, alpha = ends_of_rays(field, camera, pixel, threads)
        if alpha[0] < SEEN:
            raise BadInput(f"--at {text} hits nothing in the field: choose a pixel where the render shows the object")
        across, down, along = field.space.unwarp(x)[0].tolist()
        centers.append((across, down, along))
        reaches.append(REACH * float(np.linalg.norm(np.array(centers[-1]) - camera.center)))
    return SpaceFilter(field.space, tuple(centers), config.reach or float(np.mean(reaches)))
