"""Extract: what the training views show of a region, to train its edit on (LAENeRF, 3.3)."""

from contextlib import nullcontext

import numpy as np

from schemas.errors import BadInput
from schemas.exr import ExrView, write_exr
from schemas.images import linear_from_srgb
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.edit import save_edit_views
from stages.artifacts.field import load_field
from stages.artifacts.photos import load_pictures
from stages.artifacts.region import region_of_field
from stages.configs.edit import ExtractConfig
from stages.run.devices import gpu_figures, gpu_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.editing.edit_grid import Region
from stylerf.editing.extraction import EditView, Extraction, Seen, seen_of_view
from stylerf.fields.radiance_field import RadianceField
from stylerf.geometry.cameras import Camera
from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.training.backends import ray_ends

SPEC = Spec(stage="edit_dataset", verb="extract", revision=5, writes="edit-dataset")
FADING = 1 / 40  # of the region's size


def run(inputs: dict[str, Artifact], config: ExtractConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the views' pixels, also as EXR; return the figures."""
    threads = set_threads(context.threads)
    scene = load_pictures(inputs["scene"], inputs["field"], threads)
    field, _ = load_field(inputs["field"])
    region = region_of_field(inputs["region"], inputs["field"], field)
    size = _size(region, field.space)
    reach = FADING * size if config.transition < 0 else config.transition
    settings = Extraction(config.tolerance, reach)
    train = scene.splits["train"]
    views, hidden = [], []
    device = gpu_of(context, field)
    ends_of = ray_ends(device, field)
    context.progress.start("extract", len(train), "view")
    with nullcontext() if device else compiling_note(context.progress.say):
        for done, index in enumerate(train):
            camera = scene.cameras[index]
            seen = seen_of_view(field, camera, scene.images(index), region, settings, index, threads, ends_of)
            if seen.edit is None:
                hidden.append(camera.name)
            else:
                views.append(seen.edit)
                if config.exr:
                    write_exr(partial.path / "exr" / f"{camera.name}.exr", _exr(seen, seen.edit, camera, field))
            context.progress.update(done + 1)
    context.progress.finish()
    if not views:
        raise BadInput(
            f"no training view shows region {inputs['region'].name}: it is hidden, or more than --tolerance "
            f"{config.tolerance:g} of every pixel is outside it"
        )
    pixels = int(sum(len(view) for view in views))
    save_edit_views(partial.path, views, {"hidden": hidden, "region": inputs["region"].name, "reach": reach})
    figures = {"views": len(views), "hidden": hidden, "pixels": pixels, "region_size": round(size, 5)}
    return figures | gpu_figures(device)


def _size(region: Region, space: SpaceWarp) -> float:
    """Diagonal of the region's bounding box, scene units, without cells at the border of the cube."""
    s = region.cells
    where = np.argwhere(region.edit)
    inner = where[((where > 0) & (where < s - 1)).all(1)]
    where = inner if len(inner) else where
    ends = space.unwarp(np.clip((where + 0.5) / s, 1e-3, 1 - 1e-3))
    low, high = np.percentile(ends, [2, 98], axis=0)
    return float(np.linalg.norm(high - low))


def _exr(seen: Seen, edit: EditView, camera: Camera, field: RadianceField) -> ExrView:
    """The photo within the region, by the field's alpha; masks: region, transition, edges."""
    full = {name: np.zeros(seen.alpha.size, np.float32) for name in ("alpha", "transition", "below", "beside")}
    rgb = np.zeros((seen.alpha.size, 3), np.float32)
    rgb[edit.pixels] = linear_from_srgb(edit.target) * edit.weight[:, None]
    for name, values in (
        ("alpha", edit.weight),
        ("transition", edit.transition),
        ("below", edit.edges[:, 0]),
        ("beside", edit.edges[:, 1]),
    ):
        full[name][edit.pixels] = values
    # A ray that ends in the background has no depth: in the buffer it is as far as the space reaches.
    depth = np.where(seen.depth > 0, seen.depth, np.float32(field.space.far))
    planes = {name: plane.reshape(seen.alpha.shape) for name, plane in full.items()}
    return ExrView(
        rgb=rgb.reshape(*seen.alpha.shape, 3),
        alpha=planes["alpha"],
        z=depth * camera.ray_cosines(),
        ray_distance=depth,
        world_from_camera=camera.world_from_camera,
        intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy),
        near=max(field.space.near, 1e-3),
        far=field.space.far,
        masks={
            "region": seen.alpha_edit,
            "transition": planes["transition"],
            "edge_below": planes["below"],
            "edge_beside": planes["beside"],
        },
    )
