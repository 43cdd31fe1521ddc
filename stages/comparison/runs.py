"""The runs of work folders as their manifests and reports tell them; nothing is run, nothing is measured."""

import shlex
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from schemas.canonical_json import digest_of
from schemas.errors import StylerfError
from schemas.work_folder import Artifact, WorkFolder, newest
from stages.artifacts.provenance import counted, is_stylized, original_scene
from stages.artifacts.report import read_report
from stages.evaluation.metric_definitions import BY_KEY
from stages.evaluation.metrics import is_number

FITS, STYLIZATIONS, EDITS = "fits", "stylizations", "edits"
COSTS = ("seconds", "peak_memory_mb", "parameters")
# What each family is drawn by, and the option of `stylerf eval` that a missing one needs.
CHARTED = {
    FITS: {"psnr": "", "ssim": "", "lpips": ""},
    STYLIZATIONS: {"nnfm": "", "content_ssim": "", "short_rmse": "--path", "long_rmse": "--path"},
    EDITS: {"background_mse": "--region", "bleeding": "--region", "sparsity": "--region", "edit_short_rmse": "--path"},
}
ORDER = {key: place for place, key in enumerate(BY_KEY)}
NEEDED = {FITS: ("psnr",), STYLIZATIONS: tuple(CHARTED[STYLIZATIONS]), EDITS: ("background_mse", "bleeding")}


@dataclass(frozen=True)
class Measure:
    """One figure of a run as its report tells it. count, left_out: views or pairs that took part, and could not."""

    mean: float
    label: str
    unit: str
    better: str
    protocol: str
    count: int
    left_out: int

    @property
    def way(self) -> tuple[str, int]:
        """What has to be the same for two figures to be set beside one another."""
        return self.protocol, self.count


@dataclass(frozen=True)
class Run:
    """One field that was made, with what making it from the fitted field cost, or fitting it.

    group: name of what its figures may be compared within: the scene, and the painting or the edited regions. costs: of
    COSTS, None where unknown; seconds are summed, memory is the greatest, over `stages`. figures: by key. threads: that
    these stages ran on, as far as their manifests tell.
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
    figures: dict[str, Measure] = field(default_factory=dict)
    threads: tuple[int, ...] = ()

    @property
    def title(self) -> str:
        """Work folder and field."""
        return f"{self.work}/{self.name}"


@dataclass(frozen=True)
class Group:
    """What runs have in common that may be compared. what: digests, of which it consists; words: to be shown."""

    what: tuple[str, ...]
    words: str


@dataclass(frozen=True)
class Gap:
    """A figure or a run that a comparison has to do without, and what to do about it."""

    what: str
    why: str


def runs_of(works: Sequence[WorkFolder]) -> tuple[list[Run], list[Gap]]:
    """Every fit, stylization and edit of these work folders, in the order given; and what is missing."""
    runs, groups, gaps, scenes = [], [], [], {}
    for work, called in zip(works, _called(works)):
        for artifact in work.artifacts("field"):
            try:
                family = family_of(artifact)
                if family is None:
                    continue
                run, group = _run(artifact, family, work, called, scenes)
            except StylerfError as error:
                gaps.append(Gap(f"{called}/{artifact.name}", f"It cannot be read: {error}"))
                continue
            runs.append(run)
            groups.append(group)
            gaps += _gaps(run, work)
    return [replace(run, group=name) for run, name in zip(runs, _named(groups), strict=True)], gaps


def on_other_threads(runs: Sequence[Run]) -> list[Gap]:
    """A remark for each group whose runs were made with different numbers of threads."""
    found = []
    for group in dict.fromkeys(run.group for run in runs):
        counts = sorted({count for run in runs if run.group == group for count in run.threads})
        if len(counts) > 1:
            told = " and ".join(map(str, counts))
            found.append(
                Gap(group, f"Made on {told} threads: seconds do not compare, and results differ in their last digits.")
            )
    return found


def family_of(artifact: Artifact) -> str | None:
    """Which family a field belongs to; None for one that only prepares another (a deformation or a palette
    fitted to the photos)."""
    stage = artifact.manifest.stage
    if stage in ("finetune", "recolor"):
        return EDITS
    if stage in ("deform_init", "decompose"):
        return None
    return STYLIZATIONS if is_stylized(artifact) else FITS


def _called(works: Sequence[WorkFolder]) -> list[str]:
    """Names of work folders, with their parents' where two would be the same."""
    paths = [work.root.resolve() for work in works]
    for depth in range(1, max(len(path.parts) for path in paths)):
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len({*names}) == len({*paths}):
            return names
    return [str(path) for path in paths]


def _run(artifact: Artifact, family: str, work: WorkFolder, called: str, scenes: dict[str, str]) -> tuple[Run, Group]:
    """The group's name is given when all runs are known."""
    manifest = artifact.manifest
    made = [*(_made_for(artifact) if family != FITS else ()), artifact]
    reports = _reports(artifact, work)
    own = [_own(artifact, family, *one) for one in reports] or [_own(artifact, family)]
    # The newest that tells what it is of; what tells nothing of it fits any.
    leading = next((one for one in own if one[0]), own[0])
    measured: dict[str, Measure] = {}
    for (what, _), (_, told) in zip(own, reports):
        if what in ((), leading[0]):
            measured = _measures(told) | measured
    group = _group(artifact, family, called, scenes, leading)
    run = Run(
        family=family,
        work=called,
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
        figures=dict(sorted(measured.items(), key=lambda one: ORDER.get(one[0], len(ORDER)))),
        threads=tuple(sorted({one.manifest.threads for one in made} - {None})),
    )
    return run, group


