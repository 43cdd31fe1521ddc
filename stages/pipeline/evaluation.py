"""Evaluate a field: choose or render the frames to measure, then measure them."""

from collections.abc import Sequence
from dataclasses import dataclass

from schemas.canonical_json import plain
from schemas.errors import StylerfError, UsageError
from schemas.frames import FRAMES_FILE, read_frames
from schemas.work_folder import Artifact, WorkFolder, newest, shortened_name
from stages.configs.evaluate import EvaluateConfig
from stages.configs.render import MEASURABLE, OWN_VIEWS, label_of
from stages.pipeline.prerequisites import ensure_frames, field_named, frames_config, scene_of
from stages.pipeline.stage_runner import Request, StageRunner


@dataclass(frozen=True)
class Comparison:
    """What a field is measured along and against.

    path: camera path of the consistency metrics, empty for that of the newest video. regions: of a local edit.
    base: the field before the edit, empty for the one it started from. robust_to: the field whose renders were the
    references of this one.
    """

    path: str = ""
    regions: Sequence[str] = ()
    base: str = ""
    robust_to: str = ""


def evaluated(
    runner: StageRunner, config: EvaluateConfig, field_name: str, against: Comparison, request: Request
) -> Artifact:
    """Evaluate a field, the newest if `field_name` is empty; render the frames that this needs.

    Raises:
        UsageError: options do not fit the field or each other.
    """
    from stages import evaluate
    from stages.artifacts.provenance import field_unstylized, is_stylized
    from stages.evaluate import pinned
    from stages.evaluation.perceptual_metrics import style_file
    from stages.evaluation.reference_metrics import check_references
    from stages.evaluation.test_views import SceneViews

    if against.path in OWN_VIEWS:
        raise UsageError(
            f"--path {against.path}: the photos' views are too far apart to warp onto each other; give a camera path"
        )
    field = field_named(runner, field_name)
    # Reject what cannot work before minutes of rendering.
    given, config = config, pinned(config, field)
    if (against.robust_to or config.reference) and not is_stylized(field):
        raise UsageError(f"--reference and --robust-to need a stylized field; {field.name} is not one")
    if config.ceiling and (against.regions or config.masks):
        raise UsageError("--ceiling compares whole views; leave it out for a local edit")
    scene = scene_of(runner.work, field)
    if config.reference:
        check_references(config.reference, SceneViews(scene))
    referenced = field_named(runner, against.robust_to) if against.robust_to else None
    base, regions = _edit_compared(runner, field, config, against)
    runner.say(f"measuring field {field.name}")
    for one in runner.work.artifacts("frames"):
        if fault := _fault_of(one):
            runner.say(f"skipping frames {one.name}: {fault}")
    video = None if against.path else newest_video(runner.work, field)
    if config.flow and not against.path and video is None:
        raise UsageError("--flow needs frames along a camera path; give --path")
    for line in _unused(given, styled=style_file(given, field) is not None, edit=base is not None,
                        path=bool(against.path) or video is not None):  # fmt: skip
        runner.say(line)
    # Test views first: a scene may have none.
    inputs = {"scene": scene, "field": field, "frames": frames_along(runner, field, "test")}
    if against.path:
        video = frames_along(runner, field, against.path)
    if video is not None:
        inputs["path_frames"] = video
    if is_stylized(field) and (unstylized := field_unstylized(field)) is not None:
        inputs["base_frames"] = frames_along(runner, unstylized, "test")
    if referenced is not None:
        inputs["reference_frames"] = frames_along(runner, referenced, "test")
    if base is not None:
        inputs |= _edit_inputs(runner, field, base, regions, config.train_views)
    return runner.run(evaluate.SPEC, evaluate.run, inputs, config, field.name, request)


def _unused(config: EvaluateConfig, styled: bool, edit: bool, path: bool) -> list[str]:
    """Return a line for each kind of options that were given and have no effect here."""
    kinds = (
        (styled, ("features", "style_side"), "a style image; name one with --style"),
        (edit, ("margin", "ring"), "a local edit; give its --region or --masks"),
        (path, ("consistency", "gap", "pairs", "perceptual_pairs", "depth_tolerance"), "a camera path; give --path"),
    )
    lines = []
    for there, names, needed in kinds:
        given = [
            f"--{name.replace('_', '-')}" for name in names if getattr(config, name) != getattr(EvaluateConfig, name)
        ]
        if given and not there:
            lines.append(f"not used: {', '.join(given)}, without {needed}")
    return lines


