"""Exports of a work folder."""

from schemas.work_folder import Artifact
from stages.configs.export import ExportConfig
from stages.configs.render import label_of
from stages.pipeline import prerequisites
from stages.pipeline.stage_runner import Request, StageRunner


def exported(runner: StageRunner, config: ExportConfig, of: str, request: Request) -> Artifact:
    """Export a field (the newest if `of` is empty), or cameras, for which the scene alone is enough."""
    from stages import export

    config = export.pinned(config)
    if config.kind == "cameras" and not of:
        scene = prerequisites.scene_of_work(runner.work)
        return runner.run(export.SPEC, export.run, {"scene": scene}, config, _name("", config), request)
    field = prerequisites.field_named(runner, of)
    inputs = {"scene": prerequisites.scene_of(runner.work, field), "field": field}
    by = ("--of", field.name)
    if config.kind == "cameras":  # those of its scene; the field's look does not matter
        inputs = {"scene": inputs["scene"]}
    return runner.run(export.SPEC, export.run, inputs, config, _name(field.name, config), request, by)


def _name(field: str, config: ExportConfig) -> str:
    """Return the default name: FIELD-mesh, FIELD-splats, FIELD-shot, or PATH-cameras."""
    return f"{label_of(config.along)}-cameras" if config.kind == "cameras" else f"{field}-{config.kind}"
