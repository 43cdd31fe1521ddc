"""A small sample of the campaign: some kills, failing calls, mutants and a crowd, on an import."""

import json
import os
import tempfile
from pathlib import Path

import pytest

from tests.campaign import crowds, faults, kills, pool, readers
from tests.campaign.ground import machine_of_strace, prepared
from tests.stylerf_cli.nursery import REPOSITORY, Nursery

SLOW = ("photo without poses", "report, resealed", "frames, resealed", "frames.json, resealed")
BASES = ("captures", "loose", "made", "scene")
QUICK = [one.name for one in readers.CASES if one.base.partition("/")[0] in BASES and one.name not in SLOW]


@pytest.fixture(scope="module")
def nursery():
    made = Nursery()
    yield made
    made.close()


@pytest.fixture(scope="module")
def ground(nursery):
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=place) as folder:
        yield prepared(Path(folder), nursery, ["import"], plain=True)


@pytest.fixture(scope="module")
def whole(ground, nursery):
    return kills.undisturbed(nursery, ground, ground.stages["import"], machine_of_strace())


def test_a_command_killed_at_a_call_ends_the_same_when_it_is_rerun(ground, nursery, whole):
    """At moments of its time stages are killed in tests/stylerf_cli/test_killed.py."""
    if not whole.calls:
        pytest.skip("strace is missing or may not inject")
    reported = kills.trial(nursery, ground, ground.stages["import"], whole, "sample/import", by_call=True)
    assert reported["fault"] == "" and reported["kills"], reported


@pytest.mark.parametrize("kind", ["full disk", "input/output error"])
def test_a_failing_disk_is_reported_and_the_rerun_succeeds(ground, nursery, whole, kind):
    reported = faults.trial(nursery, ground, ground.stages["import"], whole, kind, f"sample/{kind}")
    assert reported["fault"] == "", reported


def test_two_processes_share_a_work_folder(ground, nursery):
    other = Nursery()
    try:
        reported = crowds.trial([nursery, other], ground, "sample", alike=True, plain=True)
    finally:
        other.close()
    assert reported["fault"] == "", reported


def test_damaged_files_are_read_or_refused_in_one_line(ground, nursery):
    root = readers.prepare(ground, nursery, QUICK)
    worker = pool.Worker(root, 0)
    try:
        sound = [worker.run(case, number, 0) for case, number in readers.sound(QUICK)]
        outcomes = [worker.run(case, number, 0) for case, number in readers.numbers(60, QUICK)]
    finally:
        worker.close()
    assert {one["outcome"] for one in sound} == {"read"}, sound
    assert pool.summary(outcomes)["faults"] == []
    assert {one["outcome"] for one in outcomes} == {"read", "refused"}


def test_the_result_file_is_of_a_full_campaign_without_faults():
    path = REPOSITORY / "benchmarks" / "results" / "campaign.json"
    if not path.is_file():
        pytest.skip("the campaign has not been run yet")
    reported = json.loads(path.read_text())
    assert reported["kills"]["kills"] >= 200 and reported["mutants"]["mutants"] >= 10_000
    assert {name: reported[name]["faults"] for name in ("kills", "mutants", "faults", "crowds")} == {
        name: [] for name in ("kills", "mutants", "faults", "crowds")
    }
