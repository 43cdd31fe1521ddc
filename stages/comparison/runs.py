"""Collect the runs of work folders from their manifests and reports, without running or measuring anything."""

import shlex
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from schemas.canonical_json import digest_of
from schemas.errors import ArtifactStale, StylerfError
from schemas.manifest import MANIFEST
from schemas.safe_reading import sound
from schemas.work_folder import Artifact, WorkFolder, newest
from stages.artifacts.provenance import counted, is_stylized, original_scene
from stages.artifacts.report import read_report
from stages.evaluation.metric_definitions import BY_KEY
from stages.evaluation.metrics import is_number

FITS, STYLIZATIONS, EDITS = "fits", "stylizations", "edits"
COSTS = ("seconds", "peak_memory_mb", "parameters")
# The charted metrics of each family, the leading one first, each with the `stylerf eval` option that measures it. For
# stylizations it is one that no method minimizes, unlike the NNFM distance, which ARF does.
CHARTED = {
    FITS: {"psnr": "", "ssim": "", "lpips": ""},
    STYLIZATIONS: {"sifid": "", "edges_kept": "", "short_rmse": "--path", "long_rmse": "--path"},
    EDITS: {"background_mse": "--region", "bleeding": "--region", "sparsity": "--region", "edit_short_rmse": "--path"},
}
ORDER = {key: index for index, key in enumerate(BY_KEY)}
Protocol = tuple[str, int]  # protocol and number of views or pairs: values compare only if both are the same
NEEDED = {FITS: ("psnr",), STYLIZATIONS: tuple(CHARTED[STYLIZATIONS]), EDITS: ("background_mse", "bleeding")}


@dataclass(frozen=True)
class RunMetric:
    """A metric of a run, from its report. count, left_out: views or pairs that were, or could not be, measured."""

    mean: float
    label: str
    unit: str
    better: str
    protocol: str
    count: int
    left_out: int

    @property
    def comparable_by(self) -> Protocol:
        """What must be the same to compare two values."""
        return self.protocol, self.count


@dataclass(frozen=True)
class Run:
    """A fit, or a stylization or edit of a fitted field, with its cost and metrics.

    Attributes:
        group: what its metrics can be compared within: the scene, and the style image or the edited regions.
        costs: by COSTS, None where unknown; seconds are the sum over `stages`, memory is the maximum.
        metrics: by key.
        threads: numbers of threads that these stages ran on, as far as recorded.
    """

    family: str
    work: str
    name: str
    group: str
    method: str
    settings: str
    device: str
    stages: tuple[str, ...]
    costs: dict[str, float | None]
    metrics: dict[str, RunMetric] = field(default_factory=dict)
    threads: tuple[int, ...] = ()

    @property
    def title(self) -> str:
        """Work folder and field."""
        return f"{self.work}/{self.name}"


@dataclass(frozen=True)
class Group:
    """What comparable runs have in common: the digests of scene, style image or regions, and a display name."""

    digests: tuple[str, ...]
    name: str


@dataclass(frozen=True)
class Gap:
    """A metric or run that is missing from a comparison, and what to do about it."""

    what: str
    why: str


def runs_of(works: Sequence[WorkFolder]) -> tuple[list[Run], list[Gap]]:
    """Return every fit, stylization and edit of these work folders, in the order given, and what is missing."""
    runs: list[Run] = []
    groups: list[Group] = []
    gaps: list[Gap] = []
    scenes: dict[str, str] = {}
    for work, label in zip(works, _labels(works)):
        for artifact in work.artifacts("field"):
            try:
                family = family_of(artifact)
                if family is None:
                    continue
                with sound(artifact.path / MANIFEST, "valid options"):
                    run, group = _run(artifact, family, work, label, scenes)
                    hash(group)  # digests must be text
            except StylerfError as error:
                gaps.append(Gap(f"{label}/{artifact.name}", f"Cannot be read: {error}"))
                continue
            runs.append(run)
            groups.append(group)
            gaps += _gaps(run, work)
    return [replace(run, group=name) for run, name in zip(runs, _group_names(groups), strict=True)], gaps


def fields_of(works: Sequence[WorkFolder]) -> dict[str, tuple[WorkFolder, Artifact]]:
    """Work folder and field by the title of its run."""
    labeled = zip(works, _labels(works), strict=True)
    return {f"{label}/{one.name}": (work, one) for work, label in labeled for one in work.artifacts("field")}


