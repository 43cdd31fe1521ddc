"""One command in progress: its work folder, options, device and output, as the verbs see them."""

import argparse
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from schemas.errors import ArtifactStale, UsageError
from schemas.read_limit import set_allowance
from schemas.work_folder import Artifact, WorkFolder, valid_name
from stages.pipeline.distributed import follow, joined, launched, led, release, speaks
from stages.run.memory import room
from stages.run.progress import Context, Silent
from stylerf_cli.arguments import flags_of
from stylerf_cli.options import Options
from stylerf_cli.output import write_lines
from stylerf_cli.progress import Bars


class Session:
    """What a verb's `run(args, session)` works with.

    work: the Work folder at `args.work` (verbs without one must not ask). config: the verb's config. json, quiet, only,
    force, name: the common flags.
    """

    def __init__(self, verb: str, args: argparse.Namespace, options: Options, config: type | None) -> None:
        self.verb, self.args, self.options = verb, args, options
        self.json, self.quiet, self.only, self.force = args.json, args.quiet, args.only, args.force
        # Refused before any stage runs, not when it is the turn of the one that writes it.
        self.name: str | None = None if args.name is None else valid_name(args.name)
        self.own_verbs = {verb}  # whose stages are this verb's own work
        self.config = options.config(config)
        self.common = options.common()
        set_allowance(lambda: room(self.common.memory))
        self.progress: Any = Silent() if self.quiet or not speaks() else Bars(sys.stderr)
        self.ranks = joined(verb, lambda: resolved_device(self.common.device, self.say))
        if self.common.threads_given:
            _use_threads(self.common.threads)

    @cached_property
    def work(self) -> WorkFolder:
        """The work folder named on the command line."""
        return WorkFolder(Path(self.args.work))

    @cached_property
    def context(self) -> Context:
        """Seed, device, threads and progress for stages; asks torch for a GPU only where one may be."""
        return Context(
            seed=self.common.seed,
            device=resolved_device(self.common.device),
            threads=self.common.threads,
            memory=self.common.memory,
            no_paths=self.args.no_paths,
            progress=self.progress,
            ranks=self.ranks,
        )

    def config_of(self, verb: str, config: type) -> Any:
        """The config of another verb's stage: its table of the --config file, else defaults."""
        return self.options.config_of(verb, config)

    def run(
        self,
        spec: Any,
        run: Any,
        inputs: dict[str, Artifact],
        config: Any,
        name: str,
        own: bool | None = None,
        by: Sequence[str] = (),
    ) -> Artifact:
        """Runs a stage, or reuses what stands.

        The stage of this very verb writes under --name where given and obeys --force. Any other stage is an earlier
        one that is missing or out of date: it is announced and brought up to date, or, with --only, refused with the
        command that does it (ArtifactStale). own: says which of the two it is, for a verb of several stages. by: what
        that command needs beside the work folder, the name and the options of the config.
        """
        if not self.ranks.first:
            return follow(self.ranks, self, spec, run, inputs, config)
        if self.ranks.count > 1:
            run = led(self.ranks, run, spec.parallel)
        made = self._run(spec, run, inputs, config, name, own, by)
        if self.ranks.count > 1:
            release(self.ranks, made.name)
        return made

    def _run(
        self,
        spec: Any,
        run: Any,
        inputs: dict[str, Artifact],
        config: Any,
        name: str,
        own: bool | None,
        by: Sequence[str],
    ) -> Artifact:
        from stages.run.runner import execute, recipe_of

        own = spec.verb in self.own_verbs if own is None else own
        name = self.name or name if own else name
        if not own:
            recipe = recipe_of(spec, inputs, config, self.context.seed)
            standing = self.work.up_to_date(spec.writes, name, recipe)
            if standing:
                return standing
            if self.only:
                seed = ["--seed", str(self.common.seed)] if self.common.seed else []
                command = ["stylerf", spec.verb, str(self.work.root), "--name", name, *by, *flags_of(config), *seed]
                raise ArtifactStale(
                    f"{spec.writes} {name} is missing or out of date and --only was given; run: {shlex.join(command)}"
                )
            self.say(f"{spec.writes} {name} is missing or out of date: running `stylerf {spec.verb}` first")
        again = own and self.force
        artifact, reused = execute(spec, run, self.work, name, inputs, config, self.context, again, careful=True)
        if reused:
            self.say(f"{spec.writes} {name} stands up to date (--force makes it anew)")
        return artifact

    def say(self, text: str) -> None:
        """One line on stderr, unless --quiet."""
        self.progress.say(text)

    def emit(self, result: dict, lines: Sequence[str]) -> dict:
        """The result of a verb: prints its lines on stdout, unless --json; returns `result`, which main prints then."""
        self.progress.finish()
        self.ranks.leave()
        if not self.json and self.ranks.first:
            write_lines(lines)
        return result


def resolved_device(wanted: str, say: Callable[[str], None] = lambda text: None) -> str:
    """`cpu` or `cuda`. UsageError when CUDA is asked for and torch finds none, or too few for the processes here.

    say: told where there are GPUs, but too few.
    """
    if wanted == "cpu" or (wanted == "auto" and not _may_have_gpu()):
        return "cpu"
    import torch

    if torch.cuda.is_available():
        here, gpus = int(os.environ.get("LOCAL_WORLD_SIZE", "1")) if launched() > 1 else 1, torch.cuda.device_count()
        if here <= gpus:
            return _float32_kept(torch)
        few = f"{here} processes on this machine, each of which needs a GPU of its own, find {gpus}"
        if wanted == "cuda":
            raise UsageError(f"--device cuda: {few}; start {gpus} here, or run with --device cpu")
        say(f"computing on the CPU: {few}")
        return "cpu"
    if wanted == "cuda":
        raise UsageError(
            "--device cuda: torch finds no usable GPU here; run with --device cpu, or see `stylerf doctor`"
        )
    return "cpu"


def _float32_kept(torch: Any) -> str:
    """`cuda`, its products in the precision of their numbers: those for TF32's, or sums in halves, are rounded more."""
    torch.backends.cudnn.allow_tf32 = False
    torch.backends.cuda.matmul.allow_fp16_reduced_precision_reduction = False
    return "cuda"


def _may_have_gpu() -> bool:
    """Whether the system shows a device that CUDA or ROCm could use: saves seconds of importing torch where not."""
    return any(os.path.exists(path) for path in ("/dev/nvidiactl", "/dev/nvidia0", "/dev/dxg", "/dev/kfd"))


def _use_threads(count: int) -> None:
    """Limits the threads of OpenMP, BLAS and numba, which read this at their import, and of torch if it is there."""
    variables = {"OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"}
    if "numba" in sys.modules:
        # Its compiler refuses another number in the environment than the one that it launched its threads with.
        variables.remove("NUMBA_NUM_THREADS")
        numba = sys.modules["numba"]
        numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    for variable in variables:
        os.environ[variable] = str(count)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(count)
