"""Runs any stage: reuse its artifact if it is up to date, else lock, resume, run, measure, and commit in one rename."""

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
from schemas.errors import ArtifactStale, BadInput, InputGone, OutOfResources, StylerfError, UsageError
from schemas.partial_artifact import EXPENSIVE_SECONDS, UnlikeInterrupted
from schemas.work_folder import Artifact, PartialArtifact, Recipe, WorkFolder, sources_of
from stages.configs import extent, incidental
from stages.run.clock import Clock, peak_memory_mb
from stages.run.progress import Context, Progress

Run = Callable[[dict[str, Artifact], Any, PartialArtifact, Context], dict[str, Any]]

# Packages whose version can affect a result, by module; a manifest records those that the run imported.
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
    "pxr": "usd-core",
    "pygltflib": "pygltflib",
    "fast_simplification": "fast-simplification",
}


@dataclass(frozen=True)
class Spec:
    """A stage: its name, the verb that runs it, its revision, and the kind of artifact that it writes.

    Raise `revision` if the same inputs and options give a different result than before. parallel: several processes can
    run it together (Context.processes). outside: for a stage that reads files other than artifacts; returns their
    current digests, by the option with the digest they had when the stage was requested.
    """

    stage: str
    verb: str
    revision: int
    writes: str
    parallel: bool = False
    outside: Callable[[Any], dict[str, str]] | None = None


def recipe_of(spec: Spec, inputs: dict[str, Artifact], config: Any, seed: int) -> Recipe:
    """Return the recipe for the artifact that `spec` makes from these inputs (by role) and options."""
    references = [artifact.reference(role) for role, artifact in sorted(inputs.items())]
    apart = sorted(incidental(config)), sorted(extent(config))
    return Recipe(spec.stage, spec.revision, plain(config), references, seed, *apart)


def without_folders(recipe: Recipe) -> Recipe:
    """Return the recipe with files that are known by their digests reduced to their names."""
    named = {key: _name_of(value) for key, value in recipe.config.items() if key in recipe.incidental}
    return replace(recipe, config={**recipe.config, **named})


def _name_of(value: Any) -> Any:
    """Reduce PATH to its last part, VIEW=PATH to VIEW= and that part; in a list, each item."""
    if isinstance(value, list | tuple):
        return [_name_of(one) for one in value]
    if not isinstance(value, str):
        return value
    view, mark, path = value.partition("=")
    return f"{view}={Path(path).name}" if mark and "/" not in view else Path(value).name


def refuse_to_replace(work: WorkFolder, kind: str, name: str, sources: Iterable[Artifact]) -> None:
    """Raise UsageError if the artifact `name` would replace one it is made from, directly or through others."""
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
    protect: bool = False,
) -> tuple[Artifact, bool]:
    """Run a stage, or reuse its artifact if that has the same recipe.

    The recipe is stage, revision, options, seed and digests of the inputs. Inputs are verified before the run, and
    again before the result is committed, since they may change meanwhile. An interrupted run of the same recipe
    resumes. The result replaces an older artifact of the same name by one rename.

    After an interruption, a failure of the machine (memory, space, permission, a failing disk) or a fault with
    `keeps_run`, the partial run is kept for the next run to resume. After any other fault it is deleted: the same state
    would fail again.

    Args:
        force: rebuild an artifact that is up to date.
        protect: do not silently discard a minute's work or more with other options: an interrupted run raises
            ArtifactStale, a finished artifact is announced before it is replaced.

    Returns:
        The artifact, and whether it was reused.
    """
    recipe = recipe_of(spec, inputs, config, context.seed)
    recipe = without_folders(recipe) if context.no_paths else recipe
    present = None if force else work.up_to_date(spec.writes, name, recipe)
    if present:
        work.sweep(spec.writes, name)
        return present, True
    refuse_to_replace(work, spec.writes, name, inputs.values())
    _verify(spec, recipe, inputs)
    try:
        partial = work.begin(spec.writes, name, recipe, protect and not force, rebuild=force)
    except UnlikeInterrupted as lost:
        raise ArtifactStale(
            f"an interrupted `stylerf {spec.verb}` of {spec.writes} {name}, {lost.seconds / 60:.0f} min of work with "
            f"{lost.options}, would be lost; run `stylerf {spec.verb}` with these options to resume it, with another "
            "--name to keep both, or with --force to start over"
        ) from lost
    except OSError as error:
        raise refusal_of_machine(error, work.root) or error from error
    if partial.lost:
        context.progress.say(
            f"an interrupted `stylerf {spec.verb}` of {spec.writes} {name}, {partial.lost}, cannot resume; deleting it"
        )
    if protect:
        announce_replacement(work, spec, name, recipe, context.progress)
    try:
        # Another process may have made it before we got the lock.
        present = None if force else work.up_to_date(spec.writes, name, recipe)
        if present:
            partial.discard()
            return present, True
        if partial.resumed:
            context.progress.say(f"resuming the interrupted {spec.verb} of {name}")
        return _run(spec, run, partial, inputs, config, replace(context, rebuild=force)), False
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


