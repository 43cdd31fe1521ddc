"""The long stages on tiny inputs: each as a command, brought to its end or to a sudden one, and compared."""

import random
import re
import shutil
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from schemas.work_folder import Artifact, WorkFolder
from tests.stylerf_cli.nursery import Command, Nursery

FOLLOWED_EVERY_SECONDS = 0.002
STAGES = ("import", "fit", "fit that grows", "deform", "stylize", "stylize by turns", "stylize after a view",
          "stylize with shapes", "stylize a region", "stylize by a palette", "finetune", "render", "eval")  # fmt: skip
# One of each kind: a loop that learns a field, one in phases that begins with a painting, one that writes frame after
# frame. The rest goes the same ways: its turn comes with the slow tests.
QUICK = ("fit", "stylize", "render")
IN_THE_GATE = [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in STAGES]
TAKEN = re.compile(r"seconds|runs|peak_memory_mb")


@dataclass(frozen=True)
class LongStage:
    """A verb's command without its name, the kind that it writes, and the processor time of its work, from its first
    file to its last. apart: the work folder of `whole`, where the others' cannot hold it too."""

    arguments: tuple[object, ...]
    kind: str
    seconds: float = 0.0
    apart: Path | None = None

    def command(self, name: str) -> tuple[object, ...]:
        """Writes the artifact `name`."""
        return (*self.arguments, "--name", name)

    def partial(self, work: Path, name: str) -> Path:
        """Where the run in progress lies."""
        return work / self.kind / f".{name}.partial"

    def whole(self, work: Path) -> Artifact:
        """What an undisturbed run made."""
        return WorkFolder(self.apart or work).get(self.kind, "whole")


def arguments_of(stage: str, work: Path, photos: Path, room: Path) -> tuple[tuple[object, ...], str]:
    """A command of that stage that takes about a second, and the kind it writes."""
    often = ("--checkpoint-every-seconds", "0.03")
    style = ("--style", photos / "painting.png", "--refit-steps", "60", "--levels", "4", "--finest", "64",
             "--table-bits", "12", *often)  # fmt: skip
    return {
        "import": (("import", room, work, "--sfm-features", "1024"), "scene"),
        "fit": (("fit", work, "--budget", "150", "--no-buffers", "--capacity", "fixed:96x8x8", "--samples", "3000",
                 *often), "field"),
        "fit that grows": (("fit", work, "--budget", "480", "--no-buffers", "--samples", "1500", "--held-out", "2",
                            "--min-gain", "0.13", *often), "field"),
        "deform": (("deform", work, "--of", "fit", "--steps", "60", "--vertices", "16", "--width", "32",
                    "--patience-db", "0", *often), "field"),
        "stylize": (("stylize", work, "--of", "fit", "--budget", "12", "--rays", "dilated", *style), "field"),
        "stylize by turns": (("stylize", work, "--of", "fit", "--method", "snerf", "--budget", "24", "--rounds", "2",
                              "--image-share", "0.4", "--image-steps", "2", *style), "field"),
        "stylize after a view": (("stylize", work, "--of", "fit", "--method", "refnpr", "--budget", "12",
                                  "--reference-steps", "8", *style), "field"),
        "stylize with shapes": (("stylize", work, "--of", "fit-deformed", "--method", "desrf", "--budget", "12",
                                 *style), "field"),
        "stylize a region": (("stylize", work, "--region", "all", "--style", photos / "painting.png", "--palette-steps",
                              "30", "--style-steps", "8", "--style-side", "64", "--budget", "1h", *often), "edit"),
        "stylize by a palette": (("stylize", work, "--of", "fit", "--method", "palettenerf", "--budget", "40",
                                  "--refit-steps", "20", "--pixels", "512", "--levels", "4", "--finest", "64",
                                  "--table-bits", "12", *often), "field"),
        "finetune": (("finetune", work, "--edit", "gray", "--budget", "40", "--rays", "1024", *often), "field"),
        "render": (("render", work, "--of", "fit", "--path", "orbit", "--count", "24", "--scale", "2", "--video"),
                   "frames"),
        "eval": (("eval", work, "--of", "painting-arf", "--perceptual", "none"), "report"),
    }[stage]  # fmt: skip


def before(stage: str, work: Path) -> tuple[tuple[object, ...], ...]:
    """Commands that make what a stage of a local edit starts from: a region of all that is solid, and its edit."""
    if stage not in ("stylize a region", "finetune"):
        return ()
    everything = ("--at", "#0:16,16", "--tolerance", "0", "--neck", "0", "--most", "1")
    made = (("select", work, *everything, "--name", "all"), ("extract", work, "--region", "all"))
    if stage == "stylize a region":
        return made
    few = ("--palette-steps", "10", "--pruned-steps", "4", "--colors", "3", "--max-colors", "3")
    edit = ("stylize", work, "--region", "all", "--recolor", "--palette", "0=#808080", "--name", "gray", *few)
    return (*made, edit, ("distill", work, "--edit", "gray"))


