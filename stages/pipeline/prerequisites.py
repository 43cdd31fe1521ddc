"""Prerequisites of stages: the scene, a style image, a field, a deformation, frames."""

import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactStale, BadInput, UsageError
from schemas.work_folder import Artifact, WorkFolder, newest
from stages.configs.deform import DeformConfig
from stages.configs.fit import FitConfig
from stages.configs.pose_import import ImportConfig, ImportOptions
from stages.configs.render import DEEP_SAMPLES, MEASURABLE, OWN_VIEWS, RenderConfig
from stages.pipeline.stage_runner import Request, StageRunner

FIT_NAME = "fit"


def photo_scenes(work: WorkFolder) -> list[Artifact]:
    """Return the scenes of a work folder, except those that `distill` painted an edit into."""
    return [one for one in work.artifacts("scene") if one.manifest.stage != "distill"]


def scene_of_work(work: WorkFolder) -> Artifact:
    """Return the only scene of photos in a work folder; UsageError if there are several."""
    scenes = photo_scenes(work)
    if len(scenes) > 1:
        names = ", ".join(one.name for one in scenes)
        raise UsageError(f"{work.root} holds the scenes {names}; expected one per work folder: delete the others")
    return scenes[0] if scenes else work.get("scene", "main")


def input_of(work: WorkFolder, artifact: Artifact, kind: str, role: str = "") -> Artifact:
    """Return the input of an artifact that has this kind (and role); ArtifactStale if it is missing or was rebuilt."""
    for ref in artifact.manifest.inputs:
        if ref.kind == kind and role in ("", ref.role):
            found = work.get(kind, ref.name)
            # By digest, not by time: a rebuild to the same bytes leaves everything after it valid.
            if found.digest != ref.digest:
                raise ArtifactStale(
                    f"{kind} {ref.name} was rebuilt after {artifact.kind} {artifact.name}; rebuild that too: "
                    f"{artifact.rebuild_command()}"
                )
            return found
    raise ArtifactStale(f"{artifact.kind} {artifact.name} does not record a {kind} as its input; rebuild it")


def pictures_of(work: WorkFolder, field: Artifact) -> Artifact:
    """Return the scene that a field was last trained on: the photos, or those with an edit painted in."""
    for ref in field.manifest.inputs:
        if ref.kind == "scene" and work.get("scene", ref.name).manifest.stage == "distill":
            return input_of(work, field, "scene")
    return scene_of_work(work)


def training_pictures(work: WorkFolder, field: Artifact) -> Artifact:
    """Return the scene to train the whole field on; UsageError if that scene does not show the field's colors."""
    from stages.artifacts.provenance import fields_behind, shows_its_pictures

    if not shows_its_pictures(field):
        before = next((one.name for one in fields_behind(field) if shows_its_pictures(one)), "")
        raise UsageError(
            f"the colors of field {field.name} are not in the photos, so training on those would undo them. Start "
            f"from --of {before or 'the field that it was made from'}, or edit a part of it with `stylerf edit`"
        )
    return pictures_of(work, field)


def scene_of(work: WorkFolder, field: Artifact) -> Artifact:
    """Return the scene of photos that a field was made from, directly, through other fields or edited pictures."""
    from stages.artifacts.provenance import fields_behind, original_scene

    for one in [field, *fields_behind(field)]:
        for ref in one.manifest.inputs:
            if ref.kind == "scene":
                return original_scene(work.get("scene", ref.name))
    raise ArtifactStale(
        f"field {field.name} does not record a scene as its input; rebuild it: {field.rebuild_command()}"
    )


def field_named(runner: StageRunner, name: str) -> Artifact:
    """Return the field called `name`, the newest if that is empty. Stale fields are reported, not rebuilt."""
    if name:
        field = runner.work.find("field", name)
    else:
        fields = runner.work.artifacts("field")
        field = newest(fields)[0] if fields else runner.work.get("field", FIT_NAME)
    for reason in runner.work.outdated(field):
        runner.say(f"field {field.name} is out of date: {reason}")
    return field


def ensure_field(runner: StageRunner, scene: Artifact, name: str = "") -> Artifact:
    """Return the field called `name`. Without a name return the current fit of the scene, fitting one if needed."""
    if name:
        return field_named(runner, name)
    return runner.made_from("field", "nerf_fit", scene) or fitted(
        runner, scene, runner.options.config_of("fit", FitConfig), None
    )


def fitted(runner: StageRunner, scene: Artifact, config: FitConfig, request: Request | None) -> Artifact:
    """Fit a field to a scene."""
    from stages import nerf_fit

    if request is None:  # the views of a fit that is only a prerequisite are not needed
        config = replace(config, buffers=False)
    return runner.run(nerf_fit.SPEC, nerf_fit.run, {"scene": scene}, config, FIT_NAME, request)


