"""Amounts of memory in words, and what is left of a bound."""

import mmap

import pytest

from stages.run import memory
from stages.run.memory import available_bytes, bytes_of, free, in_words, used


@pytest.mark.parametrize(
    ("text", "count"), [("512M", 512e6), ("8G", 8e9), ("1.5g", 1.5e9), ("300000000", 3e8), ("2 GB", 2e9), ("1T", 1e12)]
)
def test_amounts(text, count):
    assert bytes_of(text) == count


@pytest.mark.parametrize("text", ["", "8 gigabytes", "-1G", "8GiB", "G", "inf"])
def test_what_is_no_amount(text):
    with pytest.raises(ValueError, match="such as 512M or 8G"):
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
    assert available_bytes(10**9) == 400 * 10**6 and available_bytes(500 * 10**6) == 0


def test_without_a_bound_processes_share_most_of_the_free_memory(monkeypatch):
    assert free() > 0
    monkeypatch.setattr(memory, "free", lambda: 8 * 10**9)
    assert available_bytes(0) == 6 * 10**9
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "4")
    assert available_bytes(0) == 1.5 * 10**9


@pytest.fixture
def groups(monkeypatch, tmp_path):
    """make(own lines, {file: content}): control groups as a process would find them."""

    def make(own: str, files: dict[str, str]) -> None:
        (tmp_path / "own").write_text(own)
        for name, content in files.items():
            (tmp_path / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "tree" / name).write_text(content + "\n")

    monkeypatch.setattr(memory, "CGROUPS", tmp_path / "tree")
    monkeypatch.setattr(memory, "OWN_GROUPS", tmp_path / "own")
    return make


def test_a_container_may_leave_less_than_its_machine(groups):
    groups("0::/\n", {"memory.max": "3000000", "memory.current": "1000000"})
    assert free() == 2_000_000
    groups("0::/\n", {"memory.stat": "anon 1\ninactive_file 500000\nactive_file 7"})
    assert free() == 2_500_000
    groups("0::/\n", {"memory.max": "max"})
    assert free() > 10_000_000


@pytest.mark.parametrize(
    ("own", "folder", "names"),
    [
        ("0::/slurm/job_7/step_0\n", "slurm/job_7", ("memory.max", "memory.current")),
        (
            "5:cpu,cpuacct:/other\n4:memory:/slurm/job_7/step_0\n0::/\n",
            "memory/slurm/job_7",
            ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        ),
        ("4:memory:/docker/not/seen/inside\n", "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes")),
    ],
)
def test_a_limit_of_any_group_around_the_process_counts(groups, own, folder, names):
    groups(own, {f"{folder}/{name}": count for name, count in zip(names, ("5000000", "1000000"), strict=True)})
    assert free() == 4_000_000


@pytest.mark.parametrize(
    ("own", "files", "cores"),
    [
        ("0::/a/b\n", {"a/cpu.max": "250000 100000", "a/b/cpu.max": "max 100000"}, 2.5),
        ("3:cpu,cpuacct:/a\n", {"cpu/a/cpu.cfs_quota_us": "400000", "cpu/a/cpu.cfs_period_us": "100000"}, 4),
        ("3:cpu,cpuacct:/a\n", {"cpu/a/cpu.cfs_quota_us": "-1", "cpu/a/cpu.cfs_period_us": "100000"}, float("inf")),
        ("", {}, float("inf")),
    ],
)
def test_a_quota_of_processors_time_counts(groups, own, files, cores):
    groups(own, files)
    assert memory.cores() == cores
