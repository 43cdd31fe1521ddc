"""The plan of a table: how many jobs, how long they take on a number of cores, how much disk they need."""

import heapq
from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from stages.farm.costs import Cost
from stages.farm.jobs import RULES, Job


@dataclass(frozen=True)
class PlannedRule:
    """Jobs of one rule: how many, how many are finished, and seconds, memory and disk of the remaining ones."""

    rule: str
    jobs: int
    finished: int
    seconds: float
    peak_mb: float
    disk_mb: float


@dataclass(frozen=True)
class Plan:
    """A plan.

    Attributes:
        wall_seconds: of all remaining jobs on `cores`, each started as soon as cores and its prerequisites allow.
        longest_seconds: of the longest chain of jobs, which no number of cores shortens.
        work_seconds: the sum over jobs.
    """

    rules: tuple[PlannedRule, ...]
    cores: int
    threads: int
    wall_seconds: float
    longest_seconds: float
    work_seconds: float
    disk_mb: float

    @property
    def to_do(self) -> int:
        """Jobs that are not finished yet."""
        return sum(one.jobs - one.finished for one in self.rules)


def plan_of(jobs: Mapping[str, Job], costs: Mapping[str, Cost], finished: Collection[str], cores: int, threads: int
            ) -> Plan:  # fmt: skip
    """Plan the unfinished jobs.

    Args:
        jobs: by key, each after those that it waits for.
        costs: by key.
        finished: keys of the jobs that are done.
        cores: that may be used at once.
        threads: of each job; with fewer cores than that, one job runs at a time.
    """
    left = {key: job for key, job in jobs.items() if key not in finished}
    chains: dict[str, float] = {}
    for key, job in left.items():
        chains[key] = costs[key].seconds + max((chains.get(one, 0.0) for one in job.after), default=0.0)
    rules = []
    for rule in RULES:
        of_rule = [key for key, job in jobs.items() if job.rule == rule]
        todo = [costs[key] for key in of_rule if key in left]
        if of_rule:
            rules.append(
                PlannedRule(
                    rule, len(of_rule), len(of_rule) - len(todo), sum(one.seconds for one in todo),
                    max((one.peak_mb for one in todo), default=0.0), sum(one.disk_mb for one in todo),
                )
            )
    return Plan(
        tuple(rules), cores, threads, _makespan(left, costs, max(cores // threads, 1)),
        max(chains.values(), default=0.0),
        sum(costs[key].seconds for key in left), sum(costs[key].disk_mb for key in left),
    )  # fmt: skip


def _makespan(jobs: Mapping[str, Job], costs: Mapping[str, Cost], places: int) -> float:
    """Return the seconds until all jobs are done, `places` at a time, in order of readiness (list scheduling)."""
    waiting = {key: sum(one in jobs for one in job.after) for key, job in jobs.items()}
    waiters = defaultdict(list)
    for key, job in jobs.items():
        for one in job.after:
            if one in jobs:
                waiters[one].append(key)
    order = {key: place for place, key in enumerate(jobs)}
    ready = [(order[key], key) for key, count in waiting.items() if not count]
    heapq.heapify(ready)
    running: list[tuple[float, str]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < places:
            _, key = heapq.heappop(ready)
            heapq.heappush(running, (now + costs[key].seconds, key))
        now, done = heapq.heappop(running)
        for key in waiters[done]:
            waiting[key] -= 1
            if not waiting[key]:
                heapq.heappush(ready, (order[key], key))
    return now
