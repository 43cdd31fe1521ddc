"""Runs the stages of one work folder: requested stages, and prerequisites that are missing or out of date."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

from schemas.errors import ArtifactStale
from schemas.work_folder import Artifact, WorkFolder, newest, shortened_name, valid_name
from stages.configs import flags_of
from stages.pipeline.distributed import agree, follow, lead, release
from stages.pipeline.resources import resolved_device
from stages.run.progress import Context, Progress
from stages.run.runner import Run, Spec, execute, recipe_of
from stylerf.training.common.process_group import ProcessGroup

Config = TypeVar("Config")


@dataclass(frozen=True)
class Request:
    """A stage that the caller requested, as opposed to a prerequisite.

    name: of the artifact, empty for the stage's default. force: rebuild it even if it is up to date.
    """

    name: str = ""
    force: bool = False

    def __post_init__(self) -> None:
        if self.name:
            valid_name(self.name)


class StageOptions(Protocol):
    """Options of prerequisites, by verb."""

    def table(self, verb: str) -> Mapping[str, Any]:
        """Return the options that are set for a verb."""
        ...

    def config_of(self, verb: str, config: type[Config]) -> Config:
        """Return the config of a verb: the options that are set for it, defaults for the others."""
        ...


class DefaultOptions:
    """Options of prerequisites if none are set."""

    def table(self, verb: str) -> Mapping[str, Any]:
        return {}

    def config_of(self, verb: str, config: type[Config]) -> Config:
        return config()


@dataclass(frozen=True)
class Machine:
    """Where stages compute. device: `auto`, `cpu` or `cuda`. memory: bytes, 0 for most of what is free."""

    device: str
    threads: int
    memory: int


class StageRunner:
    """Runs or reuses stages in a work folder."""

    def __init__(
        self,
        work: WorkFolder,
        seed: int,
        machine: Machine,
        progress: Progress,
        processes: ProcessGroup,
        options: StageOptions,
        only: bool = False,
        no_paths: bool = False,
    ) -> None:
        """Set up the runner; nothing is computed or written.

        Args:
            seed: for everything random.
            only: raise ArtifactStale if a prerequisite is missing or out of date instead of running it.
            no_paths: record files outside the work folder by name only.
        """
        self.work, self.seed, self.options, self.only = work, seed, options, only
        self.progress, self.processes = progress, processes
        self._machine, self._no_paths = machine, no_paths

    @cached_property
    def context(self) -> Context:
        """What stages run with. Resolves the device on first use, which may import torch."""
        return Context(
            seed=self.seed,
            device=resolved_device(self._machine.device),
            threads=self._machine.threads,
            memory=self._machine.memory,
            no_paths=self._no_paths,
            progress=self.progress,
            processes=self.processes,
        )

    def say(self, text: str) -> None:
        """Show the user one line."""
        self.progress.say(text)

    def run(
        self,
        spec: Spec,
        run: Run,
        inputs: dict[str, Artifact],
        config: Any,
        name: str,
        request: Request | None = None,
        by: Sequence[str] = (),
    ) -> Artifact:
        """Run a stage, or reuse its artifact if that is up to date.

        Args:
            name: default name of the artifact, shortened if it is too long.
            request: how the caller requested this stage; None for a prerequisite, which is announced before it runs.
            by: further arguments, besides work folder, name and options, of the command that makes a prerequisite.

        Raises:
            ArtifactStale: a prerequisite is not up to date and `only` is set. The message holds the command to run.
        """
        name = shortened_name(name)
        if not self.processes.first:
            # Followers never check whether the artifact is up to date: the leader decides, and may be writing it.
            made = follow(self.processes, run, inputs, config, self.context, self.work.root)
            return self.work.get(spec.writes, made)
        if self.processes.count > 1:
            run = lead(self.processes, run, spec.parallel)
        if request is None:
            artifact = self._prerequisite(spec, run, inputs, config, name, by)
        else:
            artifact = self._execute(spec, run, inputs, config, request.name or name, request.force)
        if self.processes.count > 1:
            release(self.processes, artifact.name)
        return artifact

    def _prerequisite(
        self, spec: Spec, run: Run, inputs: dict[str, Artifact], config: Any, name: str, by: Sequence[str]
    ) -> Artifact:
        if made := self.work.up_to_date(spec.writes, name, recipe_of(spec, inputs, config, self.seed)):
            return made
        if self.only:
            seed = ["--seed", str(self.seed)] if self.seed else []
            command = ["stylerf", spec.verb, str(self.work.root), "--name", name, *by, *flags_of(config), *seed]
            raise ArtifactStale(
                f"{spec.writes} {name} is missing or out of date and --only was given; run: {shlex.join(command)}"
            )
        self.say(f"{spec.writes} {name} is missing or out of date: running `stylerf {spec.verb}` first")
        return self._execute(spec, run, inputs, config, name, False)

    def _execute(
        self, spec: Spec, run: Run, inputs: dict[str, Artifact], config: Any, name: str, force: bool
    ) -> Artifact:
        artifact, reused = execute(spec, run, self.work, name, inputs, config, self.context, force, protect=True)
        if reused:
            self.say(f"{spec.writes} {name} is up to date (--force rebuilds it)")
        return artifact

    def reusable(self, spec: Spec, source: Artifact) -> Artifact | None:
        """Return what an earlier command made from `source` with its own options, if it is up to date.

        Such an artifact is kept unless options are set for the verb that makes it.
        """
        if self.options.table(spec.verb):
            return None

        def name() -> str:
            made = self.made_from(spec.writes, spec.stage, source)
            current = made is not None and made.manifest.revision == spec.revision and not self.work.outdated(made)
            return made.name if made is not None and current else ""

        # Only names travel between processes: each opens the artifact itself.
        found = agree(self.processes, name)
        return self.work.get(spec.writes, found) if found else None

    def made_from(self, kind: str, stage: str, source: Artifact) -> Artifact | None:
        """Return the newest artifact that a stage made from the current version of `source`, or None."""
        made = [
            one
            for one in self.work.artifacts(kind)
            if one.manifest.stage == stage and any(ref.digest == source.digest for ref in one.manifest.inputs)
        ]
        return next(iter(newest(made)), None)
