"""The work folder: finds, checks and creates artifacts by kind and name.

WORK/<kind>/<name>/ holds manifest.json and the files that it lists.
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
from schemas.canonical_json import digest_of, file_sha256
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
    "sources_of",
    "valid_name",
]

CLOCK_SLACK = timedelta(minutes=5)  # tolerated difference between the clocks of two machines
LONGEST_NAME = 100  # characters
_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9._+-]{{0,{LONGEST_NAME - 1}}}")


class WorkFolder:
    """A work folder. Created with its first artifact; reading it never writes."""

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)
        if self.root.exists() and not self.root.is_dir():
            raise UsageError(f"{self.root} is a file; expected a work folder")

    def artifacts(self, kind: str | None = None) -> list[Artifact]:
        """Return all finished artifacts, optionally of one kind, sorted; folders without a manifest are ignored."""
        kinds = [_known(kind)] if kind else list(CURRENT)
        return [self._in_place(one, name) for one in kinds for name in self._names(one)]

    def get(self, kind: str, name: str) -> Artifact:
        """Return the artifact of this kind and name; ArtifactStale, with the command that makes it, if missing."""
        artifact = self._in_place(_known(kind), valid_name(name))
        if not artifact.path.is_dir():
            raise ArtifactStale(f"no {kind} {name} in {self.root}; make it with: {self._maker(kind)}")
        if artifact.kind != kind:
            raise ArtifactDamaged(
                f"{artifact.path} is a {artifact.kind} according to its manifest, not a {kind}; move it to where it "
                "belongs"
            )
        return artifact

    def find(self, kind: str, name: str) -> Artifact:
        """Return the artifact called `name`, or the only one whose name begins with it.

        Raises:
            UsageError: Several match, or none of those that exist.
            ArtifactStale: There is no artifact of this kind.
        """
        names = [item.name for item in self.artifacts(kind)]
        if name in names:
            return self.get(kind, name)
        if not names:
            raise ArtifactStale(f"no {kind} in {self.root}; make one with: {self._maker(kind)}")
        matches = [item for item in names if item.startswith(name)]
        if len(matches) != 1:
            found = "several" if matches else "none"
            raise UsageError(f"expected one {kind} called {name!r}, found {found}; choose from {', '.join(names)}")
        return self.get(kind, matches[0])

    def up_to_date(self, kind: str, name: str, recipe: Recipe) -> Artifact | None:
        """Return the artifact of this name if it was made with this recipe and its files have the recorded sizes."""
        artifact = self._in_place(_known(kind), valid_name(name))
        if not (artifact.path / MANIFEST).is_file():
            return None
        try:
            if artifact.manifest.recipe != recipe.digest:
                return None
            artifact.check_sizes()
        except (ArtifactDamaged, ArtifactStale):
            return None  # rebuild a damaged or unreadable one
        return artifact

    def sweep(self, kind: str, name: str) -> None:
        """Delete what the run that made this artifact left, if a kill kept it from cleaning up."""
        sweep_finished(self.root, _known(kind), valid_name(name))

    def begin(
        self, kind: str, name: str, recipe: Recipe, protect: bool = False, rebuild: bool = False
    ) -> PartialArtifact:
        """Resume an interrupted run with this recipe, or start a new one; see PartialArtifact."""
        return PartialArtifact(self.root, _known(kind), valid_name(name), recipe, protect, rebuild)

    def copy(self, artifact: Artifact, name: str) -> Artifact:
        """Copy an artifact to another name, replacing any artifact there. The digest, which covers no name, is
        unchanged."""
        artifact.verify()  # a damaged file must not get a valid digest
        made = artifact.manifest
        recipe = Recipe(made.stage, made.revision, made.config, made.inputs, made.seed, stored_digest=made.recipe)
        partial = self.begin(artifact.kind, name, recipe, protect=True)
        try:
            for record in made.files:
                target = partial.path / record.path
                with writing(target):
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(artifact.file(record.path), target)
                if file_sha256(target) != record.sha256:
                    raise ArtifactDamaged(
                        f"{artifact.path / record.path} changed while being copied; run the same command again"
                    )
            return partial.commit(
                device=made.device,
                threads=made.threads,
                versions=made.versions,
                seconds=made.seconds,
                peak_memory_mb=made.peak_memory_mb,
                figures=made.figures,
            )
        finally:
            partial.release()

    def unfinished(self) -> list[tuple[str, str]]:
        """Return kind and name of every interrupted run."""
        found = [(kind, item) for kind in CURRENT for item in sorted((self.root / kind).glob(".*.partial"))]
        return [(kind, item.name[1 : -len(".partial")]) for kind, item in found]

    def outdated(self, artifact: Artifact) -> list[str]:
        """Return why an artifact is out of date, one line for each reason; checks all inputs up to the scene."""
        reasons, waiting, seen = [], [artifact], {artifact.path.resolve()}
        while waiting:
            made = waiting.pop(0)
            for ref in made.manifest.inputs:
                source = self._in_place(ref.kind, ref.name)
                if not (source.path / MANIFEST).is_file():
                    reasons.append(f"{ref.kind} {ref.name}, from which {made.name} was made, no longer exists")
                    continue
                try:
                    if source.digest != ref.digest:
                        reasons.append(f"{ref.kind} {ref.name} was rebuilt after {made.kind} {made.name}")
                except (ArtifactDamaged, ArtifactStale) as error:
                    reasons.append(f"{ref.kind} {ref.name}, from which {made.name} was made, is not readable: {error}")
                    continue
                if source.path.resolve() not in seen:
                    seen.add(source.path.resolve())
                    waiting.append(source)
        return reasons

    def _in_place(self, kind: str, name: str) -> Artifact:
        """Return the artifact in its place, or where a kill left it: a disk that cannot swap two folders in one step
        needs two renames, between which the place is empty."""
        place, aside = self.root / kind / name, replaced_by(self.root, kind, name)
        lost = not os.path.lexists(place) and (aside / MANIFEST).is_file()
        return Artifact(aside, name) if lost else Artifact(place)

    def _names(self, kind: str) -> list[str]:
        """Return the names of all finished artifacts of a kind, sorted."""
        folder = self.root / kind
        finished = {item.name for item in folder.glob("*") if item.name[0] != "." and (item / MANIFEST).is_file()}
        begun = {name for one, name in self.unfinished() if one == kind}
        return sorted(finished | {name for name in begun if self._in_place(kind, name).path.parent != folder})

    def _maker(self, kind: str) -> str:
        return MADE_BY[kind].replace("WORK", shlex.quote(str(self.root)))


def sources_of(artifact: Artifact, kinds: Collection[str] = tuple(CURRENT)) -> list[Artifact]:
    """Return what an artifact was made from, directly or through others of these kinds, nearest first.

    Missing and unreadable artifacts are left out.
    """
    work, found = WorkFolder(artifact.path.parent.parent), [artifact]
    for made in found:  # grows during the loop
        for ref in made.manifest.inputs:
            if ref.kind in kinds and (ref.kind, ref.name) not in [(one.kind, one.name) for one in found]:
                with suppress(StylerfError):
                    found.append(work.get(ref.kind, ref.name))
    return found[1:]


def newest(artifacts: Iterable[Artifact]) -> list[Artifact]:
    """Sort artifacts, newest first.

    Those dated in the future come last, since their clock was wrong. Of two with the same date, the one with more
    sources is newer.
    """
    now = datetime.now(UTC) + CLOCK_SLACK

    def made(artifact: Artifact) -> tuple[bool, datetime, int]:
        date = datetime.fromisoformat(artifact.manifest.created)
        return date <= now, date, len(sources_of(artifact))

    return sorted(artifacts, key=made, reverse=True)


def _known(kind: str) -> str:
    if kind not in CURRENT:
        raise UsageError(f"unknown kind of artifact {kind!r}; choose from {', '.join(CURRENT)}")
    return kind


def shortened_name(name: str) -> str:
    """Return a name composed of others, cut to the longest valid length, with a digest of the whole."""
    if len(name) <= LONGEST_NAME:
        return name
    return f"{name[: LONGEST_NAME - 7]}-{digest_of(name)[:6]}"


def valid_name(name: str) -> str:
    """Return `name` if it is a valid name of an artifact, else raise UsageError."""
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} is not a valid name: expected up to {LONGEST_NAME} letters, digits, '.', '_', '+' or '-', "
            "beginning with a letter or digit"
        )
    if safe_names.WINDOWS and (why := safe_names.refused_by_windows(name)):
        raise UsageError(f"{name!r} cannot name an artifact on Windows: it {why}")
    return name
