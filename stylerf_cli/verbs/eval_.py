"""`stylerf eval WORK [--of NAME]`: figures, charts and a page about one field."""

from typing import Any

from schemas.canonical_json import plain
from schemas.errors import StylerfError, UsageError
from schemas.frames import FRAMES_FILE, read_frames
from schemas.work_folder import Artifact, WorkFolder, newest
from stages.configs.evaluate import EvaluateConfig
from stages.configs.render import OWN_VIEWS, label_of

NAME = "eval"
HELP = "measure a field: quality, style, consistency, cost; a report with pictures"
CONFIG = EvaluateConfig


def add_arguments(parser) -> None:
    """WORK, --of, --path, --region, --base, --robust-to."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", help="field to measure (default: the one made last)")
    parser.add_argument(
        "--path",
        metavar="PATH",
        help="camera path for consistency between views, rendered if it is not there with as many frames as the table "
        "[render] asks for, 30 without one (default: the film that is there, whatever its length)",
    )
    parser.add_argument(
        "--region",
        metavar="NAME",
        action="append",
        default=[],
        help="region of a local edit: what it changed there, and what it left of the background (several: their union)",
    )
    parser.add_argument(
        "--base",
        metavar="FIELD",
        help="unedited field to compare a local edit with (default: the one it started from, or that its palette was "
        "learned of)",
    )
    parser.add_argument(
        "--robust-to",
        metavar="FIELD",
        help="stylized field whose renders were the references of this one: Robustness, the PSNR between the two",
    )


def run(args, session) -> dict:
    """The report's place, its figures, its warnings and what was not measured."""
    from stages import evaluate
    from stages.artifacts.provenance import field_unstylized, is_stylized
    from stages.evaluation.pinned_inputs import pinned
    from stages.evaluation.reference_metrics import check_references
    from stages.evaluation.test_views import SceneViews
    from stages.pipeline.prerequisites import chosen_field, scene_of

    if args.path in OWN_VIEWS:
        raise UsageError(
            f"--path {args.path}: views of photos lie too far apart to be warped onto one another; give a camera path"
        )
    field = chosen_field(session, args.of)
    # Whatever cannot be is refused here, before minutes of rendering.
    config = pinned(session.config, field)
    if (args.robust_to or config.reference) and not is_stylized(field):
        raise UsageError(f"--reference and --robust-to are for a stylized field; {field.name} is none")
    scene = scene_of(session.work, field)
    if config.reference:
        check_references(config.reference, SceneViews(scene))
    twin = chosen_field(session, args.robust_to) if args.robust_to else None
    base, regions = edit_asked(session, field, args)
    session.say(f"measuring field {field.name}")
    for one in session.work.artifacts("frames"):
        if fault := fault_of(one):
            session.say(f"frames {one.name} are passed over: {fault}")
    film = frames_of(session, field, args.path) if args.path else film_there(session.work, field)
    if film is None and config.flow:
        raise UsageError("--flow is of the frames of a camera path, and there are none; name the path by --path")
    inputs = {"scene": scene, "field": field, "frames": frames_of(session, field, "test")}
    if film is not None:
        inputs["path_frames"] = film
    if is_stylized(field):
        plain = field_unstylized(field)
        if plain is not None:
            inputs["base_frames"] = frames_of(session, plain, "test")
    if twin is not None:
        inputs["reference_frames"] = frames_of(session, twin, "test")
    if base is not None:
        inputs |= edit_inputs(session, field, base, regions)
    report = session.run(evaluate.SPEC, evaluate.run, inputs, config, field.name)
    return told(report, session)


def edit_asked(session: Any, field: Artifact, args: Any) -> tuple[Artifact | None, list[Artifact]]:
    """The field before a local edit, and the regions of that edit; None and none where no edit is asked for.

    UsageError where the field before it is not known.
    """
    from stages.artifacts.provenance import field_before
    from stages.pipeline.prerequisites import chosen_field

    config = session.config
    if not (args.region or config.masks):
        if args.base or config.train_views:
            raise UsageError("--base and --train-views are for a local edit; name it by --region, or give its --masks")
        return None, []
    regions = [session.work.find("region", name) for name in args.region]
    base = chosen_field(session, args.base) if args.base else field_before(field)
    if base is None or base.name == field.name:
        raise UsageError(f"field {field.name} was made from no other field; name the unedited one by --base")
    return base, regions


def edit_inputs(session: Any, field: Artifact, base: Artifact, regions: list[Artifact]) -> dict[str, Artifact]:
    """What the evaluation of a local edit needs, by role: the field before it, frames of both, its regions."""
    from stages.artifacts.region_masks import ROLE

    session.say(f"comparing with field {base.name}")
    inputs = {"base_field": base, "unedited_frames": frames_of(session, base, "test")}
    if session.config.train_views:
        inputs["train_frames"] = frames_of(session, field, "train")
        inputs["unedited_train_frames"] = frames_of(session, base, "train")
    return inputs | {ROLE + one.name: one for one in regions}


