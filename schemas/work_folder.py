"""The work folder: artifacts by kind and name, found, checked, and begun.

WORK/<kind>/<name>/manifest.json and the files that it lists
"""

import os
import re
import shlex
import shutil
from collections.abc import Collection, Iterable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

from schemas import safe_names
from schemas.artifact import MADE_BY, Artifact
from schemas.atomic_write import writing
from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged, ArtifactStale, StylerfError, UsageError
from schemas.manifest import MANIFEST, InputRef, Recipe
from schemas.migrations import CURRENT
from schemas.partial_artifact import PartialArtifact, replaced_by, sweep_finished

__all__ = [
    "MADE_BY",
    "Artifact",
    "InputRef",
    "PartialArtifact",
    "Recipe",
    "WorkFolder",
    "newest",
    "sound_name",
    "sources_of",
]

CLOCK_SLACK = timedelta(minutes=5)  # by which the clocks of two machines may differ
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,99}")


class WorkFolder:
    """A work folder. Reading never writes; the folder is created when the first artifact is begun."""

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)
        if self.root.exists() and not self.root.is_dir():
            raise UsageError(f"{self.root} is a file where a work folder was expected")

    def artifacts(self, kind: str | None = None) -> list[Artifact]:
        """All finished artifacts (of one kind), by kind and name; folders without a manifest are not among them."""
        kinds = [_known(kind)] if kind else list(CURRENT)
        return [self._standing(one, name) for one in kinds for name in self._names(one)]

    def get(self, kind: str, name: str) -> Artifact:
        """The artifact of that kind and name; ArtifactStale with the command that makes it where there is none."""
        artifact = self._standing(_known(kind), sound_name(name))
        if not artifact.path.is_dir():
            raise ArtifactStale(f"no {kind} {name} in {self.root}; make it with: {self._maker(kind)}")
        if artifact.kind != kind:
            raise ArtifactDamaged(
                f"{artifact.path} is a {artifact.kind} by its manifest, not a {kind}; move it to its place"
            )
        return artifact

    def find(self, kind: str, name: str) -> Artifact:
        """The artifact called `name`, or the only one whose name begins so.

        UsageError when several do or none does but others exist, ArtifactStale when there is none of that kind.
        """
        names = [item.name for item in self.artifacts(kind)]
        if name in names:
            return self.get(kind, name)
        if not names:
            raise ArtifactStale(f"no {kind} in {self.root}; make one with: {self._maker(kind)}")
        matches = [item for item in names if item.startswith(name)]
        if len(matches) != 1:
            told = "several" if matches else "none"
            raise UsageError(f"one {kind} called {name!r} expected, {told} found; there are {', '.join(names)}")
        return self.get(kind, matches[0])

    def standing(self, kind: str, name: str, recipe: Recipe) -> Artifact | None:
        """The artifact of that name if it was made by this very recipe and all its files have their lengths."""
        artifact = self._standing(_known(kind), sound_name(name))
        if not (artifact.path / MANIFEST).is_file():
            return None
        try:
            if artifact.manifest.recipe != recipe.digest:
                return None
            artifact.check_sizes()
        except (ArtifactDamaged, ArtifactStale):
            return None  # a damaged or unreadable one is made again
        return artifact

    def sweep(self, kind: str, name: str) -> None:
        """Deletes what is left of the run that made the artifact of that name, where a kill kept it from doing so."""
        sweep_finished(self.root, _known(kind), sound_name(name))

    def begin(self, kind: str, name: str, recipe: Recipe, careful: bool = False, anew: bool = False) -> PartialArtifact:
        """Goes on with an interrupted run of this recipe, or starts afresh; see Partial."""
        return PartialArtifact(self.root, _known(kind), sound_name(name), recipe, careful, anew)

    def copy(self, artifact: Artifact, name: str) -> Artifact:
        """The artifact under another name too, in place of what is called so; its digest knows no name and stays."""
        artifact.verify()  # else a damaged file would get a sound seal
        made = artifact.manifest
        recipe = Recipe(made.stage, made.revision, made.config, made.inputs, made.seed, known=made.recipe)
        partial = self.begin(artifact.kind, name, recipe, careful=True)
        try:
            for record in made.files:
                target = partial.path / record.path
                with writing(target):
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(artifact.file(record.path), target)
                if file_sha256(target) != record.sha256:
                    raise ArtifactDamaged(f"{artifact.path / record.path} changed while it was copied; run it again")
            measured = {
                "threads": made.threads,
                "seconds": made.seconds,
                "peak_memory_mb": made.peak_memory_mb,
                "figures": made.figures,
            }
            return partial.commit(device=made.device, versions=made.versions, **measured)
        finally:
            partial.release()

    def unfinished(self) -> list[tuple[str, str]]:
        """Kind and name of every interrupted run."""
        found = [(kind, item) for kind in CURRENT for item in sorted((self.root / kind).glob(".*.partial"))]
        return [(kind, item.name[1 : -len(".partial")]) for kind, item in found]

    def outdated(self, artifact: Artifact) -> list[str]:
        """Why the artifact no longer matches what it was made from, one line each; empty when it does.

        Looks through its inputs up to the scene, the nearest first.
        """
        reasons, waiting, seen = [], [artifact], {artifact.path.resolve()}
        while waiting:
            made = waiting.pop(0)
            for ref in made.manifest.inputs:
                source = self._standing(ref.kind, ref.name)
                if not (source.path / MANIFEST).is_file():
                    reasons.append(f"{ref.kind} {ref.name}, from which {made.name} was made, is gone")
                    continue
                try:
                    if source.digest != ref.digest:
                        reasons.append(f"{ref.kind} {ref.name} was made again after {made.kind} {made.name}")
                except (ArtifactDamaged, ArtifactStale) as error:
                    reasons.append(f"{ref.kind} {ref.name}, from which {made.name} was made, is not readable: {error}")
                    continue
                if source.path.resolve() not in seen:
                    seen.add(source.path.resolve())
                    waiting.append(source)
        return reasons

    def _standing(self, kind: str, name: str) -> Artifact:
        """The artifact in its place, or where a kill has left it: without a way to swap two folders in one step, there
        is a moment between two renames in which nothing stands in its place."""
        place, aside = self.root / kind / name, replaced_by(self.root, kind, name)
        lost = not os.path.lexists(place) and (aside / MANIFEST).is_file()
        return Artifact(aside, name) if lost else Artifact(place)

    def _names(self, kind: str) -> list[str]:
        """Of all that stands, sorted."""
        folder = self.root / kind
        standing = {item.name for item in folder.glob("*") if item.name[0] != "." and (item / MANIFEST).is_file()}
        aside = {name for one, name in self.unfinished() if one == kind}
        return sorted(standing | {name for name in aside if self._standing(kind, name).path.parent != folder})

    def _maker(self, kind: str) -> str:
        return MADE_BY[kind].replace("WORK", shlex.quote(str(self.root)))


