"""Adam, hash rows, smoothing, drawn rays and the occupancy's distances, each against an answer of its own."""

import numpy as np
import pytest
import torch

from stylerf.fields.occupancy_grid import OccupancyGrid
from stylerf.training.common.adam import Adam
from stylerf.training.common.ray_dataset import RayDataset
from tests.stylerf.kernels import torch_reference
from tests.stylerf.small import close, density, float64, hash_color, vm_color
from tests.stylerf.training.scenes import box_bank


def test_adam_equals_the_cpus_and_skips_runs_without_gradient(device):
    from stylerf.training.common.adam_gpu import GpuAdam

    generator, n = np.random.default_rng(0), 1003
    values = generator.normal(size=n).astype(np.float32)
    cpu = Adam(values.copy(), [(0, 500, 1.0), (500, n, 0.5)], 1)
    gpu = GpuAdam(torch.from_numpy(values.copy()).to(device), cpu.groups)
    first = values
    for step in range(3):
        gradient = generator.normal(size=n).astype(np.float32)
        # A multiple of eight from 200 to 400 had a gradient in the first step alone, and has momentum.
        gradient[200:400] *= step == 0
        cpu.gradients[0], gpu.gradients[:] = gradient, torch.from_numpy(gradient).to(device)
        cpu.step(0.1 / (step + 1))
        gpu.step(0.1 / (step + 1))
        first = gpu.values.cpu().numpy().copy() if step == 0 else first
    np.testing.assert_allclose(gpu.values.cpu(), cpu.values, rtol=2e-6, atol=2e-6)
    assert np.array_equal(gpu.values.cpu()[200:400], first[200:400]) and not gpu.gradients.any()
    again = GpuAdam(gpu.values, cpu.groups)
    again.restore(gpu.arrays())
    assert again.steps == 3 and torch.equal(again.second, gpu.second)


def test_processes_that_train_together_are_reported_of_the_same_step(device):
    from stylerf.training.common.async_readback import BEHIND, AsyncReadback

    readback = AsyncReadback(device, 1, lambda sums, note: (sums[0], note), None, in_step=True)
    for step in range(BEHIND + 4):
        readback.begin().fill_(step)
        assert readback.send(step) == (None if step < BEHIND else (step - BEHIND, step - BEHIND))
    assert readback.settle() == (BEHIND + 3, BEHIND + 3)


def test_a_gradient_of_nan_is_no_zero(device):
    from stylerf.training.common.adam_gpu import GpuAdam

    made = GpuAdam(torch.ones(16, device=device), [(0, 16, 1.0)])
    made.gradients[3] = float("nan")
    made.step(0.1)
    assert made.values.isnan().tolist() == [k == 3 for k in range(16)]


def test_gradients_are_clipped_and_skipped_if_not_finite_as_on_the_cpu(device):
    from stylerf.training.common.adam_gpu import GpuAdam

    generator, n = np.random.default_rng(1), 300
    cpu = Adam(np.zeros(n, np.float32), [(0, n, 1.0)], 1, 2.0)
    gpu = GpuAdam(torch.zeros(n, device=device), cpu.groups, 2.0)
    for longer in (1.0, 1.5, 50.0, float("nan"), 0.0, float("inf"), 1.0):
        gradient = generator.normal(size=n).astype(np.float32) * np.float32(longer)
        cpu.gradients[0], gpu.gradients[:] = gradient, torch.from_numpy(gradient).to(device)
        cpu.step(0.1)
        gpu.step(0.1)
        assert float(gpu.running_norm) == pytest.approx(cpu.running_norm, rel=1e-6)
        np.testing.assert_allclose(gpu.first.cpu(), cpu.first, rtol=2e-5, atol=2e-6)
    again = GpuAdam(gpu.values, cpu.groups, 2.0)
    again.restore(gpu.arrays())
    assert float(again.running_norm) == float(gpu.running_norm) > 0


