"""The device engine, views and surfaces beside the CPU's: same gradients, same pictures, same loop."""

import functools

import numpy as np
import pytest
import torch

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.fields.radiance_field import RadianceField
from stylerf.fields.region_color import RegionColor
from stylerf.fields.vm import split_table
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf.rendering.rays import backward, render_rays
from stylerf.rendering.view import render_view
from stylerf.training.common.adam import NORM_STEPS
from stylerf.training.common.async_readback import BEHIND
from stylerf.training.common.process_group import ProcessGroup
from stylerf.training.fit.engine import Batch, CpuEngine, coverage_gradient, opacity_gradient
from stylerf.training.fit.fitter import Fitter
from tests.stylerf.blends import MILD
from tests.stylerf.fields.test_densities import LARGER
from tests.stylerf.small import (
    SPARSE,
    field_of,
    hash_color,
    hash_density,
    headed,
    vm_color,
    voxel_density,
    wall_in_front,
)
from tests.stylerf.training.running import resumed, run_until
from tests.stylerf.training.scenes import AROUND, CapacityLevel, box_bank, dome, masked_wall, settings


@pytest.fixture(scope="module")
def bank():
    return box_bank(4, 10)


def thin_field(space=AROUND, step=1 / 8, color=None, density=None):
    field = field_of(space, 3, color or vm_color(4), step)
    field.density = density or field.density
    field.density.values[-1] = -4.0
    return field


def batch(**more) -> Batch:
    plain = {"step": 3, "rays": 24, "parts": 1, "among": 3, "lit_share": 0.5, "background": "white", "rate": 1e-2}
    return Batch(**{**plain, "smoothness": (0.0, 0.0), "near_scaling_distance": 0.0, **more})


def engine_on(device, bank, field, clip: float = 0.0):
    from stylerf.training.fit.engine_gpu import GpuEngine

    return GpuEngine(bank, 0, 1, field, device=device, samples=400, gradient_clip=clip)


def kept_gradients(engine) -> list[torch.Tensor]:
    """Instead of steps of the optimizers: the gradients they would take."""
    found = []
    for adam in (engine.density_adam, engine.color_adam):
        adam.step = lambda rate, adam=adam: found.append(adam.gradients.clone().cpu())
    return found


FIELDS = {
    "vm": thin_field,
    "hash": lambda: thin_field(color=headed(4, "hash", "linear"), density=hash_density(3)),
    "voxel": lambda: thin_field(color=headed(4, "voxel", "linear", capacity=SPARSE), density=voxel_density(3)),
    "vm+hash-mlp": lambda: thin_field(color=headed(4, "hash", "mlp")),
}


@pytest.mark.parametrize("kinds", FIELDS)
def test_a_step_learns_the_gradient_that_the_cpu_finds_for_the_same_rays(kinds, bank, device):
    field = FIELDS[kinds]()
    engine = engine_on(device, bank, field)
    found = kept_gradients(engine)
    opacity, coverage, distortion = (0.3, 0.2, 0.1) if kinds == "vm" else (0.0, 0.0, 0.0)
    engine.learn(batch(opacity=opacity, coverage=coverage, distortion=distortion))
    learned = engine._reports.settle()
    drawn = engine.dataset.draw((0 * 1_000_003 + 3) & 0x7FFFFFFF, 0, 24, 24, 3, 0.5, 1.0)
    host = [t.cpu().numpy() for t in (drawn.rays.origins, drawn.rays.directions, drawn.rays.jitter)]
    rendered = render_rays(field, Rays.of(host[0], host[1], 0.0, host[2]), threads=1)
    rgba, out = drawn.wanted.cpu().numpy(), rendered.out
    difference = out[:, :3] + 1 - out[:, 3:4] - (rgba[:, :3] * rgba[:, 3:] + 1 - rgba[:, 3:])
    gradients = np.zeros_like(out)
    gradients[:, :3] = difference * np.float32(2 / (3 * 24))
    gradients[:, 3] = -gradients[:, :3].sum(1) + opacity_gradient(out[:, 3], opacity, 24)
    gradients[:, 3] += coverage_gradient(out[:, 3], rgba[:, 3], coverage, 24)
    to = [np.zeros((1, len(part.values)), np.float32) for part in (field.density, field.color)]
    backward(field, rendered, gradients, *to, distortion=distortion / 24)
    for ours, expected in zip(found, to):
        np.testing.assert_allclose(ours, expected[0], atol=3e-5 * np.abs(expected).max())
    assert learned.error == pytest.approx(float(np.square(difference).mean()), rel=1e-4)
    assert learned.samples_per_ray == pytest.approx(rendered.samples.total / 24, abs=0.1)


