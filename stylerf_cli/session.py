"""One running command: its options, its output and its pipeline."""

import argparse
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from schemas.errors import UsageError
from stages.pipeline.distributed import join, prints
from stages.pipeline.resources import claim, resolved_device
from stages.run.memory import bytes_of
from stylerf_cli.arguments import DEVICES, build_config, nearest, read_toml
from stylerf_cli.output import write_lines
from stylerf_cli.progress import Bars

COMMON_KEYS: dict[str, type] = {"seed": int, "device": str, "threads": int, "memory": str}
LARGEST_SEED = 2**32 - 1  # pycolmap's
Config = TypeVar("Config")


@dataclass(frozen=True)
class Common:
    """The common options. threads: None for the default. memory: bytes, 0 for most of what is free."""

    seed: int = 0
    device: str = "auto"
    threads: int | None = None
    memory: int = 0


class Options:
    """The options of the command's verb, and of its prerequisites (see stages.pipeline.stage_runner.StageOptions)."""

    def __init__(self, verb: str, flags: argparse.Namespace, verbs: list[str], others: Collection[type] = ()) -> None:
        """Read the file.

        Args:
            verbs: all verbs, which may have tables.
            others: configs of the verb's other uses, whose keys its table may contain too.
        """
        self.verb, self._flags, self._others = verb, flags, others
        self._path: Path | None = flags.config
        content = read_toml(self._path) if self._path else {}
        self._tables = {key: value for key, value in content.items() if key in verbs and isinstance(value, dict)}
        top = {key: value for key, value in content.items() if key not in self._tables}
        if unknown := [key for key, value in top.items() if isinstance(value, dict)]:
            raise UsageError(f"{self._path}: unknown verb {unknown[0]!r}{nearest(unknown[0], verbs)}")
        self._common = {key: top.pop(key) for key in COMMON_KEYS if key in top}
        self._top = top
        for key, value in self._common.items():
            if not isinstance(value, COMMON_KEYS[key]) or isinstance(value, bool):
                raise UsageError(
                    f"{self._path}: {key} takes a value of type {COMMON_KEYS[key].__name__}, not {value!r}"
                )

    def config(self, config: type | None) -> Any:
        """Return the config of the command's verb, None for a verb without its own options."""
        table = {**self._top, **self._tables.get(self.verb, {})}
        if config is None:
            if table:
                raise UsageError(f"{self._path}: {self.verb} has no option {min(table)!r}")
            return None
        return build_config(config, self._flags, table, str(self._path), self._others)

    def file_for_others(self) -> Path | None:
        """Return the file for commands that this one runs, None without one.

        Raises:
            UsageError: it contains options of this verb outside a table, which the others would apply to themselves.
        """
        if self._path and self._top:
            raise UsageError(
                f"{self._path}: {min(self._top)!r} is outside a table, so it would also apply to the commands that "
                f"`stylerf {self.verb}` runs; put it under [{self.verb}]"
            )
        return self._path

    def table(self, verb: str) -> dict[str, Any]:
        """Return the file's table of a verb, empty without one."""
        return self._tables.get(verb, {})

    def config_of(self, verb: str, config: type[Config]) -> Config:
        """Return the config of a prerequisite: its table of the file, defaults for the rest."""
        built: Config = build_config(config, argparse.Namespace(), self.table(verb), f"{self._path} [{verb}]")
        return built

    def common(self) -> Common:
        """Return seed, device, threads and memory, from flag, file or default."""
        values: dict[str, Any] = {}
        for key in COMMON_KEYS:
            flag = getattr(self._flags, key, None)
            if flag is not None:
                values[key] = flag
            elif key in self._common:
                values[key] = self._common[key]
        if values.get("device", "auto") not in DEVICES:
            raise UsageError(f"{self._path}: device is {values['device']!r}; expected one of {', '.join(DEVICES)}")
        if not 0 <= values.get("seed", 0) <= LARGEST_SEED:
            where = f"{self._path}: seed" if self._flags.seed is None else "--seed"
            raise UsageError(f"{where} is {values['seed']}; expected 0 to {LARGEST_SEED}")
        if "memory" in values:
            try:
                values["memory"] = bytes_of(values["memory"])
            except ValueError as error:
                raise UsageError(f"{self._path}: memory is {error}") from error
        if values.get("threads", 1) < 1:
            raise UsageError(f"{self._path}: threads is {values['threads']}; expected at least 1")
        return Common(**values)


if TYPE_CHECKING:  # every verb imports this module, and numpy must not delay `--help`
    from schemas.work_folder import Artifact
    from stages.pipeline.pipeline import Pipeline
    from stages.run.progress import Progress


def made(kind: str, artifact: "Artifact") -> dict[str, Any]:
    """Return what verbs that make an artifact report about it."""
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

    def file_for_others(self) -> Path | None:
        """Return what Options.file_for_others does."""
        return self._options.file_for_others()

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