def unlike_machines(runs: Sequence[Run]) -> list[Gap]:
    """Return a remark for each group whose runs used different devices or numbers of threads."""
    found = []
    for group in dict.fromkeys(run.group for run in runs):
        counts = sorted({count for run in runs if run.group == group for count in run.threads})
        if len(counts) > 1:
            threads = " and ".join(map(str, counts))
            why = f"Run on {threads} threads: times are not comparable, and results differ in their last digits."
            found.append(Gap(group, why))
        devices = sorted({run.device for run in runs if run.group == group})
        if len(devices) > 1:
            why = f"Run on {' and '.join(devices)}: times and memory are not comparable, and share no front."
            found.append(Gap(group, why))
    return found


def family_of(artifact: Artifact) -> str | None:
    """Return the family of a field; None if it only prepares another (a deformation, or a palette fitted to photos)."""
    stage = artifact.manifest.stage
    if stage in ("finetune", "recolor") or (stage == "blend" and not is_stylized(artifact)):
        return EDITS
    if stage in ("deform_init", "decompose"):
        return None
    return STYLIZATIONS if is_stylized(artifact) else FITS


def _labels(works: Sequence[WorkFolder]) -> list[str]:
    """Return the names of work folders, with those of their parents if two would be equal."""
    paths = [work.root.resolve() for work in works]
    for depth in range(1, max(len(path.parts) for path in paths)):
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len({*names}) == len({*paths}):
            return names
    return [str(path) for path in paths]


def _run(artifact: Artifact, family: str, work: WorkFolder, label: str, scenes: dict[str, str]) -> tuple[Run, Group]:
    """Read a run; its group's name is set later, when all groups are known."""
    manifest = artifact.manifest
    made = [*(_made_for(artifact) if family != FITS else ()), artifact]
    reports = _reports(artifact, work)
    subjects = [_subject(artifact, family, *one) for one in reports] or [_subject(artifact, family)]
    # The newest report that names its style image or regions decides; reports that name none go with any.
    leading = next((subject for subject in subjects if subject.digests), subjects[0])
    metrics: dict[str, RunMetric] = {}
    for subject, (_, content) in zip(subjects, reports):
        if subject.digests in ((), leading.digests):
            metrics = _metrics(content) | metrics
    group = _group(artifact, label, scenes, leading)
    run = Run(
        family=family,
        work=label,
        name=artifact.name,
        group="",
        method=_method(artifact, family),
        settings=_settings(manifest.config),
        device=manifest.device,
        stages=tuple(dict.fromkeys(one.manifest.stage for one in made)),
        costs={
            "seconds": sum(one.manifest.seconds for one in made),
            "peak_memory_mb": max(one.manifest.peak_memory_mb for one in made) or None,
            "parameters": counted(manifest.figures.get("parameters")),
        },
        metrics=dict(sorted(metrics.items(), key=lambda item: ORDER.get(item[0], len(ORDER)))),
        threads=tuple(sorted({one.manifest.threads for one in made} - {None})),
    )
    return run, group


def _metrics(report: dict) -> dict[str, RunMetric]:
    """By key, the metrics of a report."""
    return {
        one["key"]: RunMetric(
            one["mean"], one["label"], one["unit"], one["better"], one["protocol"], one["count"], one["left_out"]
        )
        for one in report.get("metrics", [])
        if is_number(one["mean"])
    }


def _made_for(artifact: Artifact, seen: set[Path] | None = None) -> list[Artifact]:
    """The artifacts between the fitted field and this one, sources first, each once, except those in `seen`.

    Imports, fits, selections and renders are not among them.
    """
    work, found, seen = WorkFolder(artifact.path.parent.parent), [], {artifact.path} if seen is None else seen
    for ref in artifact.manifest.inputs:
        if ref.kind not in ("field", "scene", "edit", "edit-dataset"):
            continue
        source = work.get(ref.kind, ref.name)
        made = source.manifest.stage != "nerf_fit" if ref.kind == "field" else source.manifest.stage == "distill"
        if (made or ref.kind in ("edit", "edit-dataset")) and source.path not in seen:
            seen.add(source.path)
            found += [*_made_for(source, seen), source]
    return found


def _reports(artifact: Artifact, work: WorkFolder) -> list[tuple[Artifact, dict]]:
    """The evaluations of exactly this field with their content, newest first."""
    found, contents = [], {}
    for report in work.artifacts("report"):
        with suppress(StylerfError):  # ignore damaged reports
            refs = report.manifest.inputs
            if any(ref.role == "field" and ref.digest == artifact.digest for ref in refs):
                contents[report.path] = read_report(report)
                found.append(report)
    return [(report, contents[report.path]) for report in newest(found)]