@pytest.mark.parametrize("kind", ["hash", "voxel"])
def test_a_field_that_grows_is_taken_over_and_taught_on(kind, bank, device):
    engine = engine_on(device, bank, FIELDS[kind]())
    taught = engine.field
    for name in ("density", "color"):
        setattr(taught, name, getattr(taught, name).grown(LARGER[kind], np.random.default_rng(0)))
    before, larger = taught.color.values.copy(), len(taught.density.values)
    engine.adopt(taught)
    engine.learn(batch(step=4, rate=0.01, smoothness=(1e-3, 0.0)))
    engine.refresh(0, 1)
    now = engine.field
    assert len(now.density.values) == larger > 2 * len(FIELDS[kind]().density.values)
    moved = np.abs(now.color.values - before)
    assert 0 < moved.max() < 0.01 * 15.1 and np.isfinite(now.density.values).all()
    # What stands for blocks that are not kept never learns; nor does what no ray has met.
    fixed = now.color.features.fixed
    assert not moved[:fixed].any() and (moved == 0).any()


def test_what_a_loop_looks_at_again_is_in_time_every_cell_but_clear_ones(bank, device):
    field = thin_field()
    field.occupancy = OccupancyGrid(8, clear=np.arange(512) % 7 == 0)
    engine = engine_on(device, bank, field)
    engine.refresh(0, 1)
    engine.device_field.highest.fill_(2e3)
    for step in range(320, 320 + 16 * 64, 64):  # the steps at which fit.py asks for it
        engine.refresh(step, 4)
    seen = engine.device_field.highest.cpu().numpy() < 2e3
    assert seen.all()
    assert not engine.device_field.highest.cpu().numpy()[field.occupancy.clear].any()


def test_what_no_ray_sees_is_emptied_as_on_the_cpu(bank, device):
    from stylerf.kernels.cpu.regions import mark_cells
    from stylerf.training.fit.seen_cells import PATIENCE

    engine, field = engine_on(device, bank, thin_field()), thin_field()
    engine.refresh(0, 1)
    engine.learn(batch(least_weight=0.05))
    drawn = engine.dataset.draw((0 * 1_000_003 + 3) & 0x7FFFFFFF, 0, 24, 24, 3, 0.5, 1.0)
    host = [t.cpu().numpy() for t in (drawn.rays.origins, drawn.rays.directions, drawn.rays.jitter)]
    expected = np.zeros(field.occupancy.cells**3, np.uint8)
    rendered = render_rays(field, Rays.of(host[0], host[1], 0.0, host[2]), threads=1)
    mark_cells(rendered.samples, field.occupancy.cells, np.float32(0.05), 1, expected)
    found = engine._seen.marked.cpu().numpy().copy()
    assert (found != expected).sum() <= 1 and 0 < expected.sum() < len(expected)  # one may lie at a border
    occupied = (engine.field.occupancy.distances == 0).sum()
    engine.refresh(1, 1, PATIENCE)
    arrays = {k: v.copy() for k, v in engine.moments().items()}
    kept = engine.field.occupancy.distances == 0
    assert kept.sum() < occupied and kept[found > 0].all() and not engine.device_field.highest.cpu()[~kept].any()
    again = engine_on(device, bank, engine.field)
    again.restore_moments(arrays)
    again.refresh(2, 1)
    assert np.array_equal(again.field.occupancy.distances == 0, kept)


def test_moments_stay_with_a_part_that_does(bank, device):
    engine = engine_on(device, bank, thin_field())
    engine.learn(batch())
    kept = engine.color_adam
    field = engine.field
    engine.adopt(RadianceField(field.space, thin_field().density, field.color, field.occupancy, field.step))
    assert engine.color_adam.steps == 1 and torch.equal(engine.color_adam.second, kept.second)
    assert engine.density_adam.steps == 0 and not engine.density_adam.second.any()


