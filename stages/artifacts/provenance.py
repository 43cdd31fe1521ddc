"""What an artifact cost: every stage upstream of it with its seconds, memory, size and parameters."""

from collections.abc import Iterable
from dataclasses import dataclass

from schemas.errors import ArtifactStale, StylerfError
from schemas.work_folder import Artifact, WorkFolder, sources_of


@dataclass(frozen=True)
class Made:
    """One upstream artifact. Its numbers are None if it is missing or cannot be read; `remark` then says so."""

    kind: str
    name: str
    stage: str
    seconds: float | None
    peak_memory_mb: float | None
    bytes: int | None
    parameters: int | None
    device: str
    created: str
    remark: str


def fields_behind(field: Artifact) -> list[Artifact]:
    """Return the fields that a field was made from, nearest first; missing ones are skipped."""
    return sources_of(field, ["field"])


def field_before(field: Artifact) -> Artifact | None:
    """Return the field that a local edit began with: the nearest source that shows the scene itself; None without one.

    A decomposition into a palette only prepares; changes of a palette are all changes of what it was learned of.
    """
    passed = ("decompose", "recolor") if field.manifest.stage == "recolor" else ("decompose",)
    return next((one for one in fields_behind(field) if one.manifest.stage not in passed), None)


def field_unstylized(field: Artifact) -> Artifact | None:
    """Return the nearest source of a stylized field that is neither stylized nor deformed for it; None without one."""
    behind = (one for one in fields_behind(field) if one.manifest.stage != "deform_init")
    return next((one for one in behind if not is_stylized(one)), None)


def shows_its_pictures(field: Artifact) -> bool:
    """Return whether a field looks like the pictures it was trained on, unlike a stylized, recolored or blended one."""
    return field.manifest.stage not in ("stylize", "recolor", "blend")


def original_scene(scene: Artifact) -> Artifact:
    """Return the scene of photos that a scene of edited photos (stage `distill`) was made from, directly or indirectly.

    Other scenes are returned as they are; ArtifactStale if an artifact in between is missing.
    """
    waiting, seen = [scene], set()
    while waiting:
        artifact = waiting.pop(0)
        if artifact.manifest.kind == "scene" and artifact.manifest.stage != "distill":
            return artifact
        work = WorkFolder(artifact.path.parent.parent)
        for ref in sorted(artifact.manifest.inputs, key=lambda one: one.kind != "scene"):
            if (ref.kind, ref.name) not in seen:
                seen.add((ref.kind, ref.name))
                waiting.append(work.get(ref.kind, ref.name))
    raise ArtifactStale(
        f"scene {scene.name} contains edited pictures but does not record the scene they were made from"
    )


def edit_behind(field: Artifact) -> Artifact | None:
    """Return the palette edit that a field learned last, found through its scene of edited pictures, or None."""
    return next((one for one in [field, *sources_of(field, ["scene", "edit"])] if one.kind == "edit"), None)


def palette_behind(field: Artifact) -> Artifact | None:
    """Return the artifact with the palette that a field's colors are mixed from: the field, one it was made from, or
    the local edit that it has learned; None where there is none, and for a blend, whose colors have no one palette."""
    if field.manifest.stage == "blend":
        return None
    own = (one for one in [field, *fields_behind(field)] if one.manifest.stage in ("decompose", "recolor"))
    return edit_behind(field) or next(own, None)


def is_stylized(field: Artifact) -> bool:
    """Return whether a field, or one that it was made from, is the output of the stylize stage."""
    return any(one.manifest.stage == "stylize" for one in [field, *fields_behind(field)])


def upstream(artifacts: Iterable[Artifact]) -> list[Made]:
    """Return these artifacts and everything they were made from, sources first, each once."""
    found: dict[tuple[str, str], Made] = {}
    seen: set[tuple[str, str]] = set()
    for artifact in artifacts:
        _visit(artifact, "", found, seen)
    return list(found.values())


def _visit(artifact: Artifact, remark: str, found: dict[tuple[str, str], Made], seen: set[tuple[str, str]]) -> None:
    manifest = artifact.manifest
    key = (manifest.kind, artifact.name)
    if key in seen:
        return
    seen.add(key)
    work = WorkFolder(artifact.path.parent.parent)
    for ref in manifest.inputs:
        if (ref.kind, ref.name) in seen:
            continue
        try:
            source = work.get(ref.kind, ref.name)
            changed = "" if source.digest == ref.digest else f"rebuilt after {manifest.kind} {artifact.name}"
            _visit(source, changed, found, seen)
        except StylerfError as error:
            why = f"cannot be read: {error}"
            found[ref.kind, ref.name] = Made(ref.kind, ref.name, "", None, None, None, None, "", "", why)
    found[key] = Made(
        kind=manifest.kind,
        name=artifact.name,
        stage=manifest.stage,
        seconds=manifest.seconds,
        peak_memory_mb=manifest.peak_memory_mb,
        bytes=sum(record.bytes for record in manifest.files),
        parameters=counted(manifest.figures.get("parameters")),
        device=manifest.device,
        created=manifest.created,
        remark=remark,
    )


def counted(value: object) -> int | None:
    """Return the number of parameters in total; a field may list them by part."""
    if isinstance(value, dict):
        parts = [counted(part) for part in value.values()]
        return sum(part for part in parts if part) or None
    return int(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
