import json
import os
import sys
import tracemalloc

import pytest

from schemas.errors import ArtifactDamaged, BadInput
from schemas.safe_reading import read_bytes, read_json, read_text


def test_a_file_is_read_through_a_link(tmp_path):
    (tmp_path / "a").write_bytes(b"content")
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "link", 100) == b"content"


def test_a_named_pipe_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInput, match="a named pipe, not a file"):
        read_bytes(tmp_path / "pipe", 100)


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null", "/"])
def test_devices_and_folders_are_refused(path):
    with pytest.raises(BadInput, match=r"not a file|cannot be read"):
        read_bytes(path, 100)


def test_no_more_than_the_limit_is_read(tmp_path):
    with open(tmp_path / "sparse", "wb") as stream:
        stream.truncate(1 << 40)
    with pytest.raises(ArtifactDamaged, match="at most"):
        read_bytes(tmp_path / "sparse", 1 << 20, ArtifactDamaged)
    (tmp_path / "small").write_bytes(bytes(100))
    assert len(read_bytes(tmp_path / "small", 100)) == 100


def test_a_small_file_takes_little_memory_whatever_the_limit(tmp_path):
    (tmp_path / "small").write_bytes(b"hello")
    tracemalloc.start()
    try:
        assert read_bytes(tmp_path / "small", 1 << 30) == b"hello"
        assert tracemalloc.get_traced_memory()[1] < 10 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc is of Linux")
def test_a_file_that_tells_no_size_is_read_up_to_the_limit():
    assert os.stat("/proc/self/status").st_size == 0
    assert b"VmRSS" in read_bytes("/proc/self/status", 1 << 20)
    with pytest.raises(BadInput, match="grew beyond"):
        read_bytes("/proc/self/status", 100)


@pytest.mark.parametrize("name", ["\ud800.json", "a\x00b", "x" * 5000])
def test_a_path_that_no_file_can_have_is_a_fault_in_words(tmp_path, name):
    with pytest.raises((BadInput, FileNotFoundError)) as fault:
        read_bytes(tmp_path / name, 100)
    if isinstance(fault.value, BadInput):
        assert str(fault.value).isprintable()


def test_text_is_utf_8_with_or_without_a_mark(tmp_path):
    (tmp_path / "marked").write_bytes(b"\xef\xbb\xbf{}")
    assert read_text(tmp_path / "marked", 100) == "{}"
    (tmp_path / "latin").write_bytes(b"\xe9")
    with pytest.raises(BadInput, match="UTF-8"):
        read_text(tmp_path / "latin", 100)


@pytest.mark.parametrize("text", ["[" * 100_000, "{", "", "1" * 5000, '{"a": 1,}'])
def test_what_is_not_json_is_reported_in_one_line(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(BadInput) as fault:
        read_json(tmp_path / "a.json")
    assert "a.json" in str(fault.value) and "\n" not in str(fault.value)


def test_json_is_read(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"a": [1, 2.5, None]}))
    assert read_json(tmp_path / "a.json") == {"a": [1, 2.5, None]}