@pytest.mark.slow
def test_parts_smoothness_and_steps(bank, device):
    whole, cut = (engine_on(device, bank, thin_field()) for _ in range(2))
    found = [kept_gradients(engine) for engine in (whole, cut)]
    whole.learn(batch())
    cut.learn(batch(parts=2, smoothness=(0.5, 0.0)))
    extra = np.zeros(len(cut.field.density.values), np.float32)
    thin_field().density.smooth(0.5, extra)
    np.testing.assert_allclose(found[1][0] - found[0][0], extra, atol=2e-6)
    np.testing.assert_allclose(found[1][1], found[0][1], atol=1e-6)


@pytest.mark.slow
def test_what_is_learned_comes_back_and_moments_with_it(bank, device):
    engine = engine_on(device, bank, thin_field())
    before = engine.field.color.values.copy()
    assert engine.field.color.values is engine.field.color.values
    engine.learn(batch(rate=0.05))
    now = engine.field.color.values
    assert not np.array_equal(now, before) and np.abs(now - before).max() < 0.06
    moments = engine.moments()
    assert moments["density.steps"].tolist() == [1, 0] and moments["color.first"].any()
    other = engine_on(device, bank, engine.field)
    other.restore_moments(moments)
    assert torch.equal(other.color_adam.second, engine.color_adam.second) and other.density_adam.steps == 1


def test_both_parts_are_clipped_where_that_is_requested(bank, device):
    engine = engine_on(device, bank, thin_field(), clip=1.5)
    engine.learn(batch())
    for adam in (engine.density_adam, engine.color_adam):
        usual, adam.steps = float(adam.running_norm), NORM_STEPS
        assert usual > 0
        adam.gradients[:] = 0
        adam.gradients[0] = 100 * usual
        adam.step(0.0)
        assert float(adam.running_norm) == pytest.approx(1.05 * usual, rel=1e-6)


def test_held_out_views_are_judged_as_on_the_cpu(bank, device):
    field = thin_field()
    views = np.repeat(np.arange(3), 8)
    rays = bank.at(views, np.arange(24) * 4)[:2]
    expected = CpuEngine(bank, 0, 1, field).rendered(*rays)
    assert expected[:, 3].any() and expected[:, 4].any()
    np.testing.assert_allclose(engine_on(device, bank, field).rendered(*rays), expected, rtol=1e-4, atol=1e-5)


def test_what_masks_hide_in_a_closed_space_teaches_nothing(device):
    field = thin_field(masked_wall(0)[0])
    for hidden in (24, 12):
        engine = engine_on(device, masked_wall(hidden)[1], field)
        found = kept_gradients(engine)
        engine.learn(batch(among=8, lit_share=0.0))
        assert all(bool(gradients.abs().max() > 1e-6) == (hidden < 24) for gradients in found)


def test_photos_of_another_exposure_are_drawn_as_on_the_cpu(bank, device):
    engine, stops = engine_on(device, bank, thin_field()), np.array([0.5, 0.0, -0.7, 0.1])
    numbers = torch.arange(len(bank), device=device)
    views, pixels = np.repeat(np.arange(4), 100), np.tile(np.arange(100), 4)
    plain = bank.at(views, pixels)[2]
    try:
        bank.expose(stops)
        engine.follow_exposure()
        expected = bank.at(views, pixels)[2]
    finally:
        bank.expose(np.zeros(4))
    assert np.abs(expected - plain).max() > 0.1
    found = engine.dataset.at(numbers, torch.zeros(len(bank), device=device))[1]
    np.testing.assert_allclose(found.cpu().numpy(), expected, atol=1e-6)


def test_lack_of_memory_is_reported_as_the_loop_knows_it(bank, device, monkeypatch):
    engine = engine_on(device, bank, thin_field())

    def full(*arguments, **named):
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr(engine.device_field, "render_rays", full)
    engine.group, summed = ProcessGroup(), []
    engine.group.add = summed.append
    with pytest.raises(MemoryError, match="out of memory"):
        engine.learn(batch())
    assert not summed


