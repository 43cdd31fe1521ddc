"""The campaign's fixtures: a tiny still life, a work folder with every kind of artifact, and every stage as a command
on a copy of it, limited by steps so that two runs give the same bytes."""

import json
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from schemas.work_folder import WorkFolder
from stages.pipeline.demo_scene import PAINTING, write_demo
from stages.run.progress import Silent
from tests.stages.photo_room import walk, write_photos
from tests.stylerf_cli.nursery import Command, Nursery

QUIET = ("--quiet", "--threads", "1")
OFTEN = ("--checkpoint-every-seconds", "0.03")
FIT = ("--budget", "60", "--no-buffers", "--capacity", "fixed:32x8x8", "--samples", "3000")
GROWING = ("--budget", "200", "--no-buffers", "--samples", "1500", "--held-out", "2", "--min-gain", "0.13")
DEFORM = ("--steps", "20", "--vertices", "12", "--width", "16", "--patience-db", "0")
COLORS = ("--levels", "4", "--finest", "64", "--table-bits", "12")
WHOLE = ("--at", "#0:16,16", "--tolerance", "0", "--neck", "0", "--most", "1")
FEW = ("--palette-steps", "10", "--pruned-steps", "4", "--colors", "3", "--max-colors", "3")
STRESS = ("--methods", "fit", "--faults", "seeds", "--seeds", "1", "--budget", "20", "--side", "32", "--quick")


@dataclass(frozen=True)
class Stage:
    """A command that makes artifacts in a copy of the folder `base`: bare, made, or none.

    In its arguments, WORK is a placeholder for that copy.
    """

    name: str
    arguments: tuple[object, ...]
    base: Path | None

    def command(self, work: Path) -> tuple[object, ...]:
        """Return its arguments for that work folder."""
        return tuple(work if one is WORK else one for one in self.arguments) + QUIET


class _Mark:
    """Placeholder for the work folder in a stage's arguments."""


WORK = _Mark()


@dataclass
class Ground:
    """photos, room: posed photos with truth, and photos alone. made: a work folder with every kind of artifact."""

    folder: Path
    photos: Path
    room: Path
    made: Path
    stages: dict[str, Stage] = field(default_factory=dict)

    @property
    def painting(self) -> Path:
        """Return the style image."""
        return self.photos / PAINTING


def prepared(folder: Path, nursery: Nursery, names: Sequence[str] = (), plain: bool = False) -> Ground:
    """Make the fixtures in `folder`. names: of the stages to prepare, all if empty. plain: make only a scene, its field
    and frames."""
    ground = Ground(folder, folder / "photos", folder / "room", folder / "made")
    write_demo(ground.photos, 32, 10, 2, 0, 1, Silent())
    write_photos(ground.room, walk(6, (0.45, 1.0), width=240, height=180, focal=230.0))
    style = ("--style", ground.painting, "--budget", "6", "--refit-steps", "30", *COLORS)
    for arguments in (
        ("import", ground.photos, WORK),
        ("fit", WORK, *FIT),
        ("render", WORK, "--of", "fit", "--path", "test"),
        *(() if plain else _of_every_kind(style)),
    ):
        done(nursery, ground.folder / "said", *Stage("", arguments, None).command(ground.made))
    for stage in _stages(ground, (*style, *OFTEN)):
        if not names or stage.name in names:
            ground.stages[stage.name] = stage
    (folder / "edit.toml").write_text('[finetune]\nbudget = "10"\nrays = 512\n')
    for name in ("trials", "bare"):
        (folder / name).mkdir()
    return ground


def _of_every_kind(style: tuple) -> list[tuple[object, ...]]:
    """Return the commands that make the rest."""
    return [
        ("deform", WORK, "--of", "fit", *DEFORM),
        ("stylize", WORK, "--of", "fit", "--name", "painted", *style),
        ("stylize", WORK, "--of", "fit", "--name", "palette", "--method", "palettenerf", "--budget", "10",
         "--refit-steps", "10", "--pixels", "256", *COLORS),
        ("select", WORK, "--of", "fit", *WHOLE, "--name", "all"),
        ("extract", WORK, "--region", "all"),
        ("stylize", WORK, "--region", "all", "--recolor", "--palette", "0=#808080", "--name", "gray", *FEW),
        ("distill", WORK, "--edit", "gray"),
        ("render", WORK, "--of", "fit", "--path", "orbit", "--count", "4", "--scale", "0.5"),
        ("render", WORK, "--of", "painted", "--path", "test"),
        ("eval", WORK, "--of", "fit", "--perceptual", "none"),
    ]  # fmt: skip


