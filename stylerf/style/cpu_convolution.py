"""3x3 convolutions with ReLU, and 2x2 max pooling, on the CPU with frozen weights: gradients flow only to the image.

The convolutions use NNPACK's Winograd transforms, which PyTorch ships but by default uses only for batches: a quarter
of a direct convolution's multiplications. Features and their gradient take half to two thirds of the time of oneDNN's
direct convolutions (benchmarks/results/extractor.json).
"""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.kernels.cpu.pooling import max_pool, max_pool_gradient


class FrozenConvolution(NamedTuple):
    """Weights of a convolution.

    Attributes:
        weight: [out, in, 3, 3].
        bias: [out].
        transposed: [in, out, 3, 3], flipped: the convolution of the backward pass.
        none: Zeros [in], the bias of that convolution.
    """

    weight: Tensor
    bias: Tensor
    transposed: Tensor
    none: Tensor


def frozen(weight: Tensor, bias: Tensor) -> FrozenConvolution:
    """Prepare a convolution with weight [out, in, 3, 3] and bias [out]."""
    transposed = weight.flip(2, 3).transpose(0, 1).contiguous()
    return FrozenConvolution(weight.contiguous(), bias, transposed, torch.zeros(weight.shape[1]))


@cache
def winograd_available() -> bool:
    """Whether this build of PyTorch has NNPACK and this processor supports it. The check also initializes NNPACK."""
    return bool(torch._nnpack_available())


def convolve_relu(image: Tensor, layer: FrozenConvolution) -> Tensor:
    """Return relu(convolution of image [1, c, h, w]), zero-padded by one pixel, [1, out, h, w]."""
    return _ConvolveRelu.apply(image, layer)


class _ConvolveRelu(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, layer: FrozenConvolution) -> Tensor:
        found = _convolve(image.contiguous(), layer.weight, layer.bias).clamp_min_(0)
        ctx.save_for_backward(found)
        ctx.layer = layer
        return found

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        (found,) = ctx.saved_tensors
        gradient = torch.ops.aten.threshold_backward(gradients[0].contiguous(), found, 0)
        return _convolve(gradient, ctx.layer.transposed, ctx.layer.none), None


def _convolve(image: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    # With few channels, the transforms cost more than they save.
    if min(weight.shape[:2]) < 16:
        return F.conv2d(image, weight, bias, padding=1)
    return torch._nnpack_spatial_convolution(image, weight, bias, padding=1)


def max_pool_of_relu(features: Tensor, ceil: bool) -> Tensor:
    """Return 2x2 max pooling with stride 2 of features [1, c, h, w] >= 0; ceil: round odd sizes up, else down."""
    return _MaxPool.apply(features, ceil)


class _MaxPool(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, ceil: bool) -> Tensor:
        features = features.contiguous()
        height, width = (-(-side // 2) if ceil else side // 2 for side in features.shape[2:])
        pooled = torch.empty(1, features.shape[1], height, width)
        max_pool(_array(features), _array(pooled))
        ctx.save_for_backward(features, pooled)
        return pooled

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        features, pooled = ctx.saved_tensors
        out = torch.empty_like(features)
        max_pool_gradient(_array(features), _array(pooled), _array(gradients[0].contiguous()), _array(out))
        return out, None


def _array(features: Tensor) -> np.ndarray:
    return features.detach()[0].numpy()
