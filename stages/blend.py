"""Blend: a field that mixes fields derived from one field, by weight and by region. Nothing is trained."""

from schemas.errors import BadInput
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.field import load_field, save_field
from stages.artifacts.region import region_of_field
from stages.configs.blend import BlendConfig
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.errors import InvalidValue
from stylerf.fields.blending import Style, blended
from stylerf.fields.radiance_field import layers_of

SPEC = Spec(stage="blend", verb="blend", revision=1, writes="field")


def run(inputs: dict[str, Artifact], config: BlendConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the blended field; return its figures.

    inputs: the source as `field`; the fields as `style.0`, ..., and their regions as `region.0`, ..., by their number
    in config.parts.
    """
    source, background = load_field(inputs["field"])
    styles = []
    for number, part in enumerate(config.parts):
        artifact, region = inputs[f"style.{number}"], inputs.get(f"region.{number}")
        field, _ = load_field(artifact)
        within = None if region is None else region_of_field(region, artifact, field).edit
        styles.append(Style(f"field {artifact.name}", field, part.weight or 0.0, within))
    try:
        field = blended(source, styles)
    except InvalidValue as error:
        raise BadInput(f"{inputs['field'].path}: {error}") from error
    save_field(partial.path, field, background)
    rest = 1 - sum(style.weight for style in styles if style.within is None)
    return {
        "source": inputs["field"].name,
        "source_weight": round(max(rest, 0.0), 6),
        "layers": len(layers_of(field.color)),
        "displaced": field.displacement is not None,
        "parameters": field.parameters,
    }
