"""What a local edit is made of, from region to taught field: each step brings the one before it up to date."""

import shlex
from typing import Any

from schemas.errors import UsageError
from schemas.work_folder import Artifact
from stages.configs.distill import DistillConfig
from stages.configs.extract import ExtractConfig
from stages.pipeline.distributed import agreed
from stages.pipeline.prerequisites import input_of, made_from, pictures_of


def region_of(session: Any, name: str) -> Artifact:
    """The region of that name, or the only one there is."""
    if name:
        return session.work.find("region", name)
    regions = session.work.artifacts("region")
    if len(regions) > 1:
        raise UsageError(f"there are several regions: {', '.join(one.name for one in regions)}; give --region NAME")
    return regions[0] if regions else session.work.get("region", "region")


def standing(session: Any, spec: Any, source: Artifact) -> Artifact | None:
    """What an earlier command made of `source` by options of its own, which stay unless a table of --config says other.

    None where this command does that stage itself, and where what was made is gone or out of date.
    """
    if spec.verb in session.own_verbs or session.options.table(spec.verb):
        return None

    def in_date() -> Artifact | None:
        made = made_from(session, spec.writes, spec.stage, source)
        return None if made is None or session.work.outdated(made) else made

    return agreed(session, spec.writes, in_date)


def ensure_edit_dataset(session: Any, region: Artifact, field: Artifact | None, config: Any = None) -> Artifact:
    """What the views show of a region, named as the region is; `field`: other than the one it was selected in."""
    from stages import edit_dataset

    if made := standing(session, edit_dataset.SPEC, region):
        return made
    inputs = {
        "scene": pictures_of(session, field) if field else input_of(session, region, "scene"),
        "field": field or input_of(session, region, "field", "field"),
        "region": region,
    }
    config = config or session.config_of("extract", ExtractConfig)
    by = ("--region", region.name, "--of", inputs["field"].name)
    return session.run(edit_dataset.SPEC, edit_dataset.run, inputs, config, region.name, by=by)


def ensure_distilled(session: Any, edit: Artifact, config: Any = None) -> Artifact:
    """The photos with an edit painted into them, a scene named as the edit is."""
    from stages import distill

    if made := standing(session, distill.SPEC, edit):
        return made
    dataset = edit_dataset_of(session, edit)
    inputs = {"scene": input_of(session, dataset, "scene"), "field": input_of(session, dataset, "field", "field")}
    inputs |= {"edit-dataset": dataset, "edit": edit}
    config = config or session.config_of("distill", DistillConfig)
    return session.run(distill.SPEC, distill.run, inputs, config, edit.name, by=("--edit", edit.name))


def edit_dataset_of(session: Any, edit: Artifact) -> Artifact:
    """The edit dataset that an edit was learned from, through changes of its palette."""
    while any(ref.kind == "edit" for ref in edit.manifest.inputs):
        edit = input_of(session, edit, "edit")
    return input_of(session, edit, "edit-dataset")


def edit_of(session: Any, name: str) -> Artifact:
    """The edit of that name, or the only one there is."""
    if name:
        return session.work.find("edit", name)
    edits = session.work.artifacts("edit")
    if len(edits) > 1:
        raise UsageError(f"there are several edits: {', '.join(one.name for one in edits)}; give --edit NAME")
    return edits[0] if edits else session.work.get("edit", "edit")


def finetuned(session: Any, edit: Artifact, field: Artifact | None, config: Any) -> Artifact:
    """The field that has learned an edit, named as the edit is. field: another than the one that was looked at."""
    from stages import finetune

    dataset = edit_dataset_of(session, edit)
    looked_at = input_of(session, dataset, "field", "field")
    if field and field.digest != looked_at.digest:
        _refuse_other_pictures(session, field, looked_at, dataset)
    field = field or looked_at
    inputs = {"scene": ensure_distilled(session, edit), "field": field, "region": input_of(session, dataset, "region")}
    return session.run(finetune.SPEC, finetune.run, inputs, config, edit.name)


def _refuse_other_pictures(session: Any, field: Artifact, looked_at: Artifact, dataset: Artifact) -> None:
    """UsageError where a field does not look as the pictures do that the edit was painted into: it would be lost."""
    from stages.artifacts.provenance import shows_its_pictures

    pictured = shows_its_pictures(field) and shows_its_pictures(looked_at)
    if not pictured or pictures_of(session, field).digest != input_of(session, dataset, "scene").digest:
        anew = shlex.join(["stylerf", "select", str(session.work.root), "--of", field.name])
        raise UsageError(
            f"--of {field.name}: the edit was painted into pictures that show another field; edit that one anew, from "
            f"its selection on: {anew}"
        )


def learned_edit(session: Any, region: Artifact, config: Any, changes: Any, name: str, changed: str) -> Artifact:
    """An edit of a region: learned, and with changes of its palette, then called `changed`, where any are asked for.

    Nothing is learned again where any edit stands that was learned just so: without changes it is copied, unless
    --force is given; with changes, one that `changed` takes the place of stays beside as <name>-learned. Else it is
    learned, with changes called so.
    """
    from stages import edit_learn, edit_palette
    from stages.run.runner import recipe_of, tell_replaced

    dataset = ensure_edit_dataset(session, region, None)
    inputs = {"edit-dataset": dataset}
    spec, name, changed = edit_learn.SPEC, session.name or name, session.name or changed
    recipe = recipe_of(spec, inputs, config, session.context.seed)

    def standing_beside(own: str) -> Artifact | None:
        others = [one.name for one in session.work.artifacts("edit") if one.name != own]
        return next(filter(None, (session.work.up_to_date("edit", other, recipe) for other in others)), None)

    def copied(source: Artifact, name: str) -> Artifact:
        tell_replaced(session.work, spec, name, recipe, session.context)
        return session.work.copy(source, name)

    if not changes:
        known = session.force or session.work.up_to_date("edit", name, recipe)
        learned = None if known else standing_beside(name)
        if learned:
            session.say(f"edit {name}: as {learned.name}, learned just so before (--force learns it anew)")
            return copied(learned, name)
        return session.run(spec, edit_learn.run, inputs, config, name)
    learned = standing_beside(changed)
    if learned is None and (own := session.work.up_to_date("edit", changed, recipe)):
        learned = copied(own, f"{name}-learned")
    if learned is None:
        by = ("--region", region.name)
        learned = session.run(spec, edit_learn.run, inputs, config, f"{name}-learned", own=False, by=by)
    return session.run(edit_palette.SPEC, edit_palette.run, {"edit": learned}, changes, changed)