def frames_of(session: Any, field: Artifact, path: str) -> Artifact:
    """Frames of the field along `path`: the last that can be measured and are as many as would be rendered, else those.

    Frames of the field that are of no use here, but were asked for once, are not replaced; what lies in the place of
    new ones and cannot be read stops it.
    """
    from stages.pipeline.prerequisites import ensure_frames, frames_config
    from stylerf.geometry.camera_paths import PATHS

    wanted = frames_config(session, path)
    there = [
        frames
        for frames, along, count in measurable(session.work, field)
        # A file of cameras may have changed since; whether it has, its digest tells.
        if (frames.manifest.config.get("path_digest") == wanted.path_digest if wanted.path_digest else along == path)
        and (path not in PATHS or count == wanted.count)
    ]
    if there:
        return last(there)
    name = f"{field.name}-{label_of(path)}"
    here = next((one for one in session.work.artifacts("frames") if one.name == name), None)
    if here is not None:
        check(here)  # what cannot be read, perhaps of a newer stylerf, is not replaced unasked
    # What an earlier stylerf made by these very options is made again in its place.
    taken = here is not None and shows(here, field) and here.manifest.config != plain(wanted)
    return ensure_frames(session, field, path, f"{name}-eval" if taken else name)


def film_there(work: WorkFolder, field: Artifact) -> Artifact | None:
    """The last rendered frames, two or more, of the field along a camera path that can be measured, None where there
    are none."""
    films = [frames for frames, path, count in measurable(work, field) if path not in OWN_VIEWS and count > 1]
    return last(films) if films else None


def measurable(work: WorkFolder, field: Artifact) -> list[tuple[Artifact, str, int]]:
    """Frames of the field as it stands, their path and how many: whole ones, with EXR, of the views' own size, as this
    stylerf renders them."""
    from stages.render import SPEC

    found = []
    for one in readable(work):
        config = one.manifest.config
        whole = config.get("exr", True) and config.get("scale", 1) == 1 and not config.get("frames")
        of_now = (one.manifest.stage, one.manifest.revision) == (SPEC.stage, SPEC.revision)
        if whole and of_now and shows(one, field) and one.has(FRAMES_FILE):
            frames = read_frames(one.path)
            if frames.field == field.name:
                found.append((one, frames.path, len(frames.views)))
    return found


def readable(work: WorkFolder) -> list[Artifact]:
    """Frames that are whole as far as manifests, lengths of files and lists of views tell."""
    return [one for one in work.artifacts("frames") if not fault_of(one)]


def check(frames: Artifact) -> None:
    """StylerfError where a manifest, a file's length or the list of views cannot be read."""
    frames.check_sizes()
    if frames.has(FRAMES_FILE):
        read_frames(frames.file(FRAMES_FILE).parent)


def fault_of(frames: Artifact) -> str:
    """What keeps these frames from being read, in words; empty where nothing does."""
    try:
        check(frames)
    except StylerfError as error:
        return str(error)
    return ""


def last(artifacts: list[Artifact]) -> Artifact:
    """That made last."""
    return newest(artifacts)[0]


def shows(frames: Artifact, field: Artifact) -> bool:
    """Whether frames were rendered from this field as it stands."""
    return any(ref.kind == "field" and ref.digest == field.digest for ref in frames.manifest.inputs)


def told(report: Artifact, session: Any) -> dict:
    """The result for --json, printed in words too."""
    from stages.artifacts.report import read_report

    content = read_report(report)
    page = report.file("report.html")
    result = {
        "report": report.path,
        "page": page,
        "field": content["field"],
        "stylized": content["stylized"],
        "figures": {metric["key"]: metric["mean"] for metric in content["metrics"]},
        "protocols": {metric["key"]: metric["protocol"] for metric in content["metrics"]},
        "warnings": content["warnings"],
        "not_measured": content["not_measured"],
        "seconds": report.manifest.seconds,
    }
    width = max((len(metric["label"]) for metric in content["metrics"]), default=0)
    lines = [f"{content['field']} on {content['scene']}, {content['view_count']} held-out views"]
    lines += [_metric_line(metric, width) for metric in content["metrics"]]
    lines += [f"  note: {text}" for text in content["warnings"]]
    lines.append(f"page: {page}")
    return session.emit(result, lines)


def _metric_line(metric: dict, width: int) -> str:
    unit = "" if metric["unit"] == "fraction" else metric["unit"]
    value = f"{metric['mean']:.{metric['digits']}f} {unit}".rstrip()
    references = "".join(f"; {name}: {mean:.{metric['digits']}f}" for name, mean in metric["reference"].items())
    return f"  {metric['label']:<{width}}  {value}{references}"