def appeared(path: Path, command: Command, seconds: float = 120.0) -> bool:
    """Waits for `path`; False where the command ends before it is there."""
    end = time.monotonic() + seconds
    while not path.exists():
        if command.poll() is not None:
            return False
        assert time.monotonic() < end, f"{path} did not appear; the command said: {command.err}"
        time.sleep(FOLLOWED_EVERY_SECONDS)
    return True


def undisturbed(nursery: Nursery, arguments: tuple, kind: str, work: Path) -> LongStage:
    """Makes the artifact `whole` and takes the time."""
    stage = LongStage(arguments, kind)
    command = nursery.start(work.parent / "said", *stage.command("whole"))
    assert appeared(stage.partial(work, "whole"), command)
    begun = used = command.cpu_seconds()
    while command.poll(FOLLOWED_EVERY_SECONDS) is None:
        used = max(used, command.cpu_seconds())
    assert command.code == 0, command.err
    return LongStage(arguments, kind, used - begun)


def moments(seed: int, count: int) -> Iterator[float]:
    """Random shares of a stage's time, evenly spread, the late ones first: what a late death leaves tells the most."""
    chance = random.Random(seed)
    while True:
        yield from ((part + chance.random()) / count for part in reversed(range(count)))


def stopped(nursery: Nursery, stage: LongStage, work: Path, name: str, number: int, moment: float) -> Command:
    """Starts the stage and sends it a signal after that share of its time, counted from its first file."""
    command = nursery.start(work.parent / "said", *stage.command(name))
    if appeared(stage.partial(work, name), command):
        begun = command.cpu_seconds()
        while command.poll(FOLLOWED_EVERY_SECONDS) is None and command.cpu_seconds() - begun < moment * stage.seconds:
            pass
        command.send(number)
    return command


def killed_until_done(nursery: Nursery, stage: LongStage, work: Path, kills: int, seed: int) -> Artifact:
    """kill -9 at `kills` random moments, each run going on from what the one before left; then undisturbed.

    A run that ends before its moment comes is looked at, deleted, and begun again. Where it had begun at the start, the
    stage takes less than was thought (its first run compiled kernels): later moments come earlier.
    """
    deaths, store = 0, WorkFolder(work)
    shutil.rmtree(work / stage.kind / "killed", ignore_errors=True)
    for moment in islice(moments(seed, kills), 6 * kills):
        afresh = not stage.partial(work, "killed").exists()
        command = stopped(nursery, stage, work, "killed", signal.SIGKILL, moment)
        command.wait()
        for artifact in store.artifacts():
            artifact.verify()
        if (work / stage.kind / "killed").exists():
            assert command.code in (0, -signal.SIGKILL), command.err
            made, whole = store.get(stage.kind, "killed"), stage.whole(work)
            assert digests(made) == digests(whole), f"after {deaths} deaths: {command.err}"
            shutil.rmtree(work / stage.kind / "killed")
            if afresh:
                stage = replace(stage, seconds=0.7 * stage.seconds)
            continue
        assert command.code == -signal.SIGKILL, command.err
        deaths += 1
        if deaths == kills:
            break
    assert deaths == kills, f"{deaths} deaths only: {command.err}"
    last = nursery.run(work.parent / "said", *stage.command("killed"))
    assert last.code == 0, last.err
    return assert_same(store, stage)


def assert_same(store: WorkFolder, stage: LongStage, name: str = "killed") -> Artifact:
    """The artifact `name` has the files and figures of `whole`, but for the time it took, and left nothing behind."""
    made, whole = store.get(stage.kind, name), stage.whole(store.root)
    made.verify()
    assert digests(made) == digests(whole)
    assert timeless(made.manifest.figures) == timeless(whole.manifest.figures)
    assert not stage.partial(store.root, name).exists()
    return made


def digests(artifact: Artifact) -> dict[str, str]:
    """Digest of each file: to compare these is quick even where megabytes differ."""
    return {record.path: record.sha256 for record in artifact.manifest.files}


def timeless(figures: Any) -> Any:
    """Figures without those that tell how long it took."""
    if isinstance(figures, dict):
        return {key: timeless(value) for key, value in figures.items() if not TAKEN.search(key)}
    return [timeless(one) for one in figures] if isinstance(figures, list) else figures
