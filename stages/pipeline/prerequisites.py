"""What a verb needs made before it: each step is announced by the session, or refused with --only."""

from dataclasses import replace
from typing import Any

from schemas.errors import ArtifactStale, UsageError
from schemas.work_folder import Artifact, WorkFolder, newest
from stages.configs.decompose import METHOD
from stages.configs.deform import DeformConfig
from stages.configs.fit import FitConfig
from stages.configs.render import OWN_VIEWS, RenderConfig

FIT_NAME = "fit"


def scene_of_work(session: Any) -> Artifact:
    """The only scene of the work folder; scenes that `distill` painted an edit into are not counted."""
    scenes = [one for one in session.work.artifacts("scene") if one.manifest.stage != "distill"]
    if len(scenes) > 1:
        names = ", ".join(one.name for one in scenes)
        raise UsageError(f"{session.work.root} holds the scenes {names}; expected one a work folder: delete the others")
    return scenes[0] if scenes else session.work.get("scene", "main")


def input_of(session: Any, artifact: Artifact, kind: str, role: str = "") -> Artifact:
    """What an artifact was made from, of one kind (and role); ArtifactStale where it is gone or was made anew."""
    for ref in artifact.manifest.inputs:
        if ref.kind == kind and role in ("", ref.role):
            found = session.work.get(kind, ref.name)
            if found.digest != ref.digest:
                raise ArtifactStale(
                    f"{kind} {ref.name} was made anew after {artifact.kind} {artifact.name}; make that again too: "
                    f"{artifact.rebuild_command()}"
                )
            return found
    raise ArtifactStale(f"{artifact.kind} {artifact.name} names no {kind} it was made from; make it again")


def pictures_of(session: Any, field: Artifact) -> Artifact:
    """The scene of the pictures that a field was last taught: the photos, or those with the edits it has learned."""
    for ref in field.manifest.inputs:
        if ref.kind == "scene" and session.work.get("scene", ref.name).manifest.stage == "distill":
            return input_of(session, field, "scene")
    return scene_of_work(session)


def teaching_pictures(session: Any, field: Artifact) -> Artifact:
    """As pictures_of, to teach the whole field by; UsageError for one whose colors they do not show."""
    from stages.artifacts.provenance import fields_behind, shows_its_pictures

    if not shows_its_pictures(field):
        before = next((one.name for one in fields_behind(field) if shows_its_pictures(one)), "")
        raise UsageError(
            f"field {field.name} has colors that no photo shows, and would be taught the photos' again; start from "
            f"--of {before or 'the field that it was made from'}, or edit a part of it by `stylerf edit`"
        )
    return pictures_of(session, field)


def made_from(session: Any, kind: str, stage: str, source: Artifact) -> Artifact | None:
    """What a stage made last of `source` as it stands, None where there is nothing of it."""
    made = [
        one
        for one in session.work.artifacts(kind)
        if one.manifest.stage == stage and any(ref.digest == source.digest for ref in one.manifest.inputs)
    ]
    return next(iter(newest(made)), None)


def scene_of(work: WorkFolder, field: Artifact) -> Artifact:
    """The scene of photos that a field was made from, directly, through other fields or through edited pictures."""
    from stages.artifacts.provenance import fields_behind, original_scene

    for one in [field, *fields_behind(field)]:
        for ref in one.manifest.inputs:
            if ref.kind == "scene":
                return original_scene(work.get("scene", ref.name))
    raise ArtifactStale(f"field {field.name} names no scene it was made from; make it again: {field.rebuild_command()}")


def chosen_field(session: Any, name: str | None) -> Artifact:
    """The field called `name`, else the one made last; says why it is out of date where it is."""
    field = session.work.find("field", name) if name else _made_last(session.work)
    for reason in session.work.outdated(field):
        session.say(f"field {field.name} is out of date: {reason}")
    return field


