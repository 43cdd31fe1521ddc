"""One tiny artifact of every kind, and of every kind of field, and what the next stage does with each."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from schemas.tensors import save_tensors
from schemas.work_folder import Artifact, WorkFolder
from stages.artifacts.edit import (
    Edit,
    columns_and_shares,
    kept_details,
    load_edit,
    load_edit_views,
    save_edit,
    save_edit_views,
)
from stages.artifacts.field import load_deformation, load_field, save_deformation, save_field
from stages.artifacts.region import load_region, regions_among, save_region
from stages.artifacts.report import read_report
from stages.artifacts.scene import EDIT_TARGETS, load_scene, space_of
from stages.comparison.runs import runs_of
from stages.configs.edit import DistillConfig
from stages.distill import edited_photo
from stages.evaluation.test_views import FrameViews
from stages.finetune import edited_pixels
from stylerf.editing.edit_grid import Region, solid_cells
from stylerf.editing.extraction import EditView
from stylerf.editing.palette_module import PaletteModule
from stylerf.fields.blended_color import BlendedColor, Layer
from stylerf.fields.color_map import ColorMap
from stylerf.fields.deformation import Deformation
from stylerf.fields.hash_encoding import HashEncoding
from stylerf.fields.palette_color import PaletteColor
from stylerf.fields.palette_edits import PaletteEdits, Recoloring, SpaceFilter
from stylerf.fields.radiance_field import RadianceField, layers_of
from stylerf.fields.region_color import RegionColor
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import render_view
from tests.stages.comparison_fixture import report
from tests.stages.evaluation_fixture import Seen, commit, make_frames
from tests.stages.stress_fixture import SIZE, make_capture
from tests.stylerf import small

LOOK = Camera("look", 8, 6, 8.0, 8.0, 4.0, 3.0, np.eye(4))
CELLS = 8


@dataclass(frozen=True)
class Made:
    """An artifact, and what a stage that is given it does first; what comes out must be finite."""

    artifact: Artifact
    use: Callable[[Artifact], None]


def every_artifact(work: WorkFolder) -> dict[str, Made]:
    """By kind, or kind and kind of field."""
    scene = make_capture(work, tests=1, train=3)
    rng = np.random.default_rng(0)
    points = {"xyz": rng.normal(size=(5, 3)).astype(np.float32), "rgb": np.zeros((5, 3), np.uint8),
              "error": np.ones(5, np.float32)}  # fmt: skip
    targets = {"1.pixels": np.array([5, 300]), "1.depth": np.ones(2, np.float32), "1.earlier_pixels": np.array([7]),
               "1.earlier_depth": np.ones(1, np.float32)}  # fmt: skip

    def edited_scene(folder: Path) -> None:
        shutil.copytree(scene.path / "images", folder / "images")
        shutil.copy(scene.path / "scene.json", folder)
        save_tensors(folder / "points.safetensors", points)
        save_tensors(folder / EDIT_TARGETS, targets)

    made = {"scene": Made(commit(work, "scene", "edited", "distill", {"scene": scene}, edited_scene), _use_scene)}
    for name, field in _fields().items():
        made[f"field {name}"] = Made(_field(work, scene, name, field), _use_field)
    plain = made["field vm"].artifact
    cells = np.zeros((CELLS,) * 3, bool)
    cells[2:5, 2:5, 2:5] = True
    region = Region(cells, np.roll(cells, 3, 0) & ~cells)
    space = small.SPACES["box"]
    made["region"] = Made(
        commit(work, "region", "part", "region_select", {"field": plain}, lambda f: save_region(f, region, space, {})),
        lambda one: _use_region(one, plain),
    )
    views = commit(work, "edit-dataset", "part", "edit_dataset", {"scene": scene}, _save_views)
    made["edit-dataset"] = Made(views, lambda one: _use_views(one, scene))
    made["edit"] = Made(commit(work, "edit", "part", "edit_learn", {"edit-dataset": views}, _save_edit), _use_edit)
    shape = LOOK.height, LOOK.width
    seen = Seen(np.full((*shape, 3), 0.5, np.float32), np.ones(shape, np.float32), np.ones(shape, np.float32))
    made["frames"] = Made(make_frames(work, "test", "test", [LOOK], [seen], plain), _use_frames)
    made["report"] = Made(report(work, plain, {"psnr": 20.0}, {"regions": ["part"]}), _use_report)
    return made


# -- fields -----------------------------------------------------------------------------------------------------------


def _fields() -> dict[str, RadianceField]:
    """Of every kind of density, color, head and space."""
    box, contraction, frustum = (small.SPACES[kind] for kind in ("box", "contraction", "frustum"))
    made = {
        "vm": small.field_of(box, 1),
        "hash": small.field_of(contraction, 2, small.hash_color(3)),
        "voxel": small.field_of(frustum, 4, small.headed(5, "voxel", "linear", capacity=small.SPARSE)),
        "vm mlp": small.field_of(box, 6, small.headed(7, "vm", "mlp")),
        "hash linear": small.field_of(box, 8, small.headed(9, "hash", "linear")),
        "palette": small.field_of(box, 10, _palette(box)),
        "patch": small.field_of(box, 11, _patch()),
        "blend": small.field_of(box, 21, _blend()),
        "deformed": small.field_of(box, 12, displacement=small.displacement_grid(13)),
    }
    made["hash"].density, made["voxel"].density = small.hash_density(14), small.voxel_density(15)
    made["vm"].occupancy = small.half_empty()
    made["deformed"].color_map = ColorMap(torch.eye(3), torch.zeros(3))
    return made


def _palette(space) -> PaletteColor:
    rng = np.random.default_rng(16)
    color = PaletteColor.create(rng, rng.random((4, 3)), 4, 32, 512)
    within = SpaceFilter(space, ((0.0, 0.1, 0.2),), 0.5)
    changes = PaletteEdits({0: (0.9, 0.1, 0.1)}, {1: 2.0}, {2: 0.1})
    return color.edited(Recoloring(changes, 0.5, 2.0, within)).edited(Recoloring(PaletteEdits({3: (0, 0, 1.0)})))


def _blend() -> BlendedColor:
    plain, marked = small.hash_color(22), np.zeros((CELLS,) * 3, bool)
    marked[:4] = True
    inner = BlendedColor([Layer(plain, None, 0.01, 1.0), Layer(_patch(), None, 0.02, 0.5, ~marked)])
    mapped = Layer(small.vm_color(23), ColorMap(torch.eye(3), torch.zeros(3)), 0.3, 0.25)
    return BlendedColor([Layer(inner, None, 0.01, 0.75), mapped, Layer(plain, None, 0.01, 0.8, marked)])


def _patch() -> RegionColor:
    marked = np.zeros((CELLS,) * 3, bool)
    marked[2:6, 2:6, 2:6] = True
    return RegionColor(small.vm_color(17), small.hash_color(18), marked)


def _field(work: WorkFolder, scene: Artifact, name: str, field: RadianceField) -> Artifact:
    def write(folder: Path) -> None:
        save_field(folder, field, "white" if field.space.kind == "box" else "none")
        if field.displacement is not None:
            save_deformation(folder, Deformation.create(np.random.default_rng(0), 2, 8))

    return commit(work, "field", name.replace(" ", "-"), "nerf_fit", {"scene": scene}, write, figures={"parameters": 9})


def _use_field(artifact: Artifact) -> None:
    field, _ = load_field(artifact)
    middle = field.space.unwarp(np.full((1, 3), 0.5))[0]
    pose = np.eye(4)
    pose[:3, 3] = middle - [0, 0, 0 if field.space.kind == "frustum" else 2]
    seen = render_view(field, Camera("look", 8, 6, 8.0, 8.0, 4.0, 3.0, pose), threads=2)
    _finite(seen.rgb, seen.alpha, seen.z)
    for part in (field.density, *layers_of(field.color)):
        to = np.zeros(len(part.values), np.float32)
        part.smooth(1.0, to)
    solid_cells(field, CELLS, 1)
    if (deformation := load_deformation(artifact)) is not None:
        x = torch.rand(4, 3)
        _finite(deformation.network(deformation.encode(x), torch.from_numpy(deformation.values)).numpy())


# -- all else ---------------------------------------------------------------------------------------------------------


def _use_scene(artifact: Artifact) -> None:
    scene = load_scene(artifact)
    for camera in scene.cameras:
        origins, directions = camera.rays(np.array([0]))
        _finite(origins, directions)
    space, _ = space_of(scene, "auto")
    _finite(space.packed())
    edited_pixels(scene, scene.splits["train"], earlier=True)
    scene.images(0)


def _use_region(artifact: Artifact, field: Artifact) -> None:
    load_region(artifact)
    regions_among({"region.part": artifact}, load_field(field)[0].space)


def _save_views(folder: Path) -> None:
    rng, views = np.random.default_rng(19), []
    for view, count in ((1, 4), (3, 6)):
        wide, narrow = (rng.random((count, 3)).astype(np.float32) for _ in range(2))
        one, unit = np.ones(count, np.float32), narrow / np.linalg.norm(narrow, axis=1, keepdims=True)
        views.append(EditView(view, SIZE, SIZE, np.arange(count) * 7, wide, narrow, unit, narrow, one, one, one, one,
                              0 * one, wide[:, :2].copy()))  # fmt: skip
    save_edit_views(folder, views, {"hidden": [], "region": "part", "reach": 0.1})


def _use_views(artifact: Artifact, scene: Artifact) -> None:
    views, _ = load_edit_views(artifact)
    pictures, module = load_scene(scene), _module()
    for view in views:
        if view.view < len(pictures.cameras) and (view.width, view.height) == (SIZE, SIZE):
            edited_photo(pictures, view, module, PaletteEdits(), DistillConfig(), 1)
            view.pairs()
        assert view.window


def _module() -> PaletteModule:
    rng = np.random.default_rng(20)
    encoding = HashEncoding.create(rng, 4, 4, 16, 64)
    module = PaletteModule.create(rng, rng.random((4, 3)), np.float32([[0.1] * 3, [0.8] * 3]), encoding)
    module.active[1] = False
    return module


def _save_edit(folder: Path) -> None:
    edit = Edit(_module(), PaletteEdits({0: (0.1, 0.2, 0.3)}, {1: 1.5}, {2: 0.2}))
    save_edit(folder, edit, [0.5, 0.3, 0.2], {"sparsity": 0.1, "palette_variation": 0.2})


def _use_edit(artifact: Artifact) -> None:
    edit = load_edit(artifact)
    columns_and_shares(artifact, len(edit.module.palette))
    assert all(np.isfinite(value) for value in kept_details(artifact, PaletteEdits()).values())
    x = np.random.default_rng(21).random((16, 3)).astype(np.float32)
    _finite(edit.module.colors(x, np.tile(np.float32([0, 0, 1]), (16, 1)), edit.changes, np.full(16, 0.5, np.float32)))


def _use_frames(artifact: Artifact) -> None:
    views = FrameViews(artifact, 1.0)
    for index in range(len(views)):
        render = views.render(index)
        _finite(*render.camera.rays(np.array([0])))
        views.index_of(0)


def _use_report(artifact: Artifact) -> None:
    read_report(artifact)
    runs_of([WorkFolder(artifact.path.parent.parent)])


def _finite(*arrays: np.ndarray) -> None:
    for array in arrays:
        assert np.isfinite(array).all(), "not finite"