def _edit_compared(
    runner: StageRunner, field: Artifact, config: EvaluateConfig, against: Comparison
) -> tuple[Artifact | None, list[Artifact]]:
    """Return the field before a local edit and the regions of the edit; (None, []) if no edit is evaluated."""
    from stages.artifacts.provenance import field_before

    if not (against.regions or config.masks):
        if against.base or config.train_views:
            raise UsageError("--base and --train-views evaluate a local edit; give its --region or --masks")
        return None, []
    regions = [runner.work.find("region", name) for name in against.regions]
    base = field_named(runner, against.base) if against.base else field_before(field)
    if against.base and base is not None and base.name == field.name:
        raise UsageError(f"--base {base.name} is the edited field itself; name the one before the edit")
    if base is None or base.name == field.name:
        raise UsageError(f"field {field.name} is not derived from another field; name the unedited one with --base")
    return base, regions


def _edit_inputs(
    runner: StageRunner, field: Artifact, base: Artifact, regions: list[Artifact], train_views: bool
) -> dict[str, Artifact]:
    """Return the inputs of a local edit's evaluation by role: the field before, frames of both, the regions."""
    from stages.artifacts.region import ROLE

    runner.say(f"comparing with field {base.name}")
    inputs = {"base_field": base, "unedited_frames": frames_along(runner, base, "test")}
    if train_views:
        inputs["train_frames"] = frames_along(runner, field, "train")
        inputs["unedited_train_frames"] = frames_along(runner, base, "train")
    return inputs | {ROLE + one.name: one for one in regions}


def frames_along(runner: StageRunner, field: Artifact, path: str) -> Artifact:
    """Return the newest frames of a field along a path that can be measured and have the wanted count, else render.

    Frames that the user rendered are not replaced, even if they cannot be measured. StylerfError if frames that would
    be replaced cannot be read.
    """
    from stylerf.geometry.camera_paths import PATHS

    wanted = frames_config(runner, path)
    usable = [
        frames
        for frames, along, count in _measurable(runner.work, field)
        # Compare digests: a camera file may have changed since.
        if (frames.manifest.config.get("path_digest") == wanted.path_digest if wanted.path_digest else along == path)
        and (path not in PATHS or count == wanted.count)
    ]
    if usable:
        return newest(usable)[0]
    name = shortened_name(f"{field.name}-{label_of(path)}")
    present = next((one for one in runner.work.artifacts("frames") if one.name == name), None)
    if present is not None:
        _check(present)  # unreadable frames, perhaps of a newer stylerf, are not replaced without a request
    # Frames that an earlier stylerf made with the same options are rendered again in their place.
    taken = present is not None and _shows(present, field) and present.manifest.config != plain(wanted)
    return ensure_frames(runner, field, path, f"{name}-eval" if taken else name)


def newest_video(work: WorkFolder, field: Artifact) -> Artifact | None:
    """Return the newest measurable frames, two or more, of a field along a camera path; None without any."""
    found = [frames for frames, path, count in _measurable(work, field) if path not in OWN_VIEWS and count > 1]
    return newest(found)[0] if found else None


def _measurable(work: WorkFolder, field: Artifact) -> list[tuple[Artifact, str, int]]:
    """Return frames of the current field with their path and count: whole paths at full size and strength, with EXR.

    Frames of another revision of the render stage are left out.
    """
    from stages.render import SPEC

    found = []
    for one in work.artifacts("frames"):
        if _fault_of(one):
            continue
        config = one.manifest.config
        full = config.get("scale", 1) == 1 and config.get("strength", 1) == 1
        whole = full and config.get("exr", True) and not config.get("frames")
        whole = whole and all(config.get(name, value) == value for name, value in MEASURABLE.items())
        current = (one.manifest.stage, one.manifest.revision) == (SPEC.stage, SPEC.revision)
        if whole and current and _shows(one, field) and one.has(FRAMES_FILE):
            frames = read_frames(one.path)
            if frames.field == field.name:
                found.append((one, frames.path, len(frames.views)))
    return found


def _check(frames: Artifact) -> None:
    """Raise StylerfError if the manifest, a file's length or the list of views cannot be read."""
    frames.check_sizes()
    if frames.has(FRAMES_FILE):
        read_frames(frames.file(FRAMES_FILE).parent)


def _fault_of(frames: Artifact) -> str:
    try:
        _check(frames)
    except StylerfError as error:
        return str(error)
    return ""


def _shows(frames: Artifact, field: Artifact) -> bool:
    """Return whether frames were rendered from the current version of a field."""
    return any(ref.kind == "field" and ref.digest == field.digest for ref in frames.manifest.inputs)