def _measures(told: dict) -> dict[str, Measure]:
    """By key, the figures of a report."""
    return {
        one["key"]: Measure(
            one["mean"], one["label"], one["unit"], one["better"], one["protocol"], one["count"], one["left_out"]
        )
        for one in told.get("figures", [])
        if is_number(one["mean"])
    }


def _made_for(artifact: Artifact, seen: set[Path] | None = None) -> list[Artifact]:
    """What was made on the way from the fitted field to this one, sources first, each once; `seen`: none of these.

    No import, fit, selection or rendering.
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
    """The evaluations of this very field with what they tell, the newest first."""
    found, told = [], {}
    for report in work.artifacts("report"):
        with suppress(StylerfError):  # a damaged report counts as none
            refs = report.manifest.inputs
            if any(ref.role == "field" and ref.digest == artifact.digest for ref in refs):
                told[report.path] = read_report(report)
                found.append(report)
    return [(report, told[report.path]) for report in newest(found)]


def _own(
    artifact: Artifact, family: str, report: Artifact | None = None, told: dict | None = None
) -> tuple[tuple[str, ...], str]:
    """Digests and names of what a report measures a run by, beside its scene: the painting, or the edited part."""
    if family == FITS:
        return (), ""
    return _look(artifact, report) if family == STYLIZATIONS else _edited(report, told or {})


def _group(
    artifact: Artifact, family: str, called: str, scenes: dict[str, str], leading: tuple[tuple[str, ...], str]
) -> Group:
    """scenes: names by digest, of scenes met so far, so that two folders with one scene make one group. leading: what
    its figures are measured by."""
    waiting, scene = [artifact], None
    while waiting and scene is None:
        one = waiting.pop(0)
        inside = WorkFolder(one.path.parent.parent)
        for ref in one.manifest.inputs:
            if ref.kind == "scene":
                scene = original_scene(inside.get("scene", ref.name))
                break
            if ref.kind == "field":
                waiting.append(inside.get("field", ref.name))
    name = called if scene is None else scenes.setdefault(scene.digest, called)
    what = (called if scene is None else scene.digest,)
    own, shown = leading
    return Group((*what, *own), f"{name}, {shown}" if shown else name)


def _look(artifact: Artifact, report: Artifact | None) -> tuple[tuple[str, ...], str]:
    """Digest and file name of the painting that an evaluation was told to measure against, else that a field was made
    with, else of the references."""
    for config in [one.manifest.config for one in (report, artifact) if one is not None]:
        if style := config.get("style"):
            return (config.get("style_digest") or style,), _file_name(style)
    config = artifact.manifest.config
    if references := config.get("reference"):
        names = " + ".join(_file_name(text.partition("=")[2]) for text in references)
        return (config.get("references_digest") or names,), f"after {names}"
    return (), "unknown painting"


def _edited(report: Artifact | None, told: dict) -> tuple[tuple[str, ...], str]:
    """Digests and names of what an evaluation took for the edited part: masks where they were given, else regions."""
    config = report.manifest.config if report else {}
    if masks := config.get("masks"):
        return (config.get("masks_digest") or masks,), f"masks {_file_name(masks)}"
    names = ((told.get("edit") or {}).get("regions")) or []
    digests = sorted(ref.digest for ref in report.manifest.inputs if ref.kind == "region") if report else []
    return tuple(digests or names), " + ".join(names)


def _file_name(path: str) -> str:
    return path.replace("\\", "/").rstrip("/").rpartition("/")[2]


def _named(groups: Sequence[Group]) -> list[str]:
    """One name a group, that of its first run; with some of its digest where another group is called so too."""
    first = {}
    for group in groups:
        first.setdefault(group.what, group.words)
    called = Counter(first.values())
    names = {what: words if called[words] == 1 else f"{words} ({digest_of(what)[:8]})" for what, words in first.items()}
    return [names[group.what] for group in groups]


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
    """What is most often varied, in words."""
    words = {"budget": "{}", "capacity": "{}", "rays": "rays {}"}
    return ", ".join(text.format(config[key]) for key, text in words.items() if config.get(key))


def _gaps(run: Run, work: WorkFolder) -> list[Gap]:
    command = f"stylerf eval {shlex.quote(str(work.root))} --of {run.name}"
    found = [Gap(f"{run.title}: {key}", "Its manifest does not tell.") for key in COSTS if run.costs[key] is None]
    missing = [key for key in NEEDED[run.family] if key not in run.figures]
    if not run.figures:
        flags = " --region NAME" if run.family == EDITS else ""
        return [*found, Gap(f"{run.title}: all figures", f"It was not evaluated as it stands; run: {command}{flags}")]
    for flag in dict.fromkeys(CHARTED[run.family][key] for key in missing):
        keys = [key for key in missing if CHARTED[run.family][key] == flag]
        more = {"": "", "--path": " --path PATH", "--region": " --region NAME"}[flag]
        found.append(Gap(f"{run.title}: {', '.join(keys)}", f"Its report does not hold it; run: {command}{more}"))
    return found
