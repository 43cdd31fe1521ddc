import errno
import os

import numpy as np
import pytest

from schemas.canonical_json import file_sha256
from stages.run import checkpoints
from stages.run.checkpoints import load_checkpoint, save_checkpoint


def save(folder, step):
    save_checkpoint(folder, {"step": step}, {"values": np.full(1000, step, np.float32), "more": np.arange(step)})


def flip(path, at):
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


def files(folder):
    return sorted(folder.iterdir(), reverse=True)


def test_the_last_two_are_kept_and_named_by_what_they_hold(tmp_path):
    for step in range(1, 5):
        save(tmp_path, step)
    kept = files(tmp_path)
    assert [path.name[:6] for path in kept] == ["000004", "000003"]
    assert all(file_sha256(path) == path.stem[7:] for path in kept)
    data, arrays = load_checkpoint(tmp_path, pytest.fail)
    assert data == {"step": 4} and arrays["values"].tolist() == [4] * 1000 and len(arrays["more"]) == 4


@pytest.mark.parametrize("at", [3, 50, 2000, -1])
def test_a_flipped_bit_gives_way_to_the_one_before(tmp_path, at):
    save(tmp_path, 1)
    save(tmp_path, 2)
    flip(files(tmp_path)[0], at)
    said = []
    assert load_checkpoint(tmp_path, said.append)[0] == {"step": 1}
    assert len(said) == 1 and "000002" in said[0] and "using the one before it" in said[0]


def test_with_both_damaged_a_run_begins_anew_and_says_so(tmp_path):
    save(tmp_path, 1)
    save(tmp_path, 2)
    for path in files(tmp_path):
        path.write_bytes(path.read_bytes()[:-1])
    said = []
    assert load_checkpoint(tmp_path, said.append) is None
    assert len(said) == 2 and said[0].endswith("using the one before it") and said[1].endswith("starting over")
    save(tmp_path, 3)
    assert load_checkpoint(tmp_path, pytest.fail)[0] == {"step": 3}


def test_one_that_cannot_be_read_is_not_passed_over(tmp_path, monkeypatch):
    save(tmp_path, 1)

    def unreadable(path):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(checkpoints, "file_sha256", unreadable)
    with pytest.raises(OSError, match="Input/output"):
        load_checkpoint(tmp_path, pytest.fail)


def test_nothing_written_is_nothing_found(tmp_path):
    (tmp_path / "writing.safetensors").write_bytes(b"cut short")
    assert load_checkpoint(tmp_path, pytest.fail) is None
