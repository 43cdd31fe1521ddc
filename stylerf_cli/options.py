"""The options that a verb runs with: from its flags, and from `--config FILE.toml`.

A file holds options of the verb that is run at its top, `seed`, `device`, `threads` and `memory`, and tables named
after verbs, of which each verb reads its own: one file serves a whole chain of stages.

    seed = 7
    [fit]
    budget = "60s"
    [stylize]
    method = "arf"
"""

import argparse
import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from schemas.errors import UsageError
from stages.run import cgroups
from stages.run.memory import bytes_of
from stylerf_cli.arguments import build_config, nearest, read_toml

COMMON_KEYS: dict[str, type] = {"seed": int, "device": str, "threads": int, "memory": str}
LARGEST_SEED = 2**32 - 1  # pycolmap's
_DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class Common:
    """The common options as they apply. device may still be `auto`. memory: bytes, 0 for most of what is free.

    threads: as asked for, or (not threads_given) as many as this process may use, in which case the libraries' own
    defaults stand: torch leaves the second thread of a core alone, and rightly.
    """

    seed: int = 0
    device: str = "auto"
    threads: int = 1
    threads_given: bool = False
    memory: int = 0


class Options:
    """Reads the flags and the file once; gives the config of the verb and of the stages before it.

    others: configs of the verb's other uses, whose keys may stand in its table too.
    """

    def __init__(self, verb: str, given: argparse.Namespace, verbs: list[str], others: Collection[type] = ()) -> None:
        self.verb, self._given, self._others = verb, given, others
        self._path: Path | None = given.config
        content = read_toml(self._path) if self._path else {}
        self._tables = {key: value for key, value in content.items() if key in verbs and isinstance(value, dict)}
        top = {key: value for key, value in content.items() if key not in self._tables}
        if unknown := [key for key, value in top.items() if isinstance(value, dict)]:
            raise UsageError(f"{self._path}: there is no verb {unknown[0]!r}{nearest(unknown[0], verbs)}")
        self._common = {key: top.pop(key) for key in COMMON_KEYS if key in top}
        self._top = top
        for key, value in self._common.items():
            if not isinstance(value, COMMON_KEYS[key]) or isinstance(value, bool):
                raise UsageError(
                    f"{self._path}: {key} takes a value of type {COMMON_KEYS[key].__name__}, not {value!r}"
                )

    def config(self, config: type | None) -> Any:
        """The config of the verb that is run; None for a verb without options of its own."""
        table = {**self._top, **self._tables.get(self.verb, {})}
        if config is None:
            if table:
                raise UsageError(f"{self._path}: {self.verb} has no option {min(table)!r}")
            return None
        return build_config(config, self._given, table, str(self._path), self._others)

    def table(self, verb: str) -> dict[str, Any]:
        """What the file says of another verb, empty where it says nothing."""
        return self._tables.get(verb, {})

    def config_of(self, verb: str, config: type) -> Any:
        """The config of another verb, for a stage that is brought up to date: its table of the file, else defaults."""
        return build_config(config, argparse.Namespace(), self.table(verb), f"{self._path} [{verb}]")

    def common(self) -> Common:
        """Seed, device, threads and memory by flag, file or default."""
        values: dict[str, Any] = {}
        for key in COMMON_KEYS:
            flag = getattr(self._given, key, None)
            if flag is not None:
                values[key] = flag
            elif key in self._common:
                values[key] = self._common[key]
        if values.get("device", "auto") not in _DEVICES:
            raise UsageError(f"{self._path}: device is {values['device']!r}; expected one of {', '.join(_DEVICES)}")
        if not 0 <= values.get("seed", 0) <= LARGEST_SEED:
            where = f"{self._path}: seed" if self._given.seed is None else "--seed"
            raise UsageError(f"{where} is {values['seed']}; expected 0 to {LARGEST_SEED}")
        given = "threads" in values
        if "memory" in values:
            try:
                values["memory"] = bytes_of(values["memory"])
            except ValueError as error:
                raise UsageError(f"{self._path}: memory is {error}") from error
        if values.setdefault("threads", _usable_threads()) < 1:
            raise UsageError(f"{self._path}: threads is {values['threads']}; expected at least 1")
        return Common(**values, threads_given=given)


def _usable_threads() -> int:
    """Those of this process; of what a machine has, where several are started side by side on it, a part."""
    return max(1, _usable_cores() // int(os.environ.get("LOCAL_WORLD_SIZE", "1")))


def _usable_cores() -> int:
    """Those that this process may run on, and of a container's or a job's quota of time whole ones."""
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, int(min(allowed, cgroups.cores())))
