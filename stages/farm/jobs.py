"""The jobs of a table: one command of `stylerf` each, what it waits for, and the artifact that it makes."""

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from schemas.manifest import MANIFEST
from stages.configs import flags_of
from stages.configs.render import RenderConfig, label_of
from stages.farm.table import Scene, Table
from stylerf.geometry.camera_paths import PATHS

SCENE = "main"  # the name that `import` gives by default
IMPORT, FIT, DEFORM, STYLIZE, EDIT, SHARD, RENDER, EVAL = (
    "import", "fit", "deform", "stylize", "edit", "shard", "render", "eval",
)  # fmt: skip
FRAMES = "farm/frames.toml"  # options of the frames that evaluations render
RULES = (IMPORT, FIT, DEFORM, STYLIZE, EDIT, SHARD, RENDER, EVAL)


@dataclass(frozen=True)
class Job:
    """One command.

    Attributes:
        rule: one of RULES.
        scene: name of the scene, which is also that of its work folder.
        kind, name: the artifact that it makes.
        argv: of `stylerf`, without the program; threads and memory are added by whoever runs it.
        after: keys of the jobs that it waits for.
        files: external files and folders that it reads.
        method: of a stylization or edit; empty for others.
        budget: training time or number of steps, empty for none.
        frames: number of frames that it renders, 0 for unknown or none.
    """

    rule: str
    scene: str
    kind: str
    name: str
    argv: tuple[str, ...]
    after: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    method: str = ""
    budget: str = ""
    frames: int = 0

    @property
    def key(self) -> str:
        """The artifact's path below the table's folder."""
        return f"{self.scene}/{self.kind}/{self.name}"

    @property
    def manifest(self) -> str:
        """The manifest of its artifact, relative to the table's folder."""
        return f"{self.key}/{MANIFEST}"


@dataclass(frozen=True)
class Axes:
    """The position of a field in the table. style, method: empty for a fit. An edit is a style with method `edit`."""

    scene: str
    style: str
    method: str
    seed: int


def jobs_of(table: Table) -> dict[str, Job]:
    """Return the jobs of a table by key, each after those that it waits for."""
    return {job.key: job for scene in table.scenes for job in _of_scene(table, scene)}


def fields_of(table: Table) -> dict[tuple[str, str], Axes]:
    """Return the axes of every fit and stylization of a table, by scene and name of the field."""
    found = {}
    for scene in table.scenes:
        for seed in table.seeds:
            found[scene.name, f"fit-s{seed}"] = Axes(scene.name, "", "", seed)
            for style in table.styles:
                for method in table.methods:
                    found[scene.name, f"{style}-{method}-s{seed}"] = Axes(scene.name, style, method, seed)
            for edit in table.edits:
                found[scene.name, f"edit-{edit}-s{seed}"] = Axes(scene.name, edit, EDIT, seed)
    return found


def _of_scene(table: Table, scene: Scene) -> Iterator[Job]:
    work = scene.name
    source = (str(scene.source), work, *flags_of(scene.imported))
    first = Job(IMPORT, scene.name, "scene", SCENE, (IMPORT, *source), files=(scene.source,))
    yield _common(table, first)
    for seed in table.seeds:
        for job in _of_seed(table, scene, seed, first.key):
            yield _common(table, job, seed)


def _common(table: Table, job: Job, seed: int = 0) -> Job:
    seeded = ("--seed", str(seed)) if seed else ()
    return replace(job, argv=(*job.argv, *seeded, "--device", table.device))