def _made_last(work: WorkFolder) -> Artifact:
    fields = work.artifacts("field")
    if not fields:
        return work.get("field", FIT_NAME)
    return newest(fields)[0]


def ensure_field(session: Any, scene: Artifact, name: str | None = None) -> Artifact:
    """The field called `name`; else the fitted one: whichever was fitted to the scene already, or with default options
    now."""
    if name:
        return chosen_field(session, name)
    if made := made_from(session, "field", "nerf_fit", scene):
        return made
    from stages import nerf_fit

    return session.run(nerf_fit.SPEC, nerf_fit.run, {"scene": scene}, session.config_of("fit", FitConfig), FIT_NAME)


def deform(session: Any, scene: Artifact, field: Artifact, config: DeformConfig) -> Artifact:
    """A field with a deformation that has been initialized on the photos, named <field>-deformed."""
    from stages import deform_init

    inputs, by = {"scene": scene, "field": field}, ("--of", field.name)
    return session.run(deform_init.SPEC, deform_init.run, inputs, config, f"{field.name}-deformed", by=by)


def ensure_deformed(session: Any, scene: Artifact, field: Artifact) -> Artifact:
    """The field itself where it has a deformation, else what `stylerf deform` makes of it."""
    if field.manifest.stage == "deform_init":
        return field
    if made := made_from(session, "field", "deform_init", field):
        return made
    return deform(session, scene, field, session.config_of("deform", DeformConfig))


def ensure_frames(session: Any, field: Artifact, path: str, name: str) -> Artifact:
    """Frames of a field along a path, as `frames_config` says."""
    from stages import render

    config = frames_config(session, path)
    inputs = {"scene": scene_of(session.work, field), "field": field, **regions_shown(session, field, config)}
    return session.run(render.SPEC, render.run, inputs, config, name, by=("--of", field.name))


def frames_config(session: Any, path: str) -> RenderConfig:
    """A table [render] decides all but that frames are the whole path's, of full size and with EXR, and that photos'
    views are no film; 30 frames without it."""
    from stages.render import pinned

    config, count = session.config_of("render", RenderConfig), session.options.table("render").get("count", 30)
    film = config.video and path not in OWN_VIEWS
    return pinned(replace(config, path=path, count=count, scale=1.0, frames="", exr=True, video=film))


def regions_shown(session: Any, field: Artifact, config: RenderConfig) -> dict[str, Artifact]:
    """The regions of the work folder that frames of a field show, by role; says which belong to another space."""
    if not config.shows_regions:
        return {}
    from stages.artifacts.region_masks import regions_fitting

    fitting, others = regions_fitting(session.work, field)
    if others:
        session.say(f"no masks of {', '.join(others)}: selected in the space of another field than {field.name}")
    return fitting


def palette_learned(session: Any, scene: Artifact, field: Artifact, config: Any, changes: Any) -> Artifact:
    """A field whose colors are decomposed into a palette, <field>-palettenerf; with changes, <field>-recolored.

    With changes, what was learned stands beside under its own name, so that other changes need no training.
    """
    from stages import decompose
    from stages.run.runner import refuse_to_replace

    inputs, name = {"scene": scene, "field": field}, f"{field.name}-palettenerf"
    if not changes:
        return session.run(decompose.SPEC, decompose.run, inputs, config, name)
    if session.name:  # refused before the palette is learned, not after it
        refuse_to_replace(session.work, "field", session.name, [field])
    by = ("--method", METHOD, "--of", field.name)
    learned = session.run(decompose.SPEC, decompose.run, inputs, config, name, own=False, by=by)
    return palette_changed(session, scene, learned, changes)


def palette_changed(session: Any, scene: Artifact, field: Artifact, changes: Any) -> Artifact:
    """A field with changes of its palette, <field>-recolored unless a name is given."""
    from stages import recolor

    inputs = {"scene": scene, "field": field}
    return session.run(recolor.SPEC, recolor.run, inputs, changes, f"{field.name}-recolored")
