"""A picture whose pixels learn: as torch's own Adam does it; coverage, bounds, going on."""

import numpy as np
import torch

from stylerf.style.image_optimization import ImageOptimization, painted
from tests.stylerf.style.small_trunk import picture

WANTED = picture(6, 8, 2)


def towards(image: torch.Tensor):
    loss = (image - WANTED).square().sum()
    return loss, {"style": float(loss.detach())}


def test_steps_are_those_of_adam():
    made, other = ImageOptimization(picture(6, 8, 1), None, 0.0, 0.01), picture(6, 8, 1).requires_grad_()
    adam = torch.optim.Adam([other], lr=0.01, betas=(0.9, 0.99), eps=1e-8)
    for _ in range(7):
        made.step(towards)
        adam.zero_grad()
        towards(other)[0].backward()
        adam.step()
    assert float((made.colors - other.detach()).abs().max()) < 1e-6


def test_what_is_not_covered_stays_background_and_half_of_it_half():
    alpha = torch.zeros(6, 8)
    alpha[:3], alpha[3] = 1, 0.5
    start = alpha * picture(6, 8, 1) + (1 - alpha) * 0.7
    made = ImageOptimization(start, alpha, 0.7, 0.05)
    assert float((made.seen() - start).abs().max()) < 1e-6
    for _ in range(60):
        made.step(towards)
    assert float((made.seen()[:, 4:] - 0.7).abs().max()) < 1e-6
    assert float((made.seen()[:, :3] - WANTED[:, :3]).abs().max()) < 0.03
    assert float((made.seen()[:, 3] - 0.35).min()) >= -1e-6 and float(made.seen()[:, 3].max()) <= 0.85 + 1e-6
    assert 0 <= float(made.colors.min()) and float(made.colors.max()) <= 1


def test_of_a_part_alone_the_rest_stays_the_picture_that_it_began_as():
    alpha, start = torch.zeros(6, 8), picture(6, 8, 1)
    alpha[:3] = 1
    made = ImageOptimization(start, alpha, start, 0.05)
    for _ in range(60):
        made.step(towards)
    assert torch.equal(made.seen()[:, 3:], start[:, 3:])
    assert float((made.seen()[:, :3] - WANTED[:, :3]).abs().max()) < 0.03


def test_a_picture_that_was_put_aside_goes_on_to_the_same_bits():
    whole, first = (ImageOptimization(picture(6, 8, 1), None, 0.0, 0.02) for _ in range(2))
    for at in range(6):
        whole.step(towards, 1 - at / 6)
    for at in range(4):
        first.step(towards, 1 - at / 6)
    second = ImageOptimization(picture(6, 8, 1), None, 0.0, 0.02)
    second.restore({k: v.copy() for k, v in first.arrays().items()})
    for at in range(4, 6):
        second.step(towards, 1 - at / 6)
    assert np.array_equal(second.pixels(), whole.pixels())
    found, parts = painted(picture(6, 8, 1), None, 0.0, towards, 6, 0.02)
    assert np.array_equal(found, whole.pixels()) and parts["style"] < towards(picture(6, 8, 1))[1]["style"]
