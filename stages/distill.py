"""Distill: the training photos with an edit painted into them (LAENeRF, 3.5)."""

import shutil
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.images import to_uint8, write_png
from schemas.store import Artefact, Partial
from schemas.tensors import load_tensors, save_tensors
from stages.configs.distill import DistillConfig
from stages.devices import gpu_figures, gpu_of
from stages.edit_views import load_edit_views
from stages.edits import load_edit
from stages.progress import Context
from stages.runner import Spec
from stages.scenes import EDIT_TARGETS, SceneData, load_scene
from stylerf.editing.edits import PaletteEdits
from stylerf.editing.palette import PaletteModule
from stylerf.editing.views import EditView
from stylerf.kernels.cpu.compiling import compiling_note, set_threads

SPEC = Spec(stage="distill", verb="distill", revision=2, writes="scene")


def run(inputs: dict[str, Artefact], config: DistillConfig, partial: Partial, context: Context) -> dict:
    """Writes a scene like the one before, but for the photos that show the edit; returns the figures."""
    scene = load_scene(inputs["scene"], inputs["edit-dataset"])
    views, _ = load_edit_views(inputs["edit-dataset"])
    edit = load_edit(inputs["edit"])
    made_from = {ref.digest for ref in inputs["edit-dataset"].manifest.inputs if ref.role == "scene"}
    if inputs["scene"].digest not in made_from:
        raise BadInput(f"{inputs['edit-dataset'].path} was extracted from another scene than {inputs['scene'].path}")
    chunks = set_threads(context.threads)
    for record in inputs["scene"].manifest.files:
        if record.path != EDIT_TARGETS:
            target = partial.path / record.path
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(inputs["scene"].path / record.path, target)
    targets: dict[str, np.ndarray] = {}
    device = gpu_of(context)
    module = _on_device(edit.module, device) if device else edit.module
    context.progress.start("distill", len(views), "view")
    with nullcontext() if device else compiling_note(context.progress.say):
        for done, view in enumerate(views):
            image, pixels, depth = _edited(scene, view, module, edit.changes, config, chunks)
            write_png(partial.path / scene.views[view.view].image, image)
            targets |= {f"{view.view}.pixels": pixels, f"{view.view}.depth": depth}
            context.progress.update(done + 1)
    context.progress.finish()
    _expose_others(scene, {view.view for view in views}, partial.path)
    _keep_earlier(inputs["scene"], targets)
    save_tensors(partial.path / EDIT_TARGETS, targets)
    pixels = int(sum(len(v) for k, v in targets.items() if k.endswith(".pixels")))
    return {"views": len(views), "pixels": pixels, **gpu_figures(device)}


def _on_device(module: PaletteModule, device: str):
    from stylerf.editing.device_palette import DevicePalette

    return DevicePalette(module, device)


def _edited(
    scene: SceneData, view: EditView, module, changes: PaletteEdits, config: DistillConfig, chunks: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The photo with the edit [h, w, 3 or 4] uint8, its edited pixels, and sum(w t) of their rays."""
    photo = scene.images(view.view)
    fading = view.transition if config.fade else None
    found = module.colours(view.x, view.directions, changes, fading, chunks)
    chosen = view.weight > config.least
    pixels = view.pixels[chosen]
    out = photo.reshape(-1, photo.shape[2]).copy()
    if photo.shape[2] == 4:
        out[pixels, :3] = found[chosen]  # its alpha stays
    else:
        # What the region does not cover of a pixel stays the photo's.
        share = view.weight[chosen, None]
        out[pixels, :3] = share * found[chosen] + (1 - share) * out[pixels, :3]
    depth = (view.depth * view.weight)[chosen].astype(np.float32)
    return to_uint8(out.reshape(photo.shape)), pixels, depth


def _expose_others(scene: SceneData, shown: set[int], folder: Path) -> None:
    """Photos in which the edit is not seen, brought to the exposure that those have in which it is."""
    for index, view in enumerate(scene.views):
        if view.name in scene.stops and index not in shown:
            write_png(folder / view.image, to_uint8(scene.images(index)))


def _keep_earlier(scene: Artefact, targets: dict[str, np.ndarray]) -> None:
    """Pixels of an earlier edit of the same photos stay edited pixels: a field that learns both must see both."""
    path = scene.path / EDIT_TARGETS
    if not path.is_file():
        return
    before, _ = load_tensors(path)
    for name, old in before.items():
        index, _, kind = name.partition(".")
        if kind != "pixels":
            continue
        own = targets.get(name, np.empty(0, np.int64))
        more = ~np.isin(old, own)
        targets[name] = np.concatenate([own, old[more]])
        depths = targets.get(f"{index}.depth", np.empty(0, np.float32))
        targets[f"{index}.depth"] = np.concatenate([depths, before[f"{index}.depth"][more]])
