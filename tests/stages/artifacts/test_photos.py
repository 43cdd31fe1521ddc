"""Photos in memory and on disk give the same bank; the file has no name, and little of it stays mapped."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.errors import OutOfResources
from stages.artifacts import photos
from stages.artifacts.photos import bank_of, photo_for
from stages.artifacts.scene import load_scene
from stages.run.progress import Context, Silent
from stylerf.geometry.cameras import Camera
from stylerf.rendering.view import render_view
from tests.stages.artifacts.test_scene import build
from tests.stylerf.small import SPACES, field_of, wall_in_front


class Said(Silent):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture
def scene(tmp_path):
    return load_scene(build(tmp_path))


def both(scene, tmp_path, monkeypatch):
    """The bank in memory and the one on disk, and what the second said."""
    here = bank_of(scene, [2, 0, 1], tmp_path, Context())
    said = Said()
    monkeypatch.setattr(photos, "available_bytes", lambda bound: 0)
    monkeypatch.setattr(photos, "MIN_BYTES", 0)
    return here, bank_of(scene, [2, 0, 1], tmp_path, Context(progress=said)), said.lines


def test_the_same_draws_from_memory_and_from_a_file_without_a_name(scene, tmp_path, monkeypatch):
    before = sorted(tmp_path.rglob("*"))
    here, there, said = both(scene, tmp_path, monkeypatch)
    assert sorted(tmp_path.rglob("*")) == before
    assert len(said) == 1 and "3 photos need 0 MB" in said[0] and "file" in said[0]
    assert np.array_equal(here.bytes, np.repeat(np.uint8([2, 0, 1]), 6 * 8 * 4))
    for bank in (here, there):
        assert not np.shares_memory(bank.bytes, here.bytes) or bank is here
    drawn = [bank.draw(500, np.random.default_rng(0)) for bank in (here, there)]
    for one, other in zip(*drawn, strict=True):
        assert np.array_equal(one, other)


def test_photos_go_to_a_file_where_the_system_cannot_reserve_its_place(scene, tmp_path, monkeypatch):
    """As on macOS."""
    monkeypatch.delattr(os, "posix_fallocate")
    here, there, _ = both(scene, tmp_path, monkeypatch)
    assert np.array_equal(here.bytes, there.bytes)


def test_a_view_without_alpha_among_others_is_opaque_and_read_once(scene, monkeypatch, tmp_path):
    whole, read = scene.images, []

    def images(index):
        read.append(index)
        return whole(index)[..., :3] if index == 0 else whole(index)

    object.__setattr__(scene, "images", images)
    bank = bank_of(scene, [0, 1], tmp_path, Context())
    assert bank.channels == 4 and read == [0, 1]
    assert set(bank.bytes.reshape(2, -1, 4)[0, :, 3]) == {255} and set(bank.bytes.reshape(2, -1, 4)[1, :, 3]) == {1}


def test_a_disk_that_is_full_is_met_at_the_start_and_named(scene, tmp_path, monkeypatch):
    def full(handle, start, size):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OutOfResources, match="no space left"):
        both(scene, tmp_path, monkeypatch)


MAPPED = """
import sys
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from stages.artifacts.photos import _on_disk
from stages.run.memory import in_words

class Scene:
    def images(self, index):
        return np.full((1000, 1000, 4), index / 255, np.float32)

def resident():
    return int(Path("/proc/self/statm").read_text().split()[2]) * 4096  # of files

views, generator = list(range(40)), np.random.default_rng(0)
pixels = _on_disk(Scene(), views, 4, 160_000_000, float(sys.argv[1]), Path(sys.argv[2]))
before, most = resident(), 0
for _ in range(30):
    at = generator.integers(0, 160_000_000, 500)
    assert (pixels.values[at] == at // 4_000_000).all()
    pixels.read(500)
    most = max(most, resident() - before)
print(most)
"""


def test_no_more_of_the_file_stays_in_memory_than_it_may(tmp_path):
    """160 MB looked at in 15,000 places: all of it where that is allowed, else no more than what was looked at last."""
    found = [
        int(subprocess.run([sys.executable, "-c", MAPPED, bound, str(tmp_path)], capture_output=True, check=True,
                           cwd=Path(__file__).parents[3]).stdout)
        for bound in ("1e12", "40e6")
    ]  # fmt: skip
    assert found[0] > 100e6 and found[1] < 75e6, found


def test_masked_pixels_of_a_capture_are_filled_from_the_field():
    field = wall_in_front(0.02)
    camera = Camera("view", 8, 6, 8.0, 8.0, 4.0, 3.0, np.eye(4))
    pixels = np.full((6, 8, 4), 0.25, np.float32)
    pixels[..., 3] = np.arange(8) >= 4
    scene = SimpleNamespace(images=lambda index: pixels, cameras=[camera])
    found = photo_for(field, scene, 0, 1.0, 1)
    assert (found[:, 4:] == 0.25).all()
    np.testing.assert_array_equal(found[:, :4], render_view(field, camera, threads=1).rgb[:, :4])
    # An object's stays what it is over the background.
    found = photo_for(field_of(SPACES["box"], 1), scene, 0, 1.0, 1)
    assert (found[:, 4:] == 0.25).all() and (found[:, :4] == 1).all()
