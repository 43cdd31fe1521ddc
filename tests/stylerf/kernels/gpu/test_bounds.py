"""The check of bounds catches a kernel that reaches beyond its tensors."""

import pytest
import torch


@pytest.mark.parametrize("what", ["load", "store", "atomic"])
def test_a_kernel_that_leaves_its_tensors_is_caught(device, what):
    if device.type != "cpu":
        pytest.skip("bounds are checked in Triton's interpreter")
    from stylerf.kernels.gpu import launch
    from tests.stylerf.kernels.gpu import leaving

    values = torch.zeros(64)
    kernel = getattr(leaving, f"{what}_kernel")
    launch.over(kernel, 64, 64, values, 64)
    with pytest.raises(Exception, match="1 of 64 addresses"):
        launch.over(kernel, 64, 64, values[:63], 64)
