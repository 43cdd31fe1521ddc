"""Amounts of memory in words, and what is left of a bound."""

import mmap

import pytest

from stages import memory
from stages.memory import bytes_of, free, in_words, room, used


@pytest.mark.parametrize(
    ("text", "count"), [("512M", 512e6), ("8G", 8e9), ("1.5g", 1.5e9), ("300000000", 3e8), ("2 GB", 2e9), ("1T", 1e12)]
)
def test_amounts(text, count):
    assert bytes_of(text) == count


@pytest.mark.parametrize("text", ["", "8 gigabytes", "-1G", "8GiB", "G", "inf"])
def test_what_is_no_amount(text):
    with pytest.raises(ValueError, match="like 512M or 8G"):
        bytes_of(text)


def test_less_than_the_program_takes():
    with pytest.raises(ValueError, match="at least 256 MB"):
        bytes_of("255M")


def test_words():
    assert [in_words(count) for count in (-5, 3e6, 999e6, 999.9e6, 1.74e9)] == [
        "0 MB", "3 MB", "999 MB", "1.0 GB", "1.7 GB"
    ]  # fmt: skip


def test_room_is_what_a_bound_leaves_beside_what_is_in_use(monkeypatch):
    assert used() > 20e6
    before, block = used(), mmap.mmap(-1, 50_000_000)  # what malloc gives may have been resident before
    for at in range(0, len(block), 4096):
        block[at] = 1
    assert used() - before > 40e6
    monkeypatch.setattr(memory, "used", lambda: 600 * 10**6)
    assert room(10**9) == 400 * 10**6 and room(500 * 10**6) == 0


def test_without_a_bound_most_of_what_is_free_is_shared_among_the_processes_of_a_machine(monkeypatch):
    assert free() > 0
    monkeypatch.setattr(memory, "free", lambda: 8 * 10**9)
    assert room(0) == 6 * 10**9
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "4")
    assert room(0) == 1.5 * 10**9


def test_a_container_may_leave_less_than_its_machine(monkeypatch, tmp_path):
    (tmp_path / "memory.max").write_text("3000000\n")
    (tmp_path / "memory.current").write_text("1000000\n")
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    assert free() == 2_000_000
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 500000\nactive_file 7\n")
    assert free() == 2_500_000
    (tmp_path / "memory.max").write_text("max\n")
    assert free() > 10_000_000
