"""Options of `stylerf farm`."""

import shlex
from dataclasses import dataclass

from stages.configs import advanced, option

PROFILES = ("local", "slurm")


@dataclass(frozen=True)
class FarmConfig:
    """What is done with the table, and where its jobs run."""

    plan: bool = option(False, help="show jobs, hours and disk space; run nothing")
    dry_run: bool = option(False, help="let Snakemake show what it would run; run nothing")
    profile: str = option(
        "local", metavar="local|slurm|DIR", help="where jobs run: this machine, a Slurm cluster, or a Snakemake profile"
    )
    cores: int = option(0, help="CPU cores to use at once on this machine, or to plan for (0: all that are available)")
    jobs: int = option(100, help="jobs to keep queued on a cluster")
    snakemake: str = option(
        "", metavar="OPTIONS", help="more Snakemake options, as one string: --snakemake='--default-resources ...'"
    )
    retries: int = advanced(3, help="retries of a job that was killed or ran out of memory or space")

    def __post_init__(self) -> None:
        if self.plan and self.dry_run:
            raise ValueError("--plan and --dry-run show different things; give one of them")
        if self.plan and self.snakemake:
            raise ValueError("--plan does not call Snakemake, so that --snakemake has no effect; leave it out")
        try:
            shlex.split(self.snakemake)
        except ValueError as error:
            raise ValueError(f"--snakemake {self.snakemake}: {error}") from error
        if self.cores < 0 or not 0 <= self.retries <= 100 or not 1 <= self.jobs <= 100_000:
            raise ValueError("cores must not be negative, retries be 0 to 100, jobs 1 to 100000")
        if self.profile == "local" and self.jobs != type(self).jobs:
            raise ValueError("--jobs counts those queued on a cluster; on this machine, give --cores")
