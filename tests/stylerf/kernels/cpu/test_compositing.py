"""Compositing, its backward, and the packing of surfaces, against the oracle and slow loops."""

import numpy as np
import pytest
import torch

from stylerf.kernels.cpu import compositing as kernels
from stylerf.kernels.cpu.color_heads import count_marked
from stylerf.kernels.cpu.ray_samples import Samples
from tests.stylerf.kernels import torch_reference
from tests.stylerf.small import close, float64

# Rays of many kinds: many samples, none, one, one opaque, many behind an opaque one, uncolored ones only.
COUNTS = (7, 0, 1, 1, 6, 3, 5)
RAYS = np.repeat(np.arange(len(COUNTS)), COUNTS)


def samples(seed=0, gap=3):
    """Packed rays with gaps of rubbish between them, as threads leave them: (starts, ends, at, arrays)."""
    generator = np.random.default_rng(seed)
    starts = np.concatenate([[0], np.cumsum(np.array(COUNTS) + gap)[:-1]]).astype(np.int64)
    ends = starts + COUNTS
    at = np.concatenate([np.arange(a, b) for a, b in zip(starts, ends)])
    n = int(ends[-1])
    deltas = generator.uniform(0.2, 2, n).astype(np.float32)
    sigma = generator.uniform(0, 0.8, n).astype(np.float32)
    t = np.sort(generator.uniform(1, 9, n)).astype(np.float32)
    colors = generator.random((n, 3)).astype(np.float32)
    sigma[starts[3]] = 1e5
    sigma[starts[4] + 2] = 1e5
    colors[at[generator.random(len(at)) < 0.4], 0] = -1
    colors[starts[5] : ends[5], 0] = -1
    colors[starts[3], 0] = 0.3
    deltas[ends[6] - 1], sigma[ends[6] - 1] = 0, 0  # the opaque background
    rubbish = np.setdiff1d(np.arange(n), at)
    for array in (deltas, sigma, t, colors):
        array[rubbish] = np.nan
    return starts, ends, at, deltas, sigma, t, colors


def packed_samples(starts, ends, t, deltas, sigma, weights, x=None) -> Samples:
    x = np.zeros((len(t), 3), np.float32) if x is None else x
    return Samples(starts, ends, t, deltas, x, sigma, weights)


def reference(at, deltas, sigma, t, colors):
    """The oracle's weights and pixels, with leaves for gradients."""
    s, c = float64(sigma[at]).requires_grad_(), float64(colors[at]).requires_grad_()
    rays, length = torch.from_numpy(RAYS), float64(deltas[at])
    w, _ = torch_reference.weights(s, length, rays, length == 0)
    colored = torch.from_numpy(colors[at, 0] >= 0)
    return (
        s,
        c,
        w,
        torch_reference.composite(w, c, colored, torch.where(length == 0, 0, float64(t[at])), rays, len(COUNTS)),
    )


@pytest.mark.parametrize("threads", [1, 3])
def test_pixels_and_gradients_equal_the_oracle(threads):
    starts, ends, at, deltas, sigma, t, colors = samples()
    s, c, w, expected = reference(at, deltas, sigma, t, colors)
    weights = np.full(len(sigma), np.nan, np.float32)
    weights[at] = w.detach()
    out = np.full((len(COUNTS), 5), np.nan, np.float32)
    packed = packed_samples(starts, ends, t, deltas, sigma, weights)
    kernels.composite(packed, colors, threads, out)
    close(out, expected, 1e-6)
    assert not out[1].any() and (out[5, :3] == 0).all() and out[5, 3] > 0
    gradients = np.random.default_rng(1).normal(size=out.shape).astype(np.float32)
    (expected * float64(gradients)).sum().backward()
    to_sigma, to_colors = np.full_like(sigma, np.nan), np.full_like(colors, np.nan)
    kernels.composite_backward(packed, colors, out, gradients, threads, to_sigma, to_colors)
    # What is left behind a sample is one minus float32 weights: an opaque ray's gradients carry that rounding.
    close(to_sigma[at], s.grad, 1e-5)
    lit = at[colors[at, 0] >= 0]
    close(to_colors[lit], c.grad[colors[at, 0] >= 0], 1e-6)