def _stages(ground: Ground, style: tuple) -> list[Stage]:
    fit = ("--of", "fit")
    decompose = (
        "--method",
        "palettenerf",
        "--budget",
        "30",
        "--refit-steps",
        "15",
        "--pixels",
        "512",
        *COLORS,
        *OFTEN,
    )
    learn = ("--palette-steps", "20", "--style-steps", "6", "--style-side", "64", "--budget", "1h")
    finetune = ("--edit", "gray", "--budget", "30", "--rays", "1024", *OFTEN)
    return [
        Stage("import", ("import", ground.photos, WORK), None),
        Stage("import of photos alone", ("import", ground.room, WORK, "--sfm-features", "512"), None),
        *(
            Stage(name, arguments, ground.made)
            for name, arguments in {
                "fit": ("fit", WORK, *FIT, *OFTEN, "--seed", "1", "--name", "x"),
                "fit that grows": ("fit", WORK, *GROWING, *OFTEN, "--name", "x"),
                "deform": ("deform", WORK, *fit, "--steps", "40", *DEFORM[2:], *OFTEN, "--name", "x"),
                "stylize arf": ("stylize", WORK, *fit, *style, "--rays", "dilated", "--name", "x"),
                "stylize desrf": ("stylize", WORK, *fit, "--method", "desrf", *style, "--name", "x"),
                "stylize snerf": ("stylize", WORK, *fit, "--method", "snerf", *style, "--rounds", "2", "--image-share",
                                  "0.4", "--image-steps", "2", "--name", "x"),
                "stylize refnpr": ("stylize", WORK, *fit, "--method", "refnpr", *style, "--reference-steps", "6",
                                   "--name", "x"),
                "stylize palettenerf": ("stylize", WORK, *fit, *decompose, "--name", "x"),
                "recolor": ("stylize", WORK, "--of", "palette", "--method", "palettenerf", "--palette", "0=#2040c0",
                             "--name", "x"),
                "select": ("select", WORK, *fit, *WHOLE, "--steps", "3", "--name", "x"),
                "extract": ("extract", WORK, "--region", "all", "--name", "x"),
                "stylize a region": ("stylize", WORK, "--region", "all", "--style", ground.painting, *learn, *OFTEN,
                                     "--name", "x"),
                "change a palette": ("stylize", WORK, "--region", "all", "--recolor", "--palette", "0=#ff0000", *FEW,
                                     "--name", "x"),
                "distill": ("distill", WORK, "--edit", "gray", "--name", "x"),
                "finetune": ("finetune", WORK, *finetune, "--name", "x"),
                "edit": ("edit", WORK, *fit, *WHOLE, "--recolor", "--palette", "0=#80ff80", *FEW, "--config",
                         ground.folder / "edit.toml", "--name", "x"),
                "render": ("render", WORK, *fit, "--path", "orbit", "--count", "6", "--name", "x"),
                "film": ("render", WORK, *fit, "--path", "orbit", "--count", "6", "--video", "--name", "x"),
                "eval": ("eval", WORK, "--of", "painted", "--perceptual", "none"),
                "stress": ("stress", WORK, *STRESS, "--remedies", "off"),
            }.items()
        ),
    ]  # fmt: skip


def done(nursery: Nursery, said: Path, *command: object) -> Command:
    """Run a command that must succeed."""
    ended = nursery.run(said, *command)
    assert ended.code == 0, f"stylerf {' '.join(map(str, command))}: exit code {ended.code}: {ended.err}"
    return ended


@contextmanager
def copy_of(base: Path | None, parent: Path) -> Iterator[Path]:
    """Yield `work` in a fresh folder, a copy of `base` or empty if that is None; delete it at the end."""
    folder = parent / f"t{random.SystemRandom().getrandbits(48):012x}"
    folder.mkdir(parents=True)
    try:
        if base is not None:
            shutil.copytree(base, folder / "work")
        yield folder / "work"
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def contents(work: Path) -> dict[str, dict[str, str]]:
    """Return the digest of every file of every artifact, and the outcomes of a stress test without their durations.

    Of reports, whose files state durations too, it is the figures, without the number of runs that a report took.
    """
    store = WorkFolder(work)
    found = {
        f"{one.kind}/{one.name}": {key: repr(value) for key, value in one.manifest.figures.items() if key != "runs"}
        if one.kind == "report"
        else {record.path: record.sha256 for record in one.manifest.files}
        for one in store.artifacts()
    }
    for run in sorted(work.glob("stress/runs/*.json")):
        reported = json.loads(run.read_text())
        found[f"stress/{run.name}"] = {key: repr(value) for key, value in reported.items() if "seconds" not in key}
    return found


def leftovers(work: Path) -> list[str]:
    """Return partial runs and temporary files; there are none if the last command succeeded."""
    return sorted(
        str(path.relative_to(work))
        for path in work.rglob(".*")
        if not path.name.endswith(".lock") and not any(one.endswith(".partial") for one in path.parent.parts)
    )


def verified(nursery: Nursery, work: Path, output: Path | None = None) -> str:
    """Return what `stylerf verify` finds wrong with a work folder; empty if it is valid or missing.

    output: folder for its stdout and stderr, beside the work folder if None.
    """
    if not work.is_dir():
        return ""
    ended = nursery.run(output or work.parent / "verify", "verify", work, "--quiet")
    nothing = ended.code == 3 and "contains no artifact" in ended.err
    return "" if ended.code == 0 or nothing else f"verify ends with {ended.code}: {ended.err.strip()}"


def machine_of_strace() -> bool:
    """Return whether strace can inject faults here."""
    try:
        command = ["strace", "-o", "/dev/null", "-e", "inject=fsync:error=EIO", sys.executable, "-c", "pass"]
        return subprocess.run(command, capture_output=True, check=False, timeout=60).returncode == 0
    except (OSError, subprocess.SubprocessError):
        return False
