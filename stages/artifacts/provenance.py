"""What an artefact cost: every stage upstream of it with its seconds, memory, size and parameters."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass

from schemas.errors import ArtefactStale, StylerfError
from schemas.work_folder import Artefact, Work, sources_of


@dataclass(frozen=True)
class Made:
    """One artefact upstream. The numbers are None where it is gone or cannot be read; `remark` then says so."""

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

    def as_json(self) -> dict:
        """Plain numbers and text."""
        return asdict(self)


def fields_behind(field: Artefact) -> list[Artefact]:
    """The fields that a field was made from, the nearest first; those that are gone are passed over."""
    return sources_of(field, ["field"])


def field_before(field: Artefact) -> Artefact | None:
    """The field that a local edit began with: the nearest behind it that shows the scene by itself; None without one.

    A decomposition into a palette only prepares; changes of a palette are all changes of what it was learnt of.
    """
    passed = ("decompose", "recolour") if field.manifest.stage == "recolour" else ("decompose",)
    return next((one for one in fields_behind(field) if one.manifest.stage not in passed), None)


def field_unstylised(field: Artefact) -> Artefact | None:
    """The nearest field behind a stylised one that is neither stylised nor bent for it; None without one."""
    behind = (one for one in fields_behind(field) if one.manifest.stage != "deform_init")
    return next((one for one in behind if not is_stylised(one)), None)


def shows_its_pictures(field: Artefact) -> bool:
    """Whether a field looks as the pictures do that it was taught last; a stylised or recoloured one does not."""
    return field.manifest.stage not in ("stylize", "recolour")


def original_scene(scene: Artefact) -> Artefact:
    """The scene of photos that a scene of edited ones (stage `distill`) was made from, through all artefacts between.

    The scene itself where it is no such scene; ArtefactStale where an artefact on the way is gone.
    """
    waiting, seen = [scene], set()
    while waiting:
        artefact = waiting.pop(0)
        if artefact.manifest.kind == "scene" and artefact.manifest.stage != "distill":
            return artefact
        work = Work(artefact.path.parent.parent)
        for ref in sorted(artefact.manifest.inputs, key=lambda one: one.kind != "scene"):
            if (ref.kind, ref.name) not in seen:
                seen.add((ref.kind, ref.name))
                waiting.append(work.get(ref.kind, ref.name))
    raise ArtefactStale(f"scene {scene.name} holds edited pictures and names no scene of photos they were made from")


def edit_behind(field: Artefact) -> Artefact | None:
    """The palette edit that a field has learnt last, through the scene of edited pictures; None where there is none."""
    return next((one for one in [field, *sources_of(field, ["scene", "edit"])] if one.kind == "edit"), None)


def palette_behind(field: Artefact) -> Artefact | None:
    """What tells of the palette that a field's colours are mixed of: the field itself, one that it was made from, or
    the local edit that it has learnt; None where there is none."""
    own = (one for one in [field, *fields_behind(field)] if one.manifest.stage in ("decompose", "recolour"))
    return edit_behind(field) or next(own, None)


def is_stylised(field: Artefact) -> bool:
    """Whether a field, or one that it was made from, came out of the stylize stage."""
    return any(one.manifest.stage == "stylize" for one in [field, *fields_behind(field)])


def upstream(artefacts: Iterable[Artefact]) -> list[Made]:
    """These artefacts and all they were made from, sources first, each once."""
    found: dict[tuple[str, str], Made] = {}
    seen: set[tuple[str, str]] = set()
    for artefact in artefacts:
        _walk(artefact, "", found, seen)
    return list(found.values())


def _walk(artefact: Artefact, remark: str, found: dict[tuple[str, str], Made], seen: set[tuple[str, str]]) -> None:
    manifest = artefact.manifest
    key = (manifest.kind, artefact.name)
    if key in seen:
        return
    seen.add(key)
    work = Work(artefact.path.parent.parent)
    for ref in manifest.inputs:
        if (ref.kind, ref.name) in seen:
            continue
        try:
            source = work.get(ref.kind, ref.name)
            changed = "" if source.digest == ref.digest else f"made again after {manifest.kind} {artefact.name}"
            _walk(source, changed, found, seen)
        except StylerfError as error:
            found[ref.kind, ref.name] = _absent(ref.kind, ref.name, str(error))
    found[key] = Made(
        kind=manifest.kind,
        name=artefact.name,
        stage=manifest.stage,
        seconds=manifest.seconds,
        peak_memory_mb=manifest.peak_memory_mb,
        bytes=sum(record.bytes for record in manifest.files),
        parameters=counted(manifest.figures.get("parameters")),
        device=manifest.device,
        created=manifest.created,
        remark=remark,
    )


def _absent(kind: str, name: str, reason: str) -> Made:
    return Made(kind, name, "", None, None, None, None, "", "", f"cannot be read: {reason}")


def counted(value: object) -> int | None:
    """Parameters as one number; a field may list them by part."""
    if isinstance(value, dict):
        parts = [counted(part) for part in value.values()]
        return sum(part for part in parts if part) or None
    return int(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
