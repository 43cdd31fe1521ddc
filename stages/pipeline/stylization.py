"""Stylize a whole scene or a region of it, or decompose a scene into a palette."""

from contextlib import suppress
from dataclasses import replace
from typing import Any

from schemas.errors import ArtifactDamaged, ArtifactStale, UsageError
from schemas.work_folder import Artifact
from stages.configs.decompose import METHOD, DecomposeConfig, PaletteFieldConfig, RecolorConfig
from stages.configs.edit import RegionConfig
from stages.configs.stylize import RefNprConfig, StylizeConfig
from stages.configs.view_syntax import file_of
from stages.pipeline.local_edit import field_of_region, learned_edit, only_one, pinned_look
from stages.pipeline.prerequisites import (
    ensure_deformed,
    ensure_field,
    name_of,
    pictures_of,
    scene_of_work,
    style_file,
    training_pictures,
)
from stages.pipeline.stage_runner import Request, StageRunner


def stylized(
    runner: StageRunner, config: StylizeConfig, field_name: str, region_name: str | None, request: Request
) -> Artifact:
    """Stylize a scene, or one region of it.

    Args:
        config: options; digests are filled in here.
        field_name: the field to stylize, by default the current fit (of a region: the field it was selected in).
        region_name: the region, the only one if empty; None for the whole scene.
        request: how the caller requested the field. Its default name is <style>-<method>.
    """
    from stages import stylize
    from stages.artifacts import style_images
    from stages.artifacts.scene import load_scene

    # Reject what cannot work before hours of prerequisites, not after them.
    config, name = _pinned(config)
    scene, more = scene_of_work(runner.work), {}
    if isinstance(config, RefNprConfig):
        style_images.check_references(load_scene(scene), config)
    if region_name is None:
        field = ensure_field(runner, scene, field_name)
    else:
        region = only_one(runner.work, "region", region_name)
        field = field_of_region(runner.work, region, field_name)
        more, name = {"region": region}, f"{region.name}-{name}"
        if config.match in ("after", "both"):
            raise UsageError(f"--match {config.match} maps every pixel; with --region, use before or none")
        if config.keep_colors:
            raise UsageError("--keep-colors maps every pixel; leave it out with --region --method refnpr")
    scene = training_pictures(runner.work, field)
    if config.method == "desrf":
        field = ensure_deformed(runner, scene, field)
    name = f"{name}-{config.method}"
    _announce_other_style(runner, "field", request.name or name, config)
    return runner.run(stylize.SPEC, stylize.run, {"scene": scene, "field": field, **more}, config, name, request)


def _pinned(config: StylizeConfig) -> tuple[StylizeConfig, str]:
    """Fill in the digests of the files that the options name, checking that they can be read; return a name too."""
    from schemas.canonical_json import file_sha256
    from stages.artifacts.style_images import digest_of, read_style_image
    from stages.weights.resolve import chosen, resolve_decoder

    pairs = [file_of(text) for text in config.references]
    files: dict[str, Any] = chosen(config.features)
    if isinstance(config, RefNprConfig):
        files["references_digest"] = digest_of(config.reference)
        files["reference"] = tuple(f"{view}={file.resolve()}" for view, file in pairs)
        files["decoder_digest"] = resolve_decoder().digest if config.reference_by == "adain" else ""
    config = replace(config, **files)
    if not config.style:
        return config, name_of(pairs[0][1])
    style = style_file(config.style)
    read_style_image(style, config.keep_frame)
    return replace(config, style=str(style.resolve()), style_digest=file_sha256(style)), name_of(style)


def region_styled(
    runner: StageRunner, config: RegionConfig, field_name: str, region_name: str, request: Request
) -> Artifact:
    """Learn the look of a region (LAENeRF): a palette to recolor with, or a style image.

    Args:
        config: options; digests are filled in here.
        field_name: empty, or the field that the region was selected in; any other is rejected.
        region_name: the region, the only one if empty.
        request: how the caller requested the edit.
    """
    region = only_one(runner.work, "region", region_name)
    if field_name:
        field_of_region(runner.work, region, field_name)
    config, name = pinned_look(config, region.name)
    if not config.changes:
        _announce_other_style(runner, "edit", request.name or name, config)
    return learned_edit(runner, region, config.learning, config.changes, name, f"{name}-changed", request)


def palette_field(runner: StageRunner, config: PaletteFieldConfig, field_name: str, request: Request) -> Artifact:
    """Decompose a field's colors into a palette (PaletteNeRF), or change the palette of a field that has one."""
    work = runner.work
    field = ensure_field(runner, scene_of_work(work), field_name)
    if field.manifest.stage not in ("decompose", "recolor"):
        return _decomposed(runner, training_pictures(work, field), field, config, request)
    if config.learning != DecomposeConfig():
        raise UsageError(f"field {field.name} already has a palette; leave out the options for learning one")
    if not config.changes:
        raise UsageError(f"field {field.name} already has a palette; change it with --palette I=#rrggbb")
    return _recolored(runner, pictures_of(work, field), field, config.changes, request)


def _decomposed(
    runner: StageRunner, scene: Artifact, field: Artifact, config: PaletteFieldConfig, request: Request
) -> Artifact:
    """Learn a palette, <field>-palettenerf; with changes, <field>-recolored.

    The learned field is kept under its own name, so that other changes need no training.
    """
    from stages import decompose
    from stages.run.runner import refuse_to_replace

    inputs, name = {"scene": scene, "field": field}, f"{field.name}-palettenerf"
    if not config.changes:
        return runner.run(decompose.SPEC, decompose.run, inputs, config.learning, name, request)
    if request.name:  # reject before the palette is learned, not after
        refuse_to_replace(runner.work, "field", request.name, [field])
    by = ("--method", METHOD, "--of", field.name)
    learned = runner.run(decompose.SPEC, decompose.run, inputs, config.learning, name, by=by)
    return _recolored(runner, scene, learned, config.changes, request)


def _recolored(
    runner: StageRunner, scene: Artifact, field: Artifact, changes: RecolorConfig, request: Request
) -> Artifact:
    from stages import recolor

    inputs = {"scene": scene, "field": field}
    return runner.run(recolor.SPEC, recolor.run, inputs, changes, f"{field.name}-recolored", request)


def _announce_other_style(runner: StageRunner, kind: str, name: str, config: StylizeConfig | RegionConfig) -> None:
    """Report if the artifact about to be replaced was made with a different style image."""
    existing = next((one for one in runner.work.artifacts(kind) if one.name == name), None)
    if existing is None:
        return
    with suppress(ArtifactDamaged, ArtifactStale):  # losing an unreadable one does not matter
        before = existing.manifest.config
        pairs = [(before.get(key), getattr(config, key, "")) for key in ("style_digest", "references_digest")]
        if any(old and old != new for old, new in pairs):
            runner.say(f"{kind} {name} was made with another style image and will be replaced; --name NAME keeps both")