def test_hash_rows_and_their_gradient_equal_the_oracle(device):
    from stylerf.kernels.gpu import hash_color as kernels

    made, x = hash_color(3), np.random.default_rng(1).random((40, 3), dtype=np.float32)
    x[0], x[1] = 0, 1
    values, points = (torch.from_numpy(a).to(device) for a in (made.values, x))
    layout = torch.from_numpy(made.layout).to(device)
    out = torch.empty((40, 32), device=device)
    kernels.rows_kernel[(1,)](values, layout, points, out, 40, LEVELS=8, BLOCK=64)
    exact = float64(made.values).requires_grad_()
    expected = torch_reference.hash_levels(exact, 8, made.base, made.finest, made.table, float64(x)).flatten(1)
    np.testing.assert_allclose(out.cpu(), expected.detach(), atol=2e-6)
    towards = torch.from_numpy(np.random.default_rng(2).normal(size=(40, 32)))
    (expected * towards).sum().backward()
    to = torch.zeros_like(values)
    kernels.rows_backward_kernel[(1,)](layout, points, towards.float().to(device), to, 40, LEVELS=8, BLOCK=64)
    close(to.cpu(), exact.grad, 5e-6)


@pytest.mark.parametrize("make", [lambda: density(1), lambda: vm_color(2), lambda: hash_color(3)])
def test_smoothing_equals_the_cpus(make, device):
    from stylerf.fields.gpu import parts

    part = make()
    kinds = parts.DENSITY_KINDS if part.values.size == density(1).values.size else parts.COLOR_KINDS
    cpu = np.full(len(part.values), 0.25, np.float32)
    part.smooth(0.7, cpu)
    to = torch.full((len(part.values),), 0.25, device=device)
    kinds[part.kind](part, device).smooth(0.7, to)
    np.testing.assert_allclose(to.cpu(), cpu, rtol=1e-5, atol=1e-6)