def sources_of(artifact: Artifact, kinds: Collection[str] = tuple(CURRENT)) -> list[Artifact]:
    """What an artifact was made from, directly or through others of these kinds, the nearest first, each once.

    What is gone or cannot be read is passed over.
    """
    work, found = WorkFolder(artifact.path.parent.parent), [artifact]
    for made in found:  # which grows meanwhile
        for ref in made.manifest.inputs:
            if ref.kind in kinds and (ref.kind, ref.name) not in [(one.kind, one.name) for one in found]:
                with suppress(StylerfError):
                    found.append(work.get(ref.kind, ref.name))
    return found[1:]


def newest(artifacts: Iterable[Artifact]) -> list[Artifact]:
    """The artifacts, that made last first.

    One dated in the future comes last, as the clock that dated it was wrong. Of two of one moment, that made of the
    other is the later.
    """
    now = datetime.now(UTC) + CLOCK_SLACK

    def made(artifact: Artifact) -> tuple[bool, datetime, int]:
        date = datetime.fromisoformat(artifact.manifest.created)
        return date <= now, date, len(sources_of(artifact))

    return sorted(artifacts, key=made, reverse=True)


def _known(kind: str) -> str:
    if kind not in CURRENT:
        raise UsageError(f"there is no kind of artifact called {kind!r}; kinds are {', '.join(CURRENT)}")
    return kind


def sound_name(name: str) -> str:
    """The name, if an artifact may be called so, else UsageError."""
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} cannot name an artifact: expected up to 100 letters, digits, '.', '_', '+' or '-', beginning "
            "with a letter or digit"
        )
    if safe_names.WINDOWS and (why := safe_names.refused_by_windows(name)):
        raise UsageError(f"{name!r} cannot name an artifact on Windows: it {why}")
    return name
