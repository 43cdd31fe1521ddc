"""Local edits: region, edit dataset, learned edit, edited photos, fine-tuned field; each ensures its predecessor."""

import shlex
from dataclasses import dataclass, fields, replace
from typing import Any

from schemas.errors import UsageError
from schemas.work_folder import Artifact, WorkFolder
from stages.configs.edit import (
    DistillConfig,
    EditConfig,
    ExtractConfig,
    FinetuneConfig,
    PaletteConfig,
    RegionConfig,
    WholeEditConfig,
)
from stages.configs.select import SelectConfig
from stages.pipeline.prerequisites import (
    ensure_field,
    field_named,
    input_of,
    name_of,
    pictures_of,
    scene_of_work,
    style_file,
)
from stages.pipeline.stage_runner import Request, StageRunner


@dataclass(frozen=True)
class LocalEdit:
    """The artifacts of a whole local edit."""

    region: Artifact
    edit_dataset: Artifact
    edit: Artifact
    scene: Artifact
    field: Artifact

    def artifacts(self) -> dict[str, Artifact]:
        """Return the artifacts by kind, in the order in which they are made."""
        return {item.name.replace("_", "-"): getattr(self, item.name) for item in fields(self)}


def selected(
    runner: StageRunner, config: SelectConfig, field: Artifact | None, name: str, request: Request
) -> Artifact:
    """Select a region in `field`, in the current fit of the scene if None."""
    from stages import region_select

    config = replace(config, files_digest=region_select.digest_of_masks(config))
    if field:
        scene = pictures_of(runner.work, field)
    else:
        scene = scene_of_work(runner.work)
        field = ensure_field(runner, scene)
    inputs = {"scene": scene, "field": field}
    for operation in ("union", "subtract", "intersect"):
        for other in getattr(config, operation):
            inputs[f"{operation}.{other}"] = runner.work.find("region", other)
    return runner.run(region_select.SPEC, region_select.run, inputs, config, name, request)


def only_one(work: WorkFolder, kind: str, name: str) -> Artifact:
    """Return the region or edit called `name`, the only one if that is empty."""
    if name:
        return work.find(kind, name)
    found = work.artifacts(kind)
    if len(found) > 1:
        names = ", ".join(one.name for one in found)
        raise UsageError(f"several {kind}s found: {names}; give --{kind} NAME")
    return found[0] if found else work.get(kind, kind)


def field_of_region(work: WorkFolder, region: Artifact, name: str) -> Artifact:
    """Return the field that a region was selected in; UsageError if `name` is another field."""
    own = input_of(work, region, "field", "field")
    if name and (field := work.find("field", name)).digest != own.digest:
        command = shlex.join(["stylerf", "select", str(work.root), "--of", field.name])
        raise UsageError(
            f"--of {field.name}: region {region.name} was selected in field {own.name}; select it again: {command}"
        )
    return own


def edit_dataset(
    runner: StageRunner,
    region: Artifact,
    field: Artifact | None = None,
    config: ExtractConfig | None = None,
    request: Request | None = None,
) -> Artifact:
    """Render what the views show of a region; the dataset is named after the region.

    Args:
        field: the field to render, by default the one the region was selected in.
        config: options, by default those set for `extract`.
        request: None if the dataset is a prerequisite.
    """
    from stages import edit_dataset as stage

    if request is None and (made := runner.reusable(stage.SPEC, region)):
        return made
    work = runner.work
    inputs = {
        "scene": pictures_of(work, field) if field else input_of(work, region, "scene"),
        "field": field or input_of(work, region, "field", "field"),
        "region": region,
    }
    config = config or runner.options.config_of("extract", ExtractConfig)
    by = ("--region", region.name, "--of", inputs["field"].name)
    return runner.run(stage.SPEC, stage.run, inputs, config, region.name, request, by)


def distilled(
    runner: StageRunner, edit: Artifact, config: DistillConfig | None = None, request: Request | None = None
) -> Artifact:
    """Paint an edit into the photos; the scene is named after the edit. request: None if it is a prerequisite."""
    from stages import distill

    if request is None and (made := runner.reusable(distill.SPEC, edit)):
        return made
    work, dataset = runner.work, edit_dataset_of(runner.work, edit)
    inputs = {"scene": input_of(work, dataset, "scene"), "field": input_of(work, dataset, "field", "field")}
    inputs |= {"edit-dataset": dataset, "edit": edit}
    config = config or runner.options.config_of("distill", DistillConfig)
    return runner.run(distill.SPEC, distill.run, inputs, config, edit.name, request, by=("--edit", edit.name))


def edit_dataset_of(work: WorkFolder, edit: Artifact) -> Artifact:
    """Return the dataset that an edit was learned from, through changes of its palette."""
    while any(ref.kind == "edit" for ref in edit.manifest.inputs):
        edit = input_of(work, edit, "edit")
    return input_of(work, edit, "edit-dataset")


def finetuned(
    runner: StageRunner,
    edit: Artifact,
    field: Artifact | None,
    config: FinetuneConfig,
    request: Request,
    scene: Artifact | None = None,
) -> Artifact:
    """Train a field on an edit; the result is named after the edit.

    Args:
        field: the field to start from, by default the one the edit was extracted from.
        request: how the caller asked for the field.
        scene: the photos with the edit, made if None.

    Raises:
        UsageError: the edit was painted into pictures of another field, whose look training would restore; or the field
            is a blend.
    """
    from stages import finetune

    work, dataset = runner.work, edit_dataset_of(runner.work, edit)
    extracted = input_of(work, dataset, "field", "field")
    if field and field.digest != extracted.digest:
        _refuse_other_pictures(work, field, extracted, dataset)
    _refuse_blend(field or extracted)
    inputs = {
        "scene": scene or distilled(runner, edit),
        "field": field or extracted,
        "region": input_of(work, dataset, "region"),
    }
    return runner.run(finetune.SPEC, finetune.run, inputs, config, edit.name, request)


