"""Writes are whole or absent, and a disk that refuses is reported apart from other faults."""

import errno
import os

import pytest

from schemas import atomic_write
from schemas.atomic_write import is_temporary, refusal_of_disk, replacing, sweeping, write_bytes, write_json, writing
from schemas.canonical_json import canonical_json, digest_of, plain
from schemas.errors import OutOfResources


def test_write_replaces_whole_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "deep" / "a.json"
    write_json(path, {"b": (1, 2.5), "a": float("inf")})
    write_json(path, {"a": 1})
    assert path.read_text() == '{\n "a": 1\n}\n'
    assert os.listdir(path.parent) == ["a.json"]


def test_failed_write_keeps_the_old_bytes(tmp_path):
    path = tmp_path / "a.bin"
    write_bytes(path, b"old")
    with pytest.raises(ZeroDivisionError), replacing(path) as temporary:
        temporary.write_bytes(b"half of the ne")
        assert is_temporary(temporary)
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.bin"]


@pytest.mark.parametrize("name", ["a.png", ".hidden", "a.tmp", "tmp"])
def test_ordinary_names_are_no_leftovers(tmp_path, name):
    assert not is_temporary(tmp_path / name)


@pytest.mark.parametrize(
    ("code", "word"),
    [(errno.ENOSPC, "space"), (errno.EDQUOT, "space"), (errno.EACCES, "permission"), (errno.EROFS, "permission")],
)
def test_refusals_of_the_disk_are_reported_in_words(tmp_path, monkeypatch, code, word):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(atomic_write.os, "replace", refuse)
    with pytest.raises(OutOfResources, match=word) as caught:
        write_bytes(tmp_path / "a", b"x")
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_other_faults_are_not_called_out_of_resources(tmp_path):
    with pytest.raises(IsADirectoryError), writing(tmp_path):
        raise IsADirectoryError(errno.EISDIR, "Is a directory")


def test_refusal_of_disk_is_none_on_a_sound_disk(tmp_path):
    assert refusal_of_disk(tmp_path / "a", 3_000_000) is None
    assert os.listdir(tmp_path) == []


def test_canonical_json_ignores_order_and_types_of_containers():
    import numpy as np

    assert canonical_json({"b": (1, np.float32(0.5)), "a": np.arange(2)}) == b'{"a":[0,1],"b":[1,0.5]}'
    assert digest_of({"a": 1, "b": 2}) == digest_of({"b": 2, "a": 1})
    assert len({digest_of(value) for value in (1, 1.5, "1", None, True, float("inf"), float("nan"))}) == 7


def test_objects_without_a_json_form_are_refused():
    with pytest.raises(TypeError, match="object"):
        plain({"a": object()})


def test_sweeping_deletes_leftovers_but_not_what_is_being_written(tmp_path):
    left = tmp_path / "charts" / ".heat_map.0a1b2c3d.tmp.svg"
    left.parent.mkdir()
    for kept in (left, tmp_path / "charts" / "heat_map.svg", tmp_path / "charts" / ".hidden"):
        kept.write_text("half")
    with sweeping((tmp_path / "charts", tmp_path / "absent")), replacing(tmp_path / "charts" / "b.svg") as temporary:
        temporary.write_text("whole")
    assert sorted(one.name for one in left.parent.iterdir()) == [".hidden", "b.svg", "heat_map.svg"]
    with sweeping([left.parent]):
        left.write_text("of another process")
    assert left.exists()