def announce_replacement(work: WorkFolder, spec: Spec, name: str, recipe: Recipe, progress: Progress) -> None:
    """Report if an artifact that took a minute or more is about to be replaced by one with another recipe."""
    with suppress(StylerfError):  # losing a missing or unreadable artifact does not matter
        made = Artifact(work.root / spec.writes / name).manifest
        before = Recipe(made.stage, made.revision, made.config, made.inputs, made.seed)
        if made.recipe != recipe.digest and made.seconds >= EXPENSIVE_SECONDS:
            differences = [recipe.other_options(before), recipe.other_sources(before)]
            other = ", ".join(filter(None, differences)) or "older options"
            progress.say(
                f"{spec.writes} {name}, {made.seconds / 60:.0f} min of work with {other}, will be replaced when this "
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
    # Before the commit: the recipe names inputs by digest, and must not name what the run did not read.
    _refuse_changed(spec, partial.recipe, inputs, config)
    return partial.commit(
        device=context.device, threads=context.threads, versions=versions(), seconds=seconds, peak_memory_mb=peak,
        figures=figures,
    )  # fmt: skip


def _verify(spec: Spec, recipe: Recipe, inputs: dict[str, Artifact]) -> None:
    """Raise ArtifactDamaged or ArtifactStale if an input differs from the one in the recipe."""
    named = {ref.role: ref.digest for ref in recipe.inputs}
    for role, artifact in inputs.items():
        artifact.verify()
        if artifact.digest != named[role]:
            raise ArtifactStale(
                f"{artifact.kind} {artifact.name} was rebuilt while `stylerf {spec.verb}` was using it; rerun the "
                "same command"
            )


def _refuse_changed(spec: Spec, recipe: Recipe, inputs: dict[str, Artifact], config: Any) -> None:
    """Do the same as _verify, and raise BadInput if a file outside the work folder changed since the run began.

    Raises InputGone, which keeps the run, if one no longer exists.
    """
    _verify(spec, recipe, inputs)
    try:
        outside = spec.outside(config) if spec.outside else {}
    except FileNotFoundError as error:
        raise InputGone(
            f"{error.filename} was removed while `stylerf {spec.verb}` needed it; put it back and rerun the same "
            "command"
        ) from error
    except BadInput as error:
        raise InputGone(
            f"{error}; `stylerf {spec.verb}` needs it until it finishes: put it back and rerun the same command"
        ) from error
    for option, digest in outside.items():
        if getattr(config, option) not in ("", digest):
            what = option.removesuffix("_digest")
            raise BadInput(f"--{what} changed while `stylerf {spec.verb}` was using it; rerun the same command")


def versions() -> dict[str, str]:
    """Return the versions of Python, stylerf and those RECORDED_PACKAGES that this process has imported."""
    found = {"python": sys.version.split()[0]}
    names = {"stylerf": "stylerf"} | {m: p for m, p in RECORDED_PACKAGES.items() if m in sys.modules}
    for module, package in names.items():
        try:
            found[module] = version(package)
        except PackageNotFoundError:  # run from a checkout or a manually set path
            found[module] = str(getattr(sys.modules.get(module), "__version__", "not installed"))
    return found


def _keeps_run(error: BaseException) -> bool:
    """Return whether a partial run can resume after `error`: the fault keeps it, or an I/O error caused it."""
    if isinstance(error, StylerfError) and error.keeps_run:
        return True
    behind: BaseException | None = error
    # Stages wrap I/O errors in their own: the cause decides.
    while behind is not None:
        if isinstance(behind, OSError) and _passes(behind):
            return True
        behind = behind.__cause__
    return False


def _passes(error: OSError) -> bool:
    """Return whether a rerun may succeed; a path that does not exist fails again."""
    return error.errno not in (errno.ENOENT, errno.ENOTDIR, errno.EISDIR)


def refusal_of_machine(error: BaseException, where: Path) -> OutOfResources | None:
    """Return OutOfResources if `error` means lack of memory, space or permission, or a failing disk; else None."""
    if isinstance(error, OSError):
        refused = out_of_resources(error, where)
        if refused is None and error.errno is not None and _passes(error):
            place = error.filename if isinstance(error.filename, str) else where
            refused = OutOfResources(
                f"{place}: {error.strerror or error}; rerun the same command to resume, or with --force to start over"
            )
        return refused
    # torch raises its own RuntimeError for lack of memory on CUDA, and a plain one on the CPU.
    of_torch = isinstance(error, RuntimeError) and (
        type(error).__name__ == "OutOfMemoryError" or "can't allocate memory" in str(error)
    )
    if isinstance(error, MemoryError) or of_torch:
        return OutOfResources(
            f"out of memory (this process had used up to {peak_memory_mb():.0f} MB); use smaller images or a smaller "
            "capacity, or free memory, and rerun the same command"
        )
    return None
