"""Calls Snakemake for a table."""

import importlib.util
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from schemas.errors import OutOfResources, UsageError
from schemas.lock import Lock
from stages.configs.farm import PROFILES, FarmConfig

HERE = Path(__file__).parent
SNAKEFILE = HERE / "Snakefile"
PACKAGES = {"snakemake": "snakemake", "snakemake_executor_plugin_slurm": "snakemake-executor-plugin-slurm"}
GRACE_SECONDS = 60.0  # for running jobs to save a checkpoint after an interrupt


def refuse_missing(profile: str) -> None:
    """Raise OutOfResources if Snakemake, or its Slurm plugin, is not installed."""
    for module, package in PACKAGES.items():
        if (profile == "slurm" or module == "snakemake") and importlib.util.find_spec(module) is None:
            raise OutOfResources(
                f"{package} is not installed; install it with: pip install 'stylerf[farm]' (Python 3.11 to 3.13)"
            )


def command_of(config: FarmConfig, out: Path, cores: int, memory_mb: int, container: str) -> list[str]:
    """Return the command line of Snakemake.

    Args:
        config: profile, queued jobs, retries, dry run, and further options, which override these.
        out: the folder of the table.
        cores, memory_mb: that jobs on this machine may use at once.
        container: image that jobs run in, empty for none.
    """
    profile = str(HERE / "profiles" / config.profile) if config.profile in PROFILES else config.profile
    if config.profile not in PROFILES and not (Path(profile) / "config.yaml").is_file():
        raise UsageError(f"--profile {profile}: expected {', '.join(PROFILES)} or a folder with a config.yaml")
    here = ["--cores", str(cores), "--resources", f"mem_mb={memory_mb}"]
    command = [
        sys.executable, "-P", "-m", "snakemake", "--snakefile", str(SNAKEFILE), "--directory", str(out),
        "--profile", profile,
        # Our own lock of the folder keeps a second Snakemake out; Snakemake's lock would remain after a kill.
        "--nolock", "--rerun-incomplete", "--rerun-triggers", "mtime", "params", "--retries", str(config.retries),
        *(here if config.profile == "local" else ["--jobs", str(config.jobs)]),
        *(["--software-deployment-method", "apptainer"] if container else []),
        *(["--dry-run"] if config.dry_run else []),
    ]  # fmt: skip
    return [*command, *shlex.split(config.snakemake)]


def run_engine(command: Sequence[str], lock: Lock, quiet: bool) -> int:
    """Run Snakemake and return its exit code.

    An interrupt is passed on: running jobs save checkpoints, and the next run resumes them.

    Args:
        lock: of the table's folder. It is held until Snakemake itself has ended, also if this process is killed.
        quiet: discard Snakemake's output, which is progress on stderr.
    """
    stream = subprocess.DEVNULL if quiet else 2
    child = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, pass_fds=lock.descriptors(),
        start_new_session=True,
    )  # fmt: skip
    try:
        return child.wait()
    except BaseException:
        _end(child)
        raise


def _end(child: "subprocess.Popen[bytes]") -> None:
    """Interrupt Snakemake and its jobs, wait for them, and kill what does not stop."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(child.pid, number)
            child.wait(GRACE_SECONDS)
            return
        except subprocess.TimeoutExpired:
            continue
        except ProcessLookupError:
            return
