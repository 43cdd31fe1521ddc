"""Distill: write an edit into the training photos (LAENeRF, 3.5)."""

import shutil
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from schemas.errors import ArtifactDamaged, BadInput
from schemas.images import to_uint8, write_png
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import load_edit, load_edit_views
from stages.artifacts.photos import load_pictures
from stages.artifacts.scene import EARLIER, EDIT_TARGETS, SceneData, edit_targets
from stages.configs.edit import DistillConfig
from stages.run.devices import gpu_figures, gpu_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.editing.extraction import EditView
from stylerf.fields.palette_edits import PaletteEdits
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.training.backends import palette_module

SPEC = Spec(stage="distill", verb="distill", revision=3, writes="scene")


def run(inputs: dict[str, Artifact], config: DistillConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write a copy of the scene whose photos show the edit; return the figures."""
    threads = set_threads(context.threads)
    scene = load_pictures(inputs["scene"], inputs["field"], threads)
    views, _ = load_edit_views(inputs["edit-dataset"])
    edit = load_edit(inputs["edit"])
    made_from = {ref.digest for ref in inputs["edit-dataset"].manifest.inputs if ref.role == "scene"}
    if inputs["scene"].digest not in made_from:
        raise BadInput(
            f"{inputs['edit-dataset'].path} was extracted from a different scene than {inputs['scene'].path}"
        )
    for view in views:
        camera = scene.cameras[view.view] if view.view < len(scene.cameras) else None
        if camera is None or (view.width, view.height) != (camera.width, camera.height):
            raise ArtifactDamaged(
                f"{inputs['edit-dataset'].path}: its view {view.view}, {view.width}x{view.height}, is not in the "
                "scene; rebuild it"
            )
    for record in inputs["scene"].manifest.files:
        if record.path != EDIT_TARGETS:
            target = partial.path / record.path
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(inputs["scene"].file(record.path), target)
    targets: dict[str, np.ndarray] = {}
    device = gpu_of(context)
    module = palette_module(device, edit.module)
    context.progress.start("distill", len(views), "view")
    with nullcontext() if device else compiling_note(context.progress.say):
        for done, view in enumerate(views):
            image, own = edited_photo(scene, view, module, edit.changes, config, threads)
            write_png(partial.path / scene.views[view.view].image, image)
            targets |= {f"{view.view}.pixels": view.pixels[own], f"{view.view}.depth": held_depth(view)[own]}
            context.progress.update(done + 1)
    context.progress.finish()
    write_unedited_photos(scene, {view.view for view in views}, partial.path)
    pixels = int(sum(len(v) for k, v in targets.items() if k.endswith(".pixels")))
    keep_earlier_edits(scene, targets)
    save_tensors(partial.path / EDIT_TARGETS, targets)
    return {"views": len(views), "pixels": pixels, **gpu_figures(device)}


def held_depth(view: EditView) -> np.ndarray:
    """sum(w t) [n] that fine-tuning keeps the view's rays at; 0 (none) if a ray ends in the background.

    There the sum is close to zero, so its relative error, which fine-tuning uses, is meaningless.
    """
    return np.where(view.depth > 0, view.through, np.float32(0))


def edited_photo(
    scene: SceneData, view: EditView, module, changes: PaletteEdits, config: DistillConfig, threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the photo with the edit [h, w, 3 or 4] uint8, and which of the view's pixels show it.

    LAENeRF edits whole pixels, by the alpha of the field: what is visible next to the region would learn its colors.
    Here edges are blended; one pixel further in, alpha_E is over 0.96 of alpha (98 % of pixels, still life, 48x48).
    """
    photo = scene.images(view.view)
    fading = view.transition if config.fade else None
    found = module.colors(view.x, view.directions, changes, fading, threads)
    chosen = np.flatnonzero(view.weight > config.min_opacity)
    pixels = view.pixels[chosen]
    out = photo.reshape(-1, photo.shape[2]).copy()
    # What of a pixel is not the region's stays the photo's. If the photo has alpha, transparency is in that.
    share = view.inside[chosen] / (view.weight[chosen] if photo.shape[2] == 4 else 1)
    out[pixels, :3] += share[:, None] * (found[chosen] - out[pixels, :3])
    return to_uint8(out.reshape(photo.shape)), chosen


def write_unedited_photos(scene: SceneData, shown: set[int], folder: Path) -> None:
    """Write the photos that do not show the edit, if they are not used as stored (one exposure, own colors)."""
    for index, view in enumerate(scene.views):
        if not scene.as_stored(index) and index not in shown:
            write_png(folder / view.image, to_uint8(scene.images(index)))


def keep_earlier_edits(scene: SceneData, targets: dict[str, np.ndarray]) -> None:
    """Add the pixels of earlier edits of the same photos: training a whole field must include them."""
    before = edit_targets(scene)
    for index in sorted({index for index, _ in before}):
        parts = [before[index, part] for part in ("", EARLIER) if (index, part) in before]
        pixels = np.concatenate([part.pixels for part in parts])
        depth = np.concatenate([part.depth for part in parts])
        left = ~np.isin(pixels, targets.get(f"{index}.pixels", ()))
        targets |= {f"{index}.{EARLIER}pixels": pixels[left], f"{index}.{EARLIER}depth": depth[left]}