def test_drawn_rays_are_those_of_pixels_of_the_photos(device):
    from stylerf.training.common.ray_dataset_gpu import GpuRayDataset

    bank = box_bank(5, 12)
    made = GpuRayDataset(bank, device)
    drawn = made.draw(7, 0, 500, 500, 3, 0.5, 1.0)
    origins, directions, colors = bank.at(*np.divmod(np.arange(3 * 144), 144))
    # Each ray is one pixel's of the first three views, with its color.
    ways = drawn.rays.directions.cpu().numpy()
    pixel = np.array([np.abs(directions - way).max(1).argmin() for way in ways])
    np.testing.assert_allclose(ways, directions[pixel], atol=1e-6)
    np.testing.assert_allclose(drawn.rays.origins.cpu(), origins[pixel], atol=1e-6)
    np.testing.assert_allclose(drawn.wanted.cpu(), colors[pixel], atol=1e-6)
    lit = bank.lit[np.arange(bank.lit.below(len(bank)))]
    assert np.isin(pixel[:250], lit).all() and not np.isin(pixel[250:], lit).all()
    assert len(np.unique(pixel)) > 200 and {0, 1, 2} == set((pixel // 144).tolist())
    for evenly, below in ((pixel[250:], 3 * 144), (np.searchsorted(lit, pixel[:250]), bank.lit.below(3 * 144))):
        assert np.histogram(evenly, 8, (0, below))[0].std() < 2  # independent draws: 5
    jitter = drawn.rays.jitter.cpu()
    assert 0 <= float(jitter.min()) and float(jitter.max()) < 1 and abs(float(jitter.mean()) - 0.5) < 0.05
    assert bool((drawn.background == 1).all())


def test_photos_are_brought_over_little_by_little_and_let_go_of_between(device, monkeypatch):
    from stylerf.training.common import ray_dataset_gpu
    from stylerf.training.common.ray_dataset import STRETCH, Pixels

    plain, read = box_bank(5, 12), []
    bank = RayDataset(plain.cameras, Pixels(plain.bytes, plain.channels, read.append))
    read.clear()  # of the look at the alphas
    monkeypatch.setattr(ray_dataset_gpu, "AT_ONCE", 100)
    made = ray_dataset_gpu.GpuRayDataset(bank, device)
    assert len(read) == -(-len(plain.bytes) // 100) and set(read) == {-(-100 // STRETCH)}
    assert np.array_equal(made.photos.bytes.cpu(), plain.bytes)
    lit = plain.lit[np.arange(plain.lit.below(len(plain)))]
    assert len(lit) > 200 and np.array_equal(made.photos.lit.cpu(), lit) and made.photos.lit.dtype == torch.int32


def test_a_batch_depends_on_the_seed_and_not_on_how_it_is_split(device):
    from stylerf.training.common.ray_dataset_gpu import GpuRayDataset

    made = GpuRayDataset(box_bank(4, 8), device)
    whole = made.draw(7, 0, 90, 90, 4, 0.5, None)
    parts = [made.draw(7, first, count, 90, 4, 0.5, None) for first, count in ((0, 40), (40, 50))]
    for of in (lambda d: d.rays.directions, lambda d: d.wanted, lambda d: d.background, lambda d: d.rays.jitter):
        assert torch.equal(of(whole), torch.cat([of(part) for part in parts]))
    assert not torch.equal(whole.background, made.draw(8, 0, 90, 90, 4, 0.5, None).background)
    assert 0.3 < float(whole.background.mean()) < 0.7 and float(whole.background.std()) > 0.2


def test_a_batch_continues_the_draws_of_the_batches_before(device):
    from stylerf.training.common.ray_dataset_gpu import GpuRayDataset

    made = GpuRayDataset(box_bank(4, 8), device)
    whole = made.draw(7, 0, 90, 90, 4, 0.5, 1.0, 3)
    parts = [made.draw(seed, 0, count, count, 4, 0.5, 1.0, 3, at) for seed, at, count in ((1, 0, 40), (2, 40, 50))]
    # Half of each batch is near the object, and continues that half of the batches before.
    order = [*range(20), *range(40, 65), *range(20, 40), *range(65, 90)]
    joined = torch.cat([part.rays.directions for part in parts])[order]
    torch.testing.assert_close(joined, whole.rays.directions)
    assert not torch.equal(whole.rays.directions, made.draw(7, 0, 90, 90, 4, 0.5, 1.0, 4).rays.directions)
    made.draw(7, 0, 90, 90, 4, 0.5, 1.0, 3, 10**11)  # the shift is taken modulo 2^32


def test_distances_are_scipys_and_never_beyond(device):
    from stylerf.fields.gpu.field import distances_to

    full, exact = np.random.default_rng(0).random((12, 12, 12)) < 0.004, OccupancyGrid(12)
    assert full.any()
    exact.set_occupied(full.ravel())
    there = torch.from_numpy(full).to(device)
    assert np.array_equal(distances_to(there).cpu().numpy().ravel(), exact.distances)
    assert np.array_equal(distances_to(there, 3).cpu().numpy().ravel(), np.minimum(exact.distances, 3))


def test_the_occupancy_looks_where_it_should_and_decides_as_the_cpus_does(device):
    from stylerf.fields.gpu.field import GpuField, refresh
    from tests.stylerf.small import SPACES, field_of

    field = field_of(SPACES["box"], 3)
    made = GpuField(field, device)
    refresh(made, 5, 1, 0.9)
    assert bool(torch.isfinite(made.highest).all())
    # Each cell holds the density of one point in it: nowhere beyond the densest of many points.
    places = torch.rand((4000, 3), generator=torch.Generator().manual_seed(1)).to(device)
    assert float(made.highest.max()) <= 1.5 * float(made.density.sigma(places).max())
    field.occupancy.highest[:] = made.highest.cpu().numpy()
    field.occupancy.decide(field.step)
    assert np.array_equal(made.distances.cpu().numpy(), np.minimum(field.occupancy.distances, 32))
    before = made.highest.clone()
    refresh(made, 6, 4, 0.5)
    same = (made.highest == before).float().mean()
    assert 0.7 < float(same) < 0.8 and bool((made.highest >= 0.5 * before * (1 - 1e-6)).all())
    clear = np.arange(field.occupancy.cells**3) % 3 == 0
    field.occupancy.clear = clear
    carved = GpuField(field, device)
    refresh(carved, 5, 1, 0.9)
    field.occupancy.decide(field.step)
    assert np.array_equal(carved.distances.cpu().numpy(), np.minimum(field.occupancy.distances, 32))
    assert not (carved.distances.cpu().numpy() == 0)[clear].any()


def test_the_occupancy_forgets_no_density_at_once_however_high(device):
    from stylerf.fields.gpu.field import GpuField, refresh
    from tests.stylerf.small import SPACES, field_of

    made = GpuField(field_of(SPACES["box"], 3), device)
    assert bool(torch.isinf(made.highest).all())
    made.density.sigma = lambda x: torch.full((len(x),), 3e4, device=x.device)
    refresh(made, 0, 1, 0.9)
    made.density.sigma = lambda x: torch.zeros(len(x), device=x.device)
    refresh(made, 1, 1, 0.9)
    assert bool(torch.isfinite(made.highest).all()) and float(made.highest.min()) > 1e3
