"""One command in progress: its options, its output and its pipeline."""

import argparse
import sys
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from stages.pipeline.distributed import join, prints
from stages.pipeline.resources import claim, resolved_device
from stylerf_cli.options import Options
from stylerf_cli.output import write_lines
from stylerf_cli.progress import Bars

if TYPE_CHECKING:  # every verb imports this module, and `--help` must not wait for numpy
    from schemas.work_folder import Artifact
    from stages.pipeline.pipeline import Pipeline
    from stages.run.progress import Progress


def made(kind: str, artifact: "Artifact") -> dict[str, Any]:
    """Return what verbs that make an artifact of this kind report of it."""
    manifest = artifact.manifest
    return {kind: artifact.path, "name": artifact.name, "figures": manifest.figures, "seconds": manifest.seconds}


class Session:
    """What a verb's `run(args, session)` works with.

    config: the options of the verb. name, force: of --name (empty without) and --force.
    """

    def __init__(self, verb: str, args: argparse.Namespace, options: Options, config: type | None) -> None:
        from schemas.work_folder import valid_name
        from stages.run.progress import Silent

        self._args, self._options = args, options
        self.json: bool = args.json
        self.only: bool = args.only
        self.force: bool = args.force
        self.name = "" if args.name is None else valid_name(args.name)
        self.config: Any = options.config(config)
        self.common = options.common()
        claim(self.common.threads, self.common.memory)
        self.progress: Progress = Silent() if args.quiet or not prints() else Bars(sys.stderr)
        self.processes = join(verb, lambda: resolved_device(self.common.device, self.say))

    @cached_property
    def pipeline(self) -> "Pipeline":
        """The pipeline of the work folder on the command line."""
        from stages.pipeline.pipeline import Pipeline

        return Pipeline(
            self._args.work,
            seed=self.common.seed,
            device=self.common.device,
            threads=self.common.threads,
            memory=self.common.memory,
            progress=self.progress,
            options=self._options,
            only=self.only,
            no_paths=self._args.no_paths,
            processes=self.processes,
        )

    def say(self, text: str) -> None:
        """Print one line on stderr, unless --quiet."""
        self.progress.say(text)

    def emit(self, result: dict[str, Any], lines: Sequence[str]) -> dict[str, Any]:
        """Finish the command: print `lines` on stdout unless --json, and return `result`, which main prints if so."""
        self.progress.finish()
        self.processes.leave()
        if not self.json and self.processes.first:
            write_lines(lines)
        return result