def _subject(artifact: Artifact, family: str, report: Artifact | None = None, content: dict | None = None) -> Group:
    """What a run is measured against besides its scene: the style image, or the edited regions or masks."""
    if family == FITS:
        return Group((), "")
    return _style(artifact, report) if family == STYLIZATIONS else _edited(report, content or {})


def _group(artifact: Artifact, label: str, scenes: dict[str, str], subject: Group) -> Group:
    """The group of a run. scenes: names by digest, so that two work folders with one scene share a group."""
    try:
        digest = scene_behind(artifact).digest
        name = scenes.setdefault(digest, label)
    except NoScene:
        digest = name = label
    return Group((digest, *subject.digests), f"{name}, {subject.name}" if subject.name else name)


class NoScene(ArtifactStale):
    """A field does not record its scene."""


def scene_behind(field: Artifact) -> Artifact:
    """Return the scene of photos that a field shows; NoScene if none is recorded, ArtifactStale if it is missing."""
    waiting = [field]
    while waiting:
        one = waiting.pop(0)
        inside = WorkFolder(one.path.parent.parent)
        for ref in one.manifest.inputs:
            if ref.kind == "scene":
                return original_scene(inside.get("scene", ref.name))
            if ref.kind == "field":
                waiting.append(inside.get("field", ref.name))
    raise NoScene(f"field {field.name} does not record the scene it was made from")


def _style(artifact: Artifact, report: Artifact | None) -> Group:
    """The style image an evaluation compared with, else the one the field was made with, else the references."""
    for config in [one.manifest.config for one in (report, artifact) if one is not None]:
        if style := config.get("style"):
            return Group((config.get("style_digest") or style,), _file_name(style))
    config = artifact.manifest.config
    if references := config.get("reference"):
        names = " + ".join(_file_name(text.partition("=")[2]) for text in references)
        return Group((config.get("references_digest") or names,), f"after {names}")
    return Group((), "unknown style image")


def _edited(report: Artifact | None, content: dict) -> Group:
    """The masks an evaluation was given, else its regions."""
    config = report.manifest.config if report else {}
    if masks := config.get("masks"):
        return Group((config.get("masks_digest") or masks,), f"masks {_file_name(masks)}")
    names = ((content.get("edit") or {}).get("regions")) or []
    digests = sorted(ref.digest for ref in report.manifest.inputs if ref.kind == "region") if report else []
    return Group(tuple(digests or names), " + ".join(names))


def _file_name(path: str) -> str:
    return path.replace("\\", "/").rstrip("/").rpartition("/")[2]


def _group_names(groups: Sequence[Group]) -> list[str]:
    """Return a unique name per group: that of its first run, plus part of its digest if another group shares it."""
    first: dict[tuple, str] = {}
    for group in groups:
        first.setdefault(group.digests, group.name)
    uses = Counter(first.values())
    names = {key: name if uses[name] == 1 else f"{name} ({digest_of(key)[:8]})" for key, name in first.items()}
    return [names[group.digests] for group in groups]


def _method(artifact: Artifact, family: str) -> str:
    config = artifact.manifest.config
    if family == FITS:
        kinds, head = config.get("field", "vm"), config.get("head", "linear")
        return kinds if head == "linear" else f"{kinds}, {head}"
    if artifact.manifest.stage == "recolor":
        return "palettenerf"
    if family == EDITS:
        return f"colors: {config['colors']}" if "colors" in config else artifact.manifest.stage
    return str(config.get("method") or artifact.manifest.stage)


def _settings(config: dict) -> str:
    """The options that are most often varied."""
    formats = {"budget": "{}", "capacity": "{}", "rays": "rays {}"}
    return ", ".join(text.format(config[key]) for key, text in formats.items() if config.get(key))


def _gaps(run: Run, work: WorkFolder) -> list[Gap]:
    command = f"stylerf eval {shlex.quote(str(work.root))} --of {run.name}"
    found = [Gap(f"{run.title}: {key}", "Its manifest does not record it.") for key in COSTS if run.costs[key] is None]
    missing = [key for key in NEEDED[run.family] if key not in run.metrics]
    if not run.metrics:
        flags = " --region NAME" if run.family == EDITS else ""
        return [*found, Gap(f"{run.title}: all metrics", f"It has no current evaluation; run: {command}{flags}")]
    for flag in dict.fromkeys(CHARTED[run.family][key] for key in missing):
        keys = [key for key in missing if CHARTED[run.family][key] == flag]
        more = {"": "", "--path": " --path PATH", "--region": " --region NAME"}[flag]
        found.append(Gap(f"{run.title}: {', '.join(keys)}", f"Not in its report; run: {command}{more}"))
    return found