def _of_seed(table: Table, scene: Scene, seed: int, first: str) -> Iterator[Job]:
    work, name = scene.name, scene.name
    fit = Job(
        FIT, name, "field", f"fit-s{seed}", (FIT, work, "--name", f"fit-s{seed}", *flags_of(scene.fit)), (first,),
        budget=scene.fit.budget,
    )  # fmt: skip
    yield fit
    measured = yield from _shown(scene, fit, ())
    before = {FIT: (fit, measured)}
    if any(config.method == "desrf" for config in table.methods.values()):
        deformed = Job(
            DEFORM, name, "field", f"fit-deformed-s{seed}",
            (DEFORM, work, "--of", fit.name, "--name", f"fit-deformed-s{seed}", *flags_of(scene.deform)), (fit.key,),
        )  # fmt: skip
        yield deformed
        # Stylizations are compared with the field before them, whose frames several jobs would otherwise render at
        # once.
        before[DEFORM] = (deformed, (yield from _measured(scene, deformed, ())))
    for style, file in table.styles.items():
        for method, config in table.methods.items():
            field, frames = before[DEFORM if config.method == "desrf" else FIT]
            flags = flags_of(replace(config, style=str(file)))
            stylized = Job(
                STYLIZE, name, "field", f"{style}-{method}-s{seed}",
                (STYLIZE, work, "--of", field.name, "--name", f"{style}-{method}-s{seed}", "--only", *flags),
                (field.key,), (file,), config.method, config.budget,
            )  # fmt: skip
            yield stylized
            yield from _shown(scene, stylized, (*frames, *measured))
    for edit, config in table.edits.items():
        edited = Job(
            EDIT, name, "field", f"edit-{edit}-s{seed}",
            (EDIT, work, "--of", fit.name, "--name", f"edit-{edit}-s{seed}", *flags_of(config)), (fit.key,),
            method=EDIT, budget=config.budget,
        )  # fmt: skip
        yield edited
        yield from _shown(scene, edited, measured)


def _shown(scene: Scene, field: Job, also: Iterable[str]) -> "Generator[Job, None, tuple[str, ...]]":
    """Add renders in shards, their join, and the evaluation, which uses these frames if it can; return its key."""
    frames = tuple(_rendered(scene, field))
    yield from frames
    return (yield from _measured(scene, field, (*also, *(job.key for job in frames[-1:]))))


def _rendered(scene: Scene, field: Job) -> Iterator[Job]:
    config = scene.render
    if config is None:
        return
    whole = _frames_name(field.name, config)
    count = config.count if config.path in PATHS else 0
    command = (RENDER, scene.name, "--of", field.name)
    shards = []
    for index in range(scene.shards if scene.shards > 1 else 0):
        low, high = (place * count // scene.shards for place in (index, index + 1))
        part = f"{low}-{high - 1}"
        # A video needs all frames.
        flags = flags_of(replace(config, frames=part, video=False, fps=RenderConfig.fps))
        shards.append(
            Job(SHARD, scene.name, "frames", f"{whole}-{part}", (*command, "--name", f"{whole}-{part}", *flags),
                (field.key,), frames=high - low)
        )  # fmt: skip
    yield from shards
    after = (field.key, *(job.key for job in shards))
    yield Job(
        RENDER, scene.name, "frames", whole, (*command, "--name", whole, *flags_of(config)), after,
        frames=0 if shards else count,
    )  # fmt: skip


def _frames_name(field: str, config: RenderConfig) -> str:
    return f"{field}-{label_of(config.path)}" + ("" if config.strength == 1 else f"-strength-{config.strength:g}")


def _measured(scene: Scene, field: Job, also: Iterable[str]) -> "Generator[Job, None, tuple[str, ...]]":
    """The evaluation; return its key in a tuple, empty if the scene is not evaluated."""
    config = scene.evaluate
    if config is None:
        return ()
    along = ("--path", scene.path) if scene.path else ()
    # Fits and edits reject options that only stylizations have, and stylizations those that only edits have.
    if field.rule != STYLIZE:
        config = replace(config, ceiling=0, reference=())
    if field.rule != EDIT:
        config = replace(config, masks="", train_views=False)
    elif not config.masks:
        along = (*along, "--region", field.name)
    argv = (
        EVAL, scene.name, "--of", field.name, "--name", field.name, "--config", FRAMES, *along, *flags_of(config),
    )  # fmt: skip
    job = Job(EVAL, scene.name, "report", field.name, argv, (field.key, *dict.fromkeys(also)))
    yield job
    return (job.key,)
