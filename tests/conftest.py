"""Shared fixtures: where the real scenes are, a small source to import."""

import os
import signal
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

from tests.stylerf.kernels.gpu.patched_once import patched_once
from tests.stylerf_cli import capture

REPOSITORY = Path(__file__).resolve().parent.parent

# Asked of the driver alone: CUDA, once begun in this process, could not be used in one that it forks.
os.environ.setdefault("PYTORCH_NVML_BASED_CUDA_CHECK", "1")
# Triton reads this when it is first imported: without a GPU its kernels are tested through its interpreter.
if torch.version.cuda is None or not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")
torch.backends.cudnn.allow_tf32 = False  # as where the command chooses CUDA: tolerances are those of float32

# A shell that starts the tests in the background has SIGINT ignored, and every child would inherit that: Ctrl-C is
# tested on children.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real scenes (STYLERF_DATA, or ../shared/data beside the repository); skips where there is none."""
    folder = Path(os.environ.get("STYLERF_DATA", REPOSITORY.parent / "shared" / "data"))
    if not (folder / "lego" / "transforms_train.json").is_file():
        pytest.skip(f"real scenes not found in {folder}; set STYLERF_DATA to run this test")
    return folder


@pytest.fixture
def tmp_path(tmp_path):
    """A fresh folder, in memory where there is such a place: all that is written is flushed, which a busy disk makes
    slow."""
    if not os.access("/dev/shm", os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        yield Path(folder)


@pytest.fixture(scope="session")
def interpreter() -> Iterator[None]:
    """Triton's interpreter, quicker, for tests whose kernels run in it; nothing where there is a GPU or no Triton."""
    if os.environ.get("TRITON_INTERPRET") != "1" or find_spec("triton") is None:
        yield
        return
    with patched_once():
        yield


@pytest.fixture
def source(tmp_path) -> Path:
    """Four photos without poses, images/p00.png to p03.png, 48 x 36."""
    capture.write_images(tmp_path / "source")
    return tmp_path / "source"


@pytest.fixture
def posed(source) -> Path:
    """The same with a sound transforms.json."""
    capture.write_transforms(source, capture.transforms())
    return source
