"""The device of the GPU kernels' tests: a GPU where there is one, else CPU tensors and Triton's interpreter."""

import pytest

from tests.stylerf.kernels.gpu.bounds import bounds_checked


@pytest.fixture(scope="session")
def device(interpreter):
    pytest.importorskip("triton", reason="Triton is not installed: pip install -e '.[test]' brings it on Linux")
    import torch

    from stylerf.kernels.gpu import interpreted

    if torch.cuda.is_available() and not interpreted():
        yield torch.device("cuda")
        return
    if not interpreted():
        pytest.skip("no GPU, and TRITON_INTERPRET was not set before Triton was imported")
    with bounds_checked():
        yield torch.device("cpu")
