"""Runs any stage the same way: reuse what stands, else run under a lock, resume, measure, finish as one step."""

import errno
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from schemas.atomic_write import out_of_resources
from schemas.canonical_json import plain
from schemas.errors import ArtifactStale, BadInput, OutOfResources, StylerfError, UsageError
from schemas.partial_artifact import EXPENSIVE_SECONDS, UnlikeInterrupted
from schemas.work_folder import Artifact, PartialArtifact, Recipe, WorkFolder, sources_of
from stages.configs import incidental
from stages.run.clock import Clock, peak_memory_mb
from stages.run.progress import Context

Run = Callable[[dict[str, Artifact], Any, PartialArtifact, Context], dict]

# Packages whose version can change a result; those that the run has imported are recorded.
RECORDED_PACKAGES = {
    "torch": "torch",
    "numpy": "numpy",
    "numba": "numba",
    "triton": "triton",
    "pycolmap": "pycolmap",
    "skimage": "scikit-image",
    "OpenEXR": "OpenEXR",
    "OpenImageIO": "OpenImageIO",
    "safetensors": "safetensors",
    "av": "av",
}


@dataclass(frozen=True)
class Spec:
    """What a stage is: its name, the verb that runs it, its code revision, and the kind of artifact that it writes.

    Raise `revision` when the same inputs and options give another result than before. parallel: several processes can
    run it together (Context.ranks). outside: for a stage that reads files which are no artifacts, their digests as they
    are now, by the option that has the digest they were asked for with.
    """

    stage: str
    verb: str
    revision: int
    writes: str
    parallel: bool = False
    outside: Callable[[Any], dict[str, str]] | None = None


def recipe_of(spec: Spec, inputs: dict[str, Artifact], config: Any, seed: int) -> Recipe:
    """The recipe by which `spec` would make its artifact from these inputs (by role) and options."""
    references = [artifact.reference(role) for role, artifact in sorted(inputs.items())]
    return Recipe(spec.stage, spec.revision, plain(config), references, seed, sorted(incidental(config)))


def without_folders(recipe: Recipe) -> Recipe:
    """The same recipe, in which files that are known by their digests are told by their names alone."""
    named = {key: _name_of(value) for key, value in recipe.config.items() if key in recipe.incidental}
    return replace(recipe, config={**recipe.config, **named})


def _name_of(value: Any) -> Any:
    """PATH -> its last part, VIEW=PATH -> VIEW= and its last part; in a list, of each."""
    if isinstance(value, list | tuple):
        return [_name_of(one) for one in value]
    if not isinstance(value, str):
        return value
    view, mark, path = value.partition("=")
    return f"{view}={Path(path).name}" if mark and "/" not in view else Path(value).name


def refuse_to_replace(work: WorkFolder, kind: str, name: str, sources: Iterable[Artifact]) -> None:
    """UsageError where the artifact `name` would take the place of what it is made from, directly or through others."""
    target = (work.root / kind / name).resolve()
    if any(one.path.resolve() == target for source in sources for one in [source, *sources_of(source)]):
        raise UsageError(f"{kind} {name} would replace what it is made from; give another --name")


def execute(
    spec: Spec,
    run: Run,
    work: WorkFolder,
    name: str,
    inputs: dict[str, Artifact],
    config: Any,
    context: Context,
    force: bool = False,
    careful: bool = False,
) -> tuple[Artifact, bool]:
    """The artifact `name` of `spec`, and whether it stood already.

    Unless `force`, an artifact of the same recipe (stage, revision, options, seed, digests of the inputs) is returned
    as it stands. Otherwise every input is verified, an interrupted run of the same recipe is taken up where it
    stopped, and the result replaces the older artifact of that name by one rename; it must be none of its sources.
    What an interruption, the machine (memory, space, permission, a disk that fails) or a fault that keeps the run
    leaves behind is kept for the next run; after any other fault it is deleted: the same state would fail again.
    What was read is verified once more before the result is finished: it may have changed while the stage ran.
    careful: a minute's work or more that was done with other options is not lost without a word: an interrupted run is
    kept (ArtifactStale), what stands or cannot be gone on with is told of.
    """
    recipe = recipe_of(spec, inputs, config, context.seed)
    recipe = without_folders(recipe) if context.no_paths else recipe
    standing = None if force else work.up_to_date(spec.writes, name, recipe)
    if standing:
        work.sweep(spec.writes, name)
        return standing, True
    refuse_to_replace(work, spec.writes, name, inputs.values())
    _verify(spec, recipe, inputs)
    try:
        partial = work.begin(spec.writes, name, recipe, careful and not force, rebuild=force)
    except UnlikeInterrupted as lost:
        raise ArtifactStale(
            f"an interrupted `stylerf {spec.verb}` of {spec.writes} {name}, {lost.seconds / 60:.0f} min of work with "
            f"{lost.options}, would be lost; run `stylerf {spec.verb}` with these to go on with it, with "
            "another --name to keep both, or with --force to begin anew"
        ) from lost
    except OSError as error:
        raise refusal_of_machine(error, work.root) or error from error
    if partial.lost:
        context.progress.say(
            f"an interrupted `stylerf {spec.verb}` of {spec.writes} {name}, {partial.lost}, cannot go on and is deleted"
        )
    if careful:
        tell_replaced(work, spec, name, recipe, context)
    try:
        # Another process may have made it between the look above and our lock.
        standing = None if force else work.up_to_date(spec.writes, name, recipe)
        if standing:
            partial.discard()
            return standing, True
        if partial.resumed:
            context.progress.say(f"going on with the interrupted {spec.verb} of {name}")
        return _run(spec, run, partial, inputs, config, replace(context, anew=force)), False
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        if refusal := refusal_of_machine(error, partial.folder):
            raise refusal from error
        if not _keeps_run(error):
            partial.discard()
        raise
    finally:
        partial.release()


