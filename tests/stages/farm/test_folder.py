"""The folder of a table: which jobs stand, what Snakemake is told, why jobs failed."""

import json
from pathlib import Path

import pytest

from schemas.errors import UsageError
from stages.configs.farm import FarmConfig
from stages.farm.engine import HERE, SNAKEFILE, command_of
from stages.farm.folder import copy_of, failures, farm_folder, finished, sweep_copies
from stages.farm.jobs import Job

JOBS = {
    one.key: one
    for one in (
        Job("import", "s", "scene", "main", ()),
        Job("fit", "s", "field", "fit-s0", (), ("s/scene/main",)),
        Job("render", "s", "frames", "fit-s0-orbit", (), ("s/field/fit-s0",)),
        Job("import", "t", "scene", "main", ()),
    )
}


def made(out: Path, key: str, text: str = "{}") -> None:
    for place in (out / JOBS[key].manifest, copy_of(out, key)):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)


def test_a_job_stands_while_its_artifact_is_the_one_that_it_made(tmp_path):
    made(tmp_path, "s/scene/main")
    made(tmp_path, "s/field/fit-s0")
    assert finished(tmp_path, JOBS) == {"s/scene/main", "s/field/fit-s0"}
    (tmp_path / JOBS["s/field/fit-s0"].manifest).write_text("made again")
    assert finished(tmp_path, JOBS) == {"s/scene/main"}
    sweep_copies(tmp_path, JOBS)
    assert copy_of(tmp_path, "s/scene/main").exists() and not copy_of(tmp_path, "s/field/fit-s0").exists()


def test_a_failure_counts_what_waits_for_it(tmp_path):
    made(tmp_path, "t/scene/main")
    result = farm_folder(tmp_path) / "results" / "s/scene/main.json"
    result.parent.mkdir(parents=True)
    result.write_text(json.dumps({"error": "no photos\x1b[2J", "exit_code": 3}))
    (failed,) = failures(tmp_path, JOBS)
    assert (failed.key, failed.why, failed.blocked) == ("s/scene/main", r"no photos\x1b[2J", 2)


@pytest.mark.parametrize("said", ["", "[1]", '{"error": 1}', "{" * 500])
def test_a_result_that_no_job_wrote_is_no_reason(tmp_path, said):
    result = farm_folder(tmp_path) / "results" / "t/scene/main.json"
    result.parent.mkdir(parents=True)
    result.write_text(said)
    assert all("never started" in one.why for one in failures(tmp_path, JOBS))


def test_the_users_options_come_last_and_so_win(tmp_path):
    command = command_of(FarmConfig(snakemake="--retries 9 --set 'a b'"), tmp_path, 4, 8000, "")
    assert command[-4:] == ["--retries", "9", "--set", "a b"]
    assert command[command.index("--cores") + 1] == "4" and "mem_mb=8000" in command


def test_a_cluster_is_given_jobs_and_a_container_its_method(tmp_path):
    command = command_of(FarmConfig(profile="slurm", jobs=7), tmp_path, 4, 8000, "docker://x")
    assert command[command.index("--jobs") + 1] == "7" and "--cores" not in command
    assert command[command.index("--software-deployment-method") + 1] == "apptainer"


def test_a_profile_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(UsageError, match="expected local, slurm or a folder"):
        command_of(FarmConfig(profile=str(tmp_path)), tmp_path, 1, 1000, "")


def test_what_the_engine_reads_is_installed_with_the_package():
    assert SNAKEFILE.is_file()
    assert all((HERE / "profiles" / name / "config.yaml").is_file() for name in ("local", "slurm"))
