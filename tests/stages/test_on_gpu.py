"""Stages whose rays go through moving shapes hand them to the device that they are given, and say where they cannot."""

import numpy as np
import pytest
import torch

from schemas.errors import OutOfResources
from schemas.images import write_png
from schemas.scene import Bounds, Scene, View, as_matrix, write_scene
from schemas.work_folder import Artifact, Recipe, WorkFolder
from stages import deform_init, stylize
from stages.artifacts.field import load_deformation, load_field, save_field
from stages.artifacts.scene import load_scene
from stages.configs.deform import DeformConfig
from stages.configs.stylize import DesrfConfig
from stages.run import devices
from stages.run.devices import rays_on
from stages.run.progress import Context
from stylerf.fields.deformation import Deformation
from stylerf.kernels.gpu import interpreted
from stylerf.training.backends import style_backend
from stylerf.training.common.process_group import ProcessGroup
from stylerf.training.deform import deformer, fitter
from stylerf.training.deform.deformer_gpu import GpuDeformer
from tests.stages.evaluation_fixture import camera_entry, commit
from tests.stylerf.small import field_of, hash_density, vm_color, voxel_density
from tests.stylerf.style.small_trunk import picture
from tests.stylerf.training.scenes import AROUND, box_photo, dome

pytestmark = pytest.mark.usefixtures("interpreter")
CONFIG = DeformConfig(steps=1, rays=16, vertices=6, width=16, frequencies=2)


class Said:
    """Keeps what a stage says."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)

    def start(self, *reported) -> None: ...

    def update(self, *reported) -> None: ...

    def finish(self) -> None: ...


def inputs_in(work: WorkFolder) -> dict[str, Artifact]:
    """Three photos of a box, and a fog that was never fitted to them."""
    cameras = dome(3, 1, 8)

    def write(folder) -> None:
        for camera in cameras:
            write_png(folder / f"images/{camera.name}.png", box_photo(camera))
        views = [View(c.name, f"images/{c.name}.png", "train", **camera_entry(c)) for c in cameras]
        bounds = Bounds(((-1, -1, -1), (1, 1, 1)), 0.5, 5.0)
        write_scene(folder, Scene(tuple(views), "object", "made up", bounds, "alpha", as_matrix(np.eye(4))))

    scene = commit(work, "scene", "box", "import", {}, write)
    field = field_of(AROUND, 3, vm_color(4), 1 / 4)
    field.density.values[-1] = -4.0
    fog = commit(work, "field", "fog", "fit", {"scene": scene}, lambda folder: save_field(folder, field, "white"))
    return {"scene": scene, "field": fog}


@pytest.fixture
def few_rays(monkeypatch):
    monkeypatch.setattr(deformer, "SIGHT_RAYS", 2048)
    monkeypatch.setattr(fitter, "FIXED_RAYS", 40)


def test_a_deformation_is_learned_on_the_device_and_kept_as_on_the_cpu(few_rays, monkeypatch, tmp_path):
    """Where there is no GPU Triton's interpreter stands in: `cpu` is then a device as any other."""
    pytest.importorskip("triton", reason="Triton is not installed")
    monkeypatch.setattr(deform_init, "gpu_of", lambda context, field, moving: context.device)
    work, seen = WorkFolder(tmp_path / "work"), []
    inputs = inputs_in(work)

    def bent(name: str, device: str | None) -> tuple[dict, Artifact]:
        partial, said = work.begin("field", name, Recipe("deform_init", 2, {"name": name}, [], 0)), Said()
        made_by = GpuDeformer.collect
        with monkeypatch.context() as watched:
            watched.setattr(GpuDeformer, "collect", lambda made: seen.append(name) or made_by(made))
            figures = deform_init.run(inputs, CONFIG, partial, Context(0, device, 1, progress=said))
        assert not [line for line in said.lines if "CPU" in line]
        return figures, partial.commit()

    plain, on_cpu = bent("plain", None)
    reported, on_device = bent("bent", "cpu" if interpreted() else "cuda")
    assert set(seen) == {"bent"} and reported["steps"] == plain["steps"] == 1
    assert "gpu_memory_mb" in reported and "gpu_memory_mb" not in plain
    for figure in ("psnr_before", "psnr_after"):
        assert reported[figure] == pytest.approx(plain[figure], abs=2e-3)
    fields = [load_field(made)[0] for made in (on_cpu, on_device)]
    values = [load_deformation(made).values for made in (on_cpu, on_device)]
    np.testing.assert_allclose(*(field.displacement for field in fields), atol=1e-5)
    np.testing.assert_allclose(*values, atol=1e-4)
    assert np.array_equal(*(field.occupancy.distances for field in fields))


@pytest.mark.parametrize("kind", ["vm", "hash", "voxel"])
def test_deforming_stylization_uses_the_gpu_where_kernels_allow(kind, monkeypatch, tmp_path):
    inputs = inputs_in(WorkFolder(tmp_path / "work"))
    scene, (field, _) = load_scene(inputs["scene"]), load_field(inputs["field"])
    if kind != "vm":
        field.density = {"hash": hash_density, "voxel": voxel_density}[kind](1)
    picked, said = [], Said()
    monkeypatch.setattr(stylize, "style_backend", lambda device: picked.append(device) or style_backend(None))
    config, bends = DesrfConfig(style="painting.png"), Deformation.create(np.random.default_rng(0))
    context = Context(device="cuda", progress=said)
    problem = stylize._problem(config, scene, field, 1.0, picture(8, 8, 1), bends, None, context, "cuda")
    assert problem.deformation is bends and picked == [None if kind == "voxel" else "cuda"]
    expected = ["features and matching run on the GPU, rays on the CPU"] if kind == "voxel" else []
    assert [line.split(":")[0] for line in said.lines] == expected


class OneLacks(ProcessGroup):
    """Three processes, one of the others without what a GPU needs."""

    count = 3

    def add(self, values: np.ndarray) -> None:
        values += 1


def test_processes_that_train_together_all_take_their_gpu_or_none(monkeypatch):
    begun = []
    monkeypatch.setattr(devices, "unavailable", lambda: None)
    monkeypatch.setattr(torch.cuda, "reset_peak_memory_stats", lambda: begun.append(1))
    assert devices.gpu_of(Context(device="cuda")) == "cuda" and begun == [1]
    with pytest.raises(OutOfResources, match=r"1 of 3 processes .* .process 0 can.; "):
        devices.gpu_of(Context(device="cuda", processes=OneLacks()))
    monkeypatch.setattr(devices, "unavailable", lambda: "Triton is not installed")
    with pytest.raises(OutOfResources, match=r"2 of 3 .*process 0 cannot: Triton is not installed"):
        devices.gpu_of(Context(device="cuda", processes=OneLacks()))
    said = Said()
    assert devices.gpu_of(Context(device="cuda", progress=said)) is None and len(said.lines) == 1


def test_where_there_is_no_device_nothing_is_said():
    said = Said()
    assert rays_on(None, field_of(AROUND, 3), Context(progress=said)) is None and not said.lines
