"""Maxima of feature maps and their gradient, against torch's."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from stylerf.kernels.cpu.pooling import max_pool, max_pool_gradient


@pytest.mark.parametrize("ceil", [False, True])
@pytest.mark.parametrize("size", [(4, 6), (5, 7), (4, 7), (9, 2), (2, 3)])
def test_maxima_and_gradients_are_those_of_torch(size, ceil):
    generator = torch.Generator().manual_seed(0)
    features = torch.rand(3, *size, generator=generator, requires_grad=True)
    expected = F.max_pool2d(features[None], 2, ceil_mode=ceil)[0]
    gradient = torch.rand(expected.shape, generator=generator)
    expected.backward(gradient)
    pooled = np.full(expected.shape, np.nan, np.float32)
    max_pool(features.detach().numpy(), pooled)
    np.testing.assert_array_equal(pooled, expected.detach().numpy())
    found = np.full(features.shape, np.nan, np.float32)
    max_pool_gradient(features.detach().numpy(), pooled, gradient.numpy(), found)
    np.testing.assert_array_equal(found, features.grad.numpy())
