"""A codec that cannot write although the disk takes the bytes once more is a disk that fails: the run can go on. One
that has lost bytes without a word is found out."""

import errno
from contextlib import contextmanager

import numpy as np
import pytest

from schemas import atomic_write, exr, images
from schemas.errors import OutOfResources
from schemas.exr import ExrView, write_exr
from schemas.images import write_png
from stages.run.runner import refusal_of_machine
from stages.sfm import photo_copies


def view() -> ExrView:
    flat = np.ones((4, 6), np.float32)
    return ExrView(np.ones((4, 6, 3), np.float32), flat, flat, flat, np.eye(4), (5, 5, 3, 2), 0.1, 9.0)


@pytest.mark.parametrize(
    ("module", "write"),
    [
        (images, lambda path: write_png(path, np.zeros((4, 6, 3), np.uint8))),
        (exr, lambda path: write_exr(path, view())),
        (photo_copies, lambda path: photo_copies.write_jpeg(path, np.zeros((4, 6, 3), np.uint8))),
    ],
)
def test_a_writer_that_fails_for_a_moment_leaves_a_run_that_can_go_on(module, write, tmp_path, monkeypatch):
    @contextmanager
    def nowhere(path):
        yield tmp_path / "gone" / path.name

    monkeypatch.setattr(module, "replacing", nowhere)
    monkeypatch.setattr(module, "refusal_of_disk", lambda path, size: None, raising=False)
    with pytest.raises(OSError, match="writer failed") as met:
        write(tmp_path / "x.png")
    assert met.value.errno == errno.EIO and met.value.filename == str(tmp_path / "x.png")
    assert isinstance(refusal_of_machine(met.value, tmp_path), OutOfResources)


@pytest.mark.parametrize("lost", [slice(0, 4096), slice(4096, 8192), slice(-20, None)])
def test_a_png_that_lacks_what_the_disk_refused_is_no_png(lost, tmp_path, monkeypatch):
    """libpng writes through buffers of 4096 bytes, and OpenImageIO does not hear of one that was refused."""
    pixels = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    write_png(tmp_path / "sound.png", pixels)
    whole = (tmp_path / "sound.png").read_bytes()
    assert images.png_is_whole(tmp_path / "sound.png")
    real = images.png_is_whole

    def refused(path):
        path.write_bytes(whole[: lost.start] + (whole[lost.stop :] if lost.stop else b""))
        return real(path)

    monkeypatch.setattr(images, "png_is_whole", refused)
    monkeypatch.setattr(images, "refusal_of_disk", lambda path, size: None)
    with pytest.raises(OSError, match="writer failed"):
        write_png(tmp_path / "x.png", pixels)
    assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.ESTALE])
def test_a_disk_that_takes_no_zeros_either_is_what_the_codec_failed_of(number, tmp_path, monkeypatch):
    def failing(handle):
        raise OSError(number, errno.errorcode[number])

    monkeypatch.setattr(atomic_write.os, "fsync", failing)
    reported = atomic_write.refusal_of_disk(tmp_path / "x.exr", 5000)
    assert isinstance(reported, OutOfResources) and str(tmp_path) in str(reported)