def _refuse_blend(field: Artifact) -> None:
    if field.manifest.stage == "blend":
        raise UsageError(
            f"field {field.name} is a blend, which cannot be trained; edit the fields it mixes, and blend those"
        )


def _refuse_other_pictures(work: WorkFolder, field: Artifact, extracted: Artifact, dataset: Artifact) -> None:
    from stages.artifacts.provenance import shows_its_pictures

    pictured = shows_its_pictures(field) and shows_its_pictures(extracted)
    if not pictured or pictures_of(work, field).digest != input_of(work, dataset, "scene").digest:
        command = shlex.join(["stylerf", "select", str(work.root), "--of", field.name])
        raise UsageError(
            f"--of {field.name}: the edit was painted into pictures of another field; to edit this one, start with "
            f"its selection: {command}"
        )


def learned_edit(
    runner: StageRunner,
    region: Artifact,
    config: EditConfig,
    changes: PaletteConfig,
    name: str,
    changed: str,
    request: Request,
    dataset: Artifact | None = None,
) -> Artifact:
    """Learn the look of a region and apply changes to its palette.

    Nothing is learned twice. Without changes, an edit of the same recipe under another name is copied (unless forced).
    With changes, the learned edit is kept under its own name, <name>-learned if `changed` replaces it.

    Args:
        config: how the look is learned; holds the digests of its files.
        changes: changes of the palette.
        name: default name of the learned edit.
        changed: default name of the edit with changes.
        request: how the caller asked for the edit.
    """
    from stages import edit_learn, edit_palette
    from stages.run.runner import announce_replacement, recipe_of

    dataset = dataset or edit_dataset(runner, region)
    inputs, spec, work = {"edit-dataset": dataset}, edit_learn.SPEC, runner.work
    name, changed = request.name or name, request.name or changed
    recipe = recipe_of(spec, inputs, config, runner.seed)

    def learned_elsewhere(own: str) -> Artifact | None:
        others = [one.name for one in work.artifacts("edit") if one.name != own]
        return next(filter(None, (work.up_to_date("edit", other, recipe) for other in others)), None)

    def copied(source: Artifact, name: str) -> Artifact:
        announce_replacement(work, spec, name, recipe, runner.progress)
        return work.copy(source, name)

    if not changes:
        present = request.force or work.up_to_date("edit", name, recipe)
        if not present and (learned := learned_elsewhere(name)):
            runner.say(f"edit {name}: copied from {learned.name}, which was learned the same way (--force relearns it)")
            return copied(learned, name)
        return runner.run(spec, edit_learn.run, inputs, config, name, request)
    learned = learned_elsewhere(changed)
    if learned is None and (own := work.up_to_date("edit", changed, recipe)):
        learned = copied(own, f"{name}-learned")
    if learned is None:
        by = ("--region", region.name)
        learned = runner.run(spec, edit_learn.run, inputs, config, f"{name}-learned", by=by)
    return runner.run(edit_palette.SPEC, edit_palette.run, {"edit": learned}, changes, changed, request)


def pinned_look(config: RegionConfig, region: str) -> tuple[RegionConfig, str]:
    """Check the style image of a region's look; return the options with digests, and a name for the edit."""
    from schemas.canonical_json import file_sha256
    from stages.artifacts.style_images import read_style_image
    from stages.weights.resolve import chosen

    if not config.style:
        return config, f"{region}-recolor"
    style = style_file(config.style)
    features: dict[str, Any] = chosen(config.features)
    config = replace(config, style=str(style.resolve()), style_digest=file_sha256(style), **features)
    read_style_image(style, config.keep_frame, crop=config.crop)
    return config, f"{region}-{name_of(style)}"


def edited(runner: StageRunner, config: WholeEditConfig, field_name: str, name: str, force: bool) -> LocalEdit:
    """Run a whole local edit; every artifact of it is called `name`.

    Args:
        config: what is selected and how it is edited.
        field_name: the field to edit, by default the current fit of the scene.
        force: rebuild what is up to date.
    """
    from stages.region_select import masks_of
    from stages.run.runner import refuse_to_replace

    request = Request(name, force)
    # Reject what cannot work before the first stage runs.
    look, _ = pinned_look(config.look, name)
    masks_of(config.selection)
    selected_in = field_named(runner, field_name) if field_name else None
    start = selected_in or ensure_field(runner, scene_of_work(runner.work))
    _refuse_blend(start)
    for kind in ("region", "edit-dataset", "edit", "scene", "field"):
        refuse_to_replace(runner.work, kind, name, [start])
    options = runner.options
    region = selected(runner, config.selection, selected_in, name, request)
    dataset = edit_dataset(runner, region, None, options.config_of("extract", ExtractConfig), request)
    edit = learned_edit(runner, region, look.learning, look.changes, name, name, request, dataset)
    scene = distilled(runner, edit, options.config_of("distill", DistillConfig), request)
    field = finetuned(runner, edit, selected_in, options.config_of("finetune", FinetuneConfig), request, scene)
    return LocalEdit(region, edit_dataset_of(runner.work, edit), edit, scene, field)
