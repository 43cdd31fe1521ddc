"""Blends of fields, and the field that others are derived from."""

from dataclasses import replace

from schemas.errors import UsageError
from schemas.work_folder import Artifact, WorkFolder
from stages.configs.blend import BlendConfig, text_of
from stages.pipeline.prerequisites import input_of
from stages.pipeline.stage_runner import Request, StageRunner


def blended(runner: StageRunner, config: BlendConfig, request: Request) -> Artifact:
    """Blend fields that were made from one field; the result is named after them.

    Raises:
        UsageError: the fields have no common source, or one is named twice.
        ArtifactStale: a field on the way to the source was rebuilt since.
    """
    from stages import blend

    work = runner.work
    fields = [work.find("field", part.field) for part in config.parts]
    regions = [work.find("region", part.region) if part.region else None for part in config.parts]
    inputs = {"field": common_source(work, fields)}
    inputs |= {f"style.{number}": field for number, field in enumerate(fields)}
    inputs |= {f"region.{number}": region for number, region in enumerate(regions) if region is not None}
    # Full names in the recipe: what was abbreviated may be ambiguous later.
    named = [
        replace(part, field=field.name, region="" if region is None else region.name)
        for part, field, region in zip(config.parts, fields, regions, strict=True)
    ]
    try:
        config = BlendConfig(tuple(map(text_of, named)))
    except ValueError as error:  # two abbreviations of the same name
        raise UsageError(str(error)) from error
    name = "+".join(dict.fromkeys(f"{part.field}.{part.region}" if part.region else part.field for part in named))
    return runner.run(blend.SPEC, blend.run, inputs, config, name, request)


def source_of(work: WorkFolder, field: Artifact, option: str) -> Artifact:
    """Return the field that `field` was made from; one that was only deformed for it is skipped.

    option: the command-line option, for the message.

    Raises:
        UsageError: it is not derived from another field.
        ArtifactStale: the field that it was made from is missing or was rebuilt since.
    """
    behind = _lineage(work, field)[1:]
    if not behind:
        raise UsageError(
            f"{option}: field {field.name} is not derived from another field; give a stylized or edited one"
        )
    return behind[0]


def common_source(work: WorkFolder, fields: list[Artifact]) -> Artifact:
    """Return the nearest field that all of `fields` are derived from, which may be one of them.

    Raises:
        UsageError: there is none.
        ArtifactStale: a field on the way to it is missing or was rebuilt since.
    """
    if len({field.digest for field in fields}) == 1:
        return source_of(work, fields[0], "--of")
    lines = [_lineage(work, field) for field in fields]
    shared = set.intersection(*({one.digest for one in line} for line in lines))
    found = next((one for one in lines[0] if one.digest in shared), None)
    if found is None:
        roots = ", ".join(f"{line[0].name} from {line[-1].name}" for line in lines)
        raise UsageError(
            f"--of: the fields are not derived from the same field ({roots}); stylize one field in all styles"
        )
    return found


def _lineage(work: WorkFolder, field: Artifact) -> list[Artifact]:
    """Return a field and those that it was made from, nearest first, without those that were only deformed."""
    line = [field]
    while any((ref.kind, ref.role) == ("field", "field") for ref in line[-1].manifest.inputs):
        line.append(input_of(work, line[-1], "field", "field"))
    return [line[0], *(one for one in line[1:] if one.manifest.stage != "deform_init")]