def deformed(
    runner: StageRunner, scene: Artifact, field: Artifact, config: DeformConfig, request: Request | None
) -> Artifact:
    """Give a field a deformation that is initialized on the photos; it is named <field>-deformed."""
    from stages import deform_init

    inputs, by = {"scene": scene, "field": field}, ("--of", field.name)
    return runner.run(deform_init.SPEC, deform_init.run, inputs, config, f"{field.name}-deformed", request, by)


def ensure_deformed(runner: StageRunner, scene: Artifact, field: Artifact) -> Artifact:
    """Return the field itself if it has a deformation, else its deformed version."""
    if field.manifest.stage == "deform_init":
        return field
    return runner.made_from("field", "deform_init", field) or deformed(
        runner, scene, field, runner.options.config_of("deform", DeformConfig), None
    )


def ensure_frames(runner: StageRunner, field: Artifact, path: str, name: str) -> Artifact:
    """Return frames of a field along a camera path, rendered with the options of `frames_config`."""
    return rendered(runner, field, frames_config(runner, path), name, None)


def frames_config(runner: StageRunner, path: str) -> RenderConfig:
    """Return the options of frames that are rendered as a prerequisite.

    They are the options set for `render`, except that they cover the whole path, at full size and strength, with
    Rec.709 EXR, without what only compositors need, and without a video of the scene's own views. The default is 30
    frames.
    """
    from stages.render import pinned

    config = runner.options.config_of("render", RenderConfig)
    count = runner.options.table("render").get("count", 30)
    video = config.video and path not in OWN_VIEWS
    plain: dict[str, Any] = {**MEASURABLE, "cryptomatte": False, "deep": False, "st_map": False}
    plain["deep_samples"] = DEEP_SAMPLES  # has no effect without --deep
    whole: dict[str, Any] = {"count": count, "scale": 1.0, "strength": 1.0, "frames": "", "exr": True, "video": video}
    return pinned(replace(config, path=path, **whole, **plain))


def rendered(
    runner: StageRunner,
    field: Artifact,
    config: RenderConfig,
    name: str,
    request: Request | None,
    source: Artifact | None = None,
) -> Artifact:
    """Render a field.

    Args:
        config: holds the digest of its camera file (`stages.render.pinned`).
        source: the field that it was made from, for a strength below 1.
    """
    from stages import render

    inputs = {"scene": scene_of(runner.work, field), "field": field, **_regions_shown(runner, field, config)}
    if source is not None:
        inputs["source"] = source
    return runner.run(render.SPEC, render.run, inputs, config, name, request, by=("--of", field.name))


def _regions_shown(runner: StageRunner, field: Artifact, config: RenderConfig) -> dict[str, Artifact]:
    """Return the regions to render masks of, by role; report those selected in the space of a different field."""
    if not config.shows_regions:
        return {}
    from stages.artifacts.region import regions_fitting

    fitting, others = regions_fitting(runner.work, field)
    if others:
        runner.say(f"no masks of {', '.join(others)}: selected in the space of a different field than {field.name}")
    return fitting


SCENE = "main"
_DEFAULTS = ImportOptions()


def imported(runner: StageRunner, source: Path, options: ImportOptions, request: Request) -> Artifact:
    """Import photos, with their poses or without.

    Raises:
        UsageError: the work folder already holds a scene of another name.
    """
    from stages import pose_import

    name = request.name or SCENE
    if others := [one.name for one in photo_scenes(runner.work) if one.name != name]:
        raise UsageError(
            f"{runner.work.root} already holds scene {others[0]}, and a work folder holds one scene: import into "
            f"another folder, or replace it with --name {others[0]}"
        )
    return runner.run(pose_import.SPEC, pose_import.run, {}, import_config(source, options), SCENE, request)


def import_config(source: Path, options: ImportOptions = _DEFAULTS) -> ImportConfig:
    """Return the options of an import with its source and the digest of its files, so that changes are noticed."""
    from stages.pose_import import check_options, digest_of_source

    source = source.resolve()
    if options.cameras:
        options = replace(options, cameras=str(Path(options.cameras).resolve()))
    digest = digest_of_source(source, options.format, options.images, options.cameras)
    config = ImportConfig(**asdict(options), source=str(source), source_digest=digest)
    # Options that name files are not part of the recipe: if they do not apply, nothing later would reject them.
    check_options(config)
    return config


LONGEST_NAME = 60  # names of artifacts made with a style image extend its name


def style_file(text: str) -> Path:
    """Return the path of the style image; BadInput if there is no such file."""
    path = Path(text).expanduser()
    if not path.is_file():
        raise BadInput(f"--style {text}: image not found")
    return path


def name_of(style: Path) -> str:
    """Return the file name of a style image as part of an artifact's name.

    Long names are cut and made unique by the file's digest, which also replaces names without a usable character.
    """
    name = re.sub(r"[^A-Za-z0-9._+-]+", "_", style.stem).strip("._+-")
    if 0 < len(name) <= LONGEST_NAME:
        return name
    return f"{name[: LONGEST_NAME - 7] or 'style'}-{file_sha256(style)[:6]}"