def test_lack_of_memory_once_processes_have_summed_ends_the_run(bank, device, monkeypatch):
    """A step begun again would sum again, while the other processes are at the next one."""
    engine = engine_on(device, bank, thin_field())
    monkeypatch.setattr(engine, "_add_gradients", lambda batch, sums: None)

    def full(rate):
        raise torch.OutOfMemoryError("CUDA out of memory")

    engine.density_adam.step = full
    with pytest.raises(torch.OutOfMemoryError):
        engine.learn(batch())


def test_loss_is_reported_a_fixed_number_of_steps_late_at_any_speed(bank, device, monkeypatch):
    """What has come by chance would give the next batches another size in every run."""
    engine = engine_on(device, bank, thin_field())
    monkeypatch.setattr(
        engine, "_add_gradients", lambda given, sums: sums.copy_(torch.tensor([0.0, 10.0 * (given.step + 1), 0.0]))
    )
    reported = [engine.learn(batch(step=step, rays=10)).samples_per_ray for step in range(BEHIND + 3)]
    assert reported == [0.0] * BEHIND + [1.0, 2.0, 3.0]


def test_processes_agree_about_what_is_occupied(bank, device):
    engine, first = engine_on(device, bank, thin_field()), torch.zeros(8**3, device=device)
    first[100] = 1e3
    engine.group = ProcessGroup()
    engine.group.count = 2
    engine.group.take_first = lambda values: values.copy_(first) if values is engine.device_field.highest else None
    engine.agree()
    occupied = engine.device_field.distances == 0
    assert occupied.nonzero().flatten().tolist() == [100]
    assert np.flatnonzero(engine.field.occupancy.distances == 0).tolist() == [100]


def small_fitter(bank, device, steps=3):
    from stylerf.training.fit.engine_gpu import GpuEngine

    given = settings(steps, samples=300, levels=(CapacityLevel(8, 16, 24, 8),), level_ends=(), background="random")
    made = Fitter(AROUND, bank, 0, given, 0, 1, engine=functools.partial(GpuEngine, device=device, samples=300))
    made.state.rays = 32
    made.held_out_rays.rays = tuple(a[:32] for a in made.held_out_rays.rays)
    made.warm_up = lambda: None
    return made


@pytest.mark.slow
def test_the_loop_runs_and_resumes_on_a_device(bank, device):
    """Three steps, each a second or more in the interpreter."""
    whole = small_fitter(bank, device)
    whole.run(check_every=0.5)
    assert whole.state.step == 3 and whole.state.curve and np.isfinite(whole.state.curve[-1]["psnr"])
    part = resumed(small_fitter(bank, device), run_until(small_fitter(bank, device), 2))
    assert part.state.step == 2
    part.run(check_every=0.5)
    np.testing.assert_allclose(part.field.color.values, whole.field.color.values, atol=1e-3)


def test_a_pruning_goes_to_the_device_and_comes_back_if_it_is_refused(bank, device):
    made = small_fitter(bank, device)
    made.step()
    before, size = made.field.density.values.copy(), made.parameters
    seen = []

    def judged(quality: float):
        def psnr() -> float:
            seen.append((made.engine.device_field.density.rank, made.parameters < size))
            return quality

        return psnr

    made.held_out_psnr = judged(19.0)
    assert made._prune("density ranks", 20.0) == 20.0
    assert made.engine.device_field.density.rank == 16 and made.state.rejected == ["density ranks"]
    np.testing.assert_array_equal(made.engine.device_field.density.values.cpu(), before)
    made.held_out_psnr = judged(20.5)
    assert made._prune("density ranks", 20.0) == 20.5 and seen == [(8, True), (8, True)]
    made.step()
    assert made.engine.device_field.density.rank == made.field.density.rank == 8
    assert made.field.density.values.shape < before.shape and made.parameters < size


def test_a_view_is_the_cpus_picture(device):
    from stylerf.rendering.view_gpu import GpuRenderer

    # Steps of 1/8: no sample is within 6e-5 of a side of the region, where rounding would decide. With 1/7 one is.
    field, camera = thin_field(step=1 / 8, color=hash_color(5)), dome(1, 2, 7)[0]
    cells = np.zeros((4, 4, 4), bool)
    cells[1:3, :, 2] = True
    expected = render_view(field, camera, threads=1, regions={"one": cells})
    found = GpuRenderer(field, device, "float32", rays_at_once=30).view(camera, regions={"one": cells})
    for name in ("rgb", "alpha", "ray_distance", "z"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=2e-5)
    np.testing.assert_allclose(found.masks["one"], expected.masks["one"], atol=2e-5)
    assert expected.masks["one"].any()


