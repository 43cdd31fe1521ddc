"""Plans: list scheduling against hand-made answers; costs that finished jobs correct."""

import pytest

from stages.farm.costs import Cost, Costs, Rate, shipped_costs
from stages.farm.jobs import RULES, Job
from stages.farm.plan import plan_of


def job(name: str, *after: str, rule: str = "fit", **more: object) -> Job:
    return Job(rule, "s", "field", name, (), tuple(f"s/field/{one}" for one in after), **more)


def planned(jobs: list[Job], seconds: dict[str, float], cores: int, finished=(), threads: int = 1):
    costs = {one.key: Cost(seconds[one.name], 100.0, 10.0) for one in jobs}
    return plan_of({one.key: one for one in jobs}, costs, {f"s/field/{one}" for one in finished}, cores, threads)


CHAIN = [job("a"), job("b", "a"), job("c", "a"), job("d", "b", "c")]
SECONDS = {"a": 10.0, "b": 20.0, "c": 30.0, "d": 5.0}


@pytest.mark.parametrize(("cores", "wall"), [(1, 65.0), (2, 45.0), (64, 45.0)])
def test_jobs_wait_for_cores_and_for_each_other(cores, wall):
    plan = planned(CHAIN, SECONDS, cores)
    assert (plan.wall_seconds, plan.longest_seconds, plan.work_seconds) == (wall, 45.0, 65.0)


def test_what_stands_costs_nothing():
    plan = planned(CHAIN, SECONDS, 1, finished=("a", "b"))
    assert (plan.to_do, plan.wall_seconds, plan.disk_mb) == (2, 35.0, 20.0)


def test_a_job_of_more_threads_than_cores_runs_alone():
    assert planned([job("a"), job("b")], SECONDS, 2, threads=4).wall_seconds == 30.0


def test_nothing_to_do_takes_no_time():
    assert planned(CHAIN, SECONDS, 2, finished="abcd").wall_seconds == 0.0


def test_a_budget_is_time_or_steps():
    costs = Costs(5.0, {"fit": Rate(seconds=2.0, share=1.1, step_seconds=0.5)}, "")
    assert costs.of(job("a", budget="1m")).seconds == pytest.approx(5 + 2 + 66)
    assert costs.of(job("a", budget="10")).seconds == pytest.approx(5 + 2 + 5)


def test_every_rule_has_a_measured_price():
    costs = shipped_costs()
    for rule in RULES:
        assert costs.of(job("a", rule=rule)).seconds > costs.start_seconds
