"""Small shares of `python -m benchmarks.farm`: kills at random moments, and a cluster that loses jobs."""

import pytest

pytest.importorskip("snakemake", reason="needs the extra `farm`")

from benchmarks.farm import kills, slurm


@pytest.mark.slow
def test_a_table_whose_jobs_are_killed_ends_with_the_same_digests(tmp_path):
    found = kills(1, 0, tmp_path)
    assert found["finished"] == [51, 51] and found["attempts_killed"] > 5
    assert not found["differing"] and not found["left_over"] and not any(found["verify_exit_codes"])
    assert found["failed"][1] == ["bad/scene/main"]


@pytest.mark.slow
def test_a_cluster_that_preempts_and_loses_jobs_is_survived(tmp_path):
    pytest.importorskip("snakemake_executor_plugin_slurm")
    found = slurm(1, 1, tmp_path)
    assert found["finished"][0] == found["finished"][1] and found["fates_met"]
    assert not found["differing"] and not found["left_over"]
    assert found["failed"][1] == ["bad/scene/main"]