@pytest.mark.parametrize(("transmittance", "backs", "ahead", "z"), [(0.02, 0, 0, 3), (0.6, 1, 0, 6), (0.02, 0, 2.3, 3)])
def test_depth_is_that_of_a_surface_whatever_light_passes_it(transmittance, backs, ahead, z, device):
    from stylerf.rendering.view_gpu import GpuRenderer

    pose = np.eye(4)
    pose[2, 3] = ahead
    field, camera = wall_in_front(transmittance, bool(backs)), Camera("view", 5, 4, 40.0, 40.0, 2.5, 2.0, pose)
    expected = render_view(field, camera, threads=1)
    found = GpuRenderer(field, device, "float32").view(camera)
    np.testing.assert_allclose(ahead + found.z, z, rtol=0.05)
    # Skips of empty cells are whole numbers of steps, 4 to a cell here: rounding decides between two of them, and a
    # sample may lie a step apart, which is z^2 / 384 of depth.
    np.testing.assert_allclose(found.z, expected.z, atol=z**2 / 384)


@pytest.mark.slow
def test_halves_are_taken_where_pixels_allow_it_and_refused_elsewhere(device):
    from stylerf.rendering.view_gpu import TOLERANCE, GpuRenderer

    field, camera = thin_field(step=1 / 6, color=hash_color(5)), dome(1, 2, 4)[0]
    made = GpuRenderer(field, device)
    rgb = made.view(camera).rgb
    assert made.half and made.field.density.table.dtype == torch.float16
    assert np.abs(rgb - render_view(field, camera, threads=1).rgb).max() <= TOLERANCE
    # What halves round away of large features that all but cancel decides how dense the fog is.
    planes, lines = split_table(field.density.table, field.density.size, field.density.rank)
    for plane, line in zip(planes, lines):
        plane[..., ::2], plane[..., 1::2], line[:] = 2000.3, -2000, 1
    field.density.values[-1] = -9.5
    exact = GpuRenderer(field, device)
    exact.view(camera)
    assert exact.half is False and exact.field.density.table.dtype == torch.float32


@pytest.mark.slow
@pytest.mark.parametrize("over", [False, True], ids=["alone", "over the field's own in a part"])
def test_fixed_surfaces_paint_and_learn_as_on_the_cpu(device, over):
    from stylerf.training.stylize.geometry import FixedGeometry
    from stylerf.training.stylize.geometry_gpu import GpuFixedGeometry

    field, cameras = thin_field(step=1 / 6), dome(2, 3, 6)
    field.density.values[-1] = -2.0
    field.color_map = MILD if over else None  # a part keeps the map of the whole
    cpu, gpu = FixedGeometry(field, cameras, 0.2, 1), GpuFixedGeometry(field, cameras, 0.2, 1, 0, device=device)
    marked = np.zeros((4, 4, 4), bool)
    marked[:, :2] = True
    field.color = RegionColor(field.color, hash_color(6), marked) if over else hash_color(6)
    adam = gpu.new_adam()
    np.testing.assert_allclose(gpu.alpha(1), cpu.alpha(1), atol=2e-5)
    assert np.array_equal(gpu.surface(1).offsets, cpu.surface(1).offsets)
    pixels = np.array([3, 30, 17, 8, 17])
    (ours, kept), (expected, held) = gpu.paint(1, pixels), cpu.paint(1, pixels)
    np.testing.assert_allclose(ours, expected, atol=2e-4)  # the CPU keeps positions in sixteen bits
    towards = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    to = np.zeros((1, len(field.color.values)), np.float32)
    cpu.learn(held, towards, to)
    gpu.learn(kept, towards, adam.gradients)
    np.testing.assert_allclose(adam.gradients.cpu(), to[0], atol=3e-3 * np.abs(to).max())
    adam.step(0.01)
    before = field.color.values.copy()
    gpu.collect()
    assert 0 < np.abs(field.color.values - before).max() < 0.011