@pytest.mark.parametrize("threads", [1, 3])
def test_gradients_of_the_distortion_equal_those_of_its_double_sum(threads):
    starts, ends, at, deltas, sigma, t, colors = samples()
    s, _, w, _ = reference(at, deltas, sigma, t, colors)
    weights = np.full(len(sigma), np.nan, np.float32)
    weights[at] = w.detach()
    strength, middle = 0.3, 2.5
    depth = float64(t[at]) / (float64(t[at]) + middle)
    pairs = w[:, None] * w[None] * (depth[:, None] - depth[None]).abs()
    (strength * pairs[RAYS[:, None] == RAYS[None]].sum()).backward()
    to = np.zeros_like(sigma)
    packed = packed_samples(starts, ends, t, deltas, sigma, weights)
    for _ in range(2):  # it adds
        kernels.distortion_backward(packed, np.float32(strength), np.float32(middle), threads, to)
    close(to[at], 2 * s.grad, 1e-5)
    assert (s.grad != 0).any() and to[ends[6] - 1] == 0  # the background's density is fixed


@pytest.mark.parametrize("threads", [1, 3])
def test_distance_is_the_mean_of_samples_around_half_the_weight(threads):
    starts, ends, at, deltas, sigma, t, colors = samples()
    weights = np.full(len(sigma), np.nan, np.float32)
    weights[at] = reference(at, deltas, sigma, t, colors)[2].detach()
    t[starts[0] + 1] = 1.01 * t[starts[0]]
    weights[starts[0] : ends[0]] = [0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05]
    weights[starts[6] : ends[6]] = 0
    out = np.full((len(COUNTS), 5), np.nan, np.float32)
    out[:, 3] = [weights[first:end].sum() for first, end in zip(starts, ends)]
    kernels.surface_distance(packed_samples(starts, ends, t, deltas, sigma, weights), threads, out)
    found = out[:, 4]
    expected = []
    for first, end in zip(starts, ends):
        w, far = weights[first:end].astype(float), t[first:end].astype(float)
        middle = far[min(np.searchsorted(np.cumsum(w), 0.5 * w.sum() * (1 - 1e-6)), len(w) - 1)] if len(w) else 0.0
        around = w * (np.abs(far - middle) <= 0.05 * middle)
        expected.append((around * far).sum() / around.sum() if around.any() else 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert found[0] == pytest.approx(t[starts[0]] * (0.3 + 0.2 * 1.01) / 0.5, rel=1e-5)
    assert found[1] == 0 and found[6] == 0 and found[3] == t[starts[3]]


def test_background_and_samples_behind_opaque_ones_give_no_gradient():
    starts, ends, at, deltas, sigma, t, colors = samples()
    _, _, w, _ = reference(at, deltas, sigma, t, colors)
    weights = np.zeros_like(sigma)
    weights[at] = w.detach()
    out, gradients = np.empty((len(COUNTS), 5), np.float32), np.ones((len(COUNTS), 5), np.float32)
    packed = packed_samples(starts, ends, t, deltas, sigma, weights)
    kernels.composite(packed, colors, 1, out)
    to_sigma, to_colors = np.empty_like(sigma), np.empty_like(colors)
    kernels.composite_backward(packed, colors, out, gradients, 1, to_sigma, to_colors)
    assert to_sigma[ends[6] - 1] == 0
    np.testing.assert_allclose(to_sigma[starts[4] + 3 : ends[4]], 0, atol=1e-5)


@pytest.mark.parametrize("threads", [1, 3])
def test_gradients_of_near_samples_fall_with_the_square_of_the_distance(threads):
    starts, ends, at, _, sigma, t, colors = samples()
    to_sigma, to_colors = sigma + 1, colors + 1
    before = to_sigma.copy(), to_colors.copy()
    kernels.scale_near_gradients(
        packed_samples(starts, ends, t, t, sigma, sigma), np.float32(5), threads, to_sigma, to_colors
    )
    share = np.minimum(1, (t[at] / 5) ** 2)
    assert (share < 0.9).any() and (share == 1).any()
    np.testing.assert_allclose(to_sigma[at], before[0][at] * share, rtol=1e-6)
    np.testing.assert_allclose(to_colors[at], before[1][at] * share[:, None], rtol=1e-6)
    rubbish = np.setdiff1d(np.arange(len(sigma)), at)
    assert np.array_equal(to_sigma[rubbish], before[0][rubbish], equal_nan=True)


def test_visible_weights_keep_the_largest_and_drop_the_small():
    weights = np.float32([0.5, 0.01, 0.0099, 0.2, 0.3, 0.1, 0, 0, 0.7])
    starts, ends = np.array([0, 3, 6, 8, 9]), np.array([3, 6, 8, 9, 9])
    shown = np.full(9, np.nan, np.float32)
    packed = packed_samples(starts, ends, weights, weights, weights, weights)
    kernels.visible_weights(packed, np.float32(0.02), 2, shown)
    assert shown.tolist() == np.float32([0.5, 0.01, 0, 0.2, 0.3, 0.1, 0, 0, 0.7]).tolist()
    kernels.visible_weights(packed, np.float32(1), 1, shown)
    assert shown.tolist() == np.float32([0.5, 0, 0, 0, 0.3, 0, 0, 0, 0.7]).tolist()
    counts = np.empty(5, np.int64)
    count_marked(shown.reshape(-1, 1), np.float32(0), starts, ends, 2, counts)
    assert counts.tolist() == [1, 1, 0, 1, 0]


@pytest.mark.parametrize("threads", [1, 2])
def test_packing_and_unpacking_equal_a_loop(threads):
    generator = np.random.default_rng(3)
    starts, ends = np.array([2, 10, 10, 17]), np.array([8, 10, 14, 18])
    weights, x = generator.random(18).astype(np.float32) * 0.2, generator.random((18, 3)).astype(np.float32)
    x[2], x[3] = 0, 1
    shown = np.where(generator.random(18) < 0.5, weights, 0).astype(np.float32)
    shown[2:4], shown[17] = weights[2:4], weights[17]
    kept = [[k for k in range(a, b) if shown[k] > 0] for a, b in zip(starts, ends)]
    offsets = np.concatenate([[0], np.cumsum([len(k) for k in kept])])
    packed_x, packed_weights = np.empty((offsets[-1], 3), np.uint16), np.empty(offsets[-1], np.float32)
    packed = packed_samples(starts, ends, weights, weights, weights, weights, x)
    kernels.pack_visible(shown, packed, offsets, threads, packed_x, packed_weights)
    for r, ks in enumerate(kept):
        scale = weights[starts[r] : ends[r]].sum() / max(shown[ks].sum(), 1e-9)
        np.testing.assert_allclose(packed_weights[offsets[r] : offsets[r + 1]], shown[ks] * scale, rtol=1e-6)
        assert np.array_equal(packed_x[offsets[r] : offsets[r + 1]], np.floor(x[ks] * np.float32(65535) + 0.5))
    assert packed_x[0].tolist() == [0] * 3 and packed_x[1].tolist() == [65535] * 3
    pixels = np.array([3, 0, 1, 0])
    counts = np.diff(offsets)[pixels]
    first = np.cumsum(counts) - counts
    out_x, out_w = np.empty((counts.sum(), 3), np.float32), np.empty(counts.sum(), np.float32)
    kernels.unpack(pixels, offsets, packed_x, packed_weights, first, out_x, out_w)
    wanted = [k for p in pixels for k in kept[p]]
    np.testing.assert_allclose(out_x, x[wanted], atol=0.5 / 65535 + 1e-7)
    assert out_x.min() == 0 and out_x.max() == 1
    assert np.array_equal(out_w, np.concatenate([packed_weights[offsets[p] : offsets[p + 1]] for p in pixels]))


def test_shade_and_its_backward_equal_the_oracle():
    starts, ends, at, _, sigma, t, colors = samples(4)
    colors[at] = np.abs(colors[at])
    weights = np.random.default_rng(5).random(len(sigma)).astype(np.float32)
    out = np.empty((len(COUNTS), 3), np.float32)
    points = packed_samples(starts, ends, t, t, sigma, weights).shading_points()
    kernels.shade(points, colors, out)
    c = float64(colors[at]).requires_grad_()
    everything = torch.ones(len(at), dtype=torch.bool)
    rays = torch.from_numpy(RAYS)
    expected = torch_reference.composite(float64(weights[at]), c, everything, float64(t[at]), rays, len(COUNTS))[:, :3]
    close(out, expected, 1e-6)
    gradients = np.random.default_rng(6).normal(size=out.shape).astype(np.float32)
    (expected * float64(gradients)).sum().backward()
    to_colors = np.full_like(colors, np.nan)
    kernels.shade_backward(points, gradients, to_colors)
    close(to_colors[at], c.grad, 1e-6)
    assert np.isnan(np.delete(to_colors, at, 0)).all()