def tell_replaced(work: WorkFolder, spec: Spec, name: str, recipe: Recipe, context: Context) -> None:
    """Says what takes a minute or more to make and is about to be replaced by what another recipe makes."""
    with suppress(StylerfError):  # what is not there, or cannot be read, is no loss
        made = Artifact(work.root / spec.writes / name).manifest
        before = Recipe(made.stage, made.revision, made.config, made.inputs, made.seed)
        if made.recipe != recipe.digest and made.seconds >= EXPENSIVE_SECONDS:
            other = [recipe.other_options(before), recipe.other_sources(before)]
            other = ", ".join(filter(None, other)) or "older options"
            context.progress.say(
                f"{spec.writes} {name}, {made.seconds / 60:.0f} min of work with {other}, is replaced once this "
                f"is done; `stylerf {spec.verb} --name NAME` keeps both"
            )


def _run(
    spec: Spec, run: Run, partial: PartialArtifact, inputs: dict[str, Artifact], config: Any, context: Context
) -> Artifact:
    with Clock(partial.folder, partial.resumed) as clock:
        figures = run(inputs, config, partial, context) or {}
        if clock.runs > 1:
            figures = {**figures, "runs": clock.runs}
        seconds, peak = clock.seconds, clock.peak_mb
    _refuse_changed(spec, partial.recipe, inputs, config)
    return partial.commit(
        device=context.device, threads=context.threads, versions=versions(), seconds=seconds, peak_memory_mb=peak,
        figures=figures,
    )  # fmt: skip


def _verify(spec: Spec, recipe: Recipe, inputs: dict[str, Artifact]) -> None:
    """ArtifactDamaged or ArtifactStale where an input is not what the recipe names."""
    named = {ref.role: ref.digest for ref in recipe.inputs}
    for role, artifact in inputs.items():
        artifact.verify()
        if artifact.digest != named[role]:
            raise ArtifactStale(
                f"{artifact.kind} {artifact.name} was made again while `stylerf {spec.verb}` read it; run the same "
                "command again"
            )


def _refuse_changed(spec: Spec, recipe: Recipe, inputs: dict[str, Artifact], config: Any) -> None:
    """As _verify, and BadInput where a file from outside is no longer what it was when the run began."""
    _verify(spec, recipe, inputs)
    for option, digest in (spec.outside(config) if spec.outside else {}).items():
        if getattr(config, option) not in ("", digest):
            what = option.removesuffix("_digest")
            raise BadInput(f"--{what} changed while `stylerf {spec.verb}` read it; run the same command again")


def versions() -> dict[str, str]:
    """Versions of python, stylerf and those of RECORDED_PACKAGES that this process has imported."""
    found = {"python": sys.version.split()[0]}
    names = {"stylerf": "stylerf"} | {m: p for m, p in RECORDED_PACKAGES.items() if m in sys.modules}
    for module, package in names.items():
        try:
            found[module] = version(package)
        except PackageNotFoundError:  # run from a checkout, or put on the path by hand
            found[module] = str(getattr(sys.modules.get(module), "__version__", "not installed"))
    return found


def _keeps_run(error: BaseException) -> bool:
    """Whether what is done stays: the fault says so, or somewhere behind it something could not be read or written."""
    if isinstance(error, StylerfError) and error.keeps_run:
        return True
    behind: BaseException | None = error
    while behind is not None:
        if isinstance(behind, OSError) and _passes(behind):
            return True
        behind = behind.__cause__
    return False


def _passes(error: OSError) -> bool:
    """Whether the same run may get past the fault another time; a path that leads nowhere does so again."""
    return error.errno not in (errno.ENOENT, errno.ENOTDIR, errno.EISDIR)


def refusal_of_machine(error: BaseException, where: Path) -> OutOfResources | None:
    """OutOfResources in words when `error` means lack of memory, disk space or permission, or a disk or system that
    fails; None for other faults."""
    if isinstance(error, OSError):
        refused = out_of_resources(error, where)
        if refused is None and error.errno is not None and _passes(error):
            place = error.filename if isinstance(error.filename, str) else where
            refused = OutOfResources(
                f"{place}: {error.strerror or error}; what is done is kept: run the same command to go on with it, or "
                "with --force to begin anew"
            )
        return refused
    # torch tells lack of memory by a RuntimeError of its own on CUDA and a plain one on the CPU.
    of_torch = isinstance(error, RuntimeError) and (
        type(error).__name__ == "OutOfMemoryError" or "can't allocate memory" in str(error)
    )
    if isinstance(error, MemoryError) or of_torch:
        return OutOfResources(
            f"out of memory (this process had used up to {peak_memory_mb():.0f} MB); use smaller images or a smaller "
            "capacity, or free memory, and run the same command"
        )
    return None
