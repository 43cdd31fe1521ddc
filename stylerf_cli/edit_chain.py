"""What a local edit is made of, from region to taught field: each step brings the one before it up to date."""

from typing import Any

from schemas.errors import ArtefactStale, UsageError
from schemas.store import Artefact
from stages.configs.distill import DistillConfig
from stages.configs.extract import ExtractConfig
from stylerf_cli.chains import made_from, scene_of_work


def scene_behind(session: Any, field: Artefact) -> Artefact:
    """The scene whose photos a field was last taught with: edits of edits see the edits before them."""
    if any(ref.kind == "scene" for ref in field.manifest.inputs):
        return input_of(session, field, "scene")
    return scene_of_work(session)


def region_of(session: Any, name: str) -> Artefact:
    """The region of that name, or the only one there is."""
    if name:
        return session.work.find("region", name)
    regions = session.work.artefacts("region")
    if len(regions) > 1:
        raise UsageError(f"there are several regions: {', '.join(one.name for one in regions)}; give --region NAME")
    return regions[0] if regions else session.work.get("region", "region")


def input_of(session: Any, artefact: Artefact, kind: str, role: str = "") -> Artefact:
    """What an artefact was made from, of one kind (and role); ArtefactStale where it is gone or was made anew."""
    for ref in artefact.manifest.inputs:
        if ref.kind == kind and role in ("", ref.role):
            found = session.work.get(kind, ref.name)
            if found.digest != ref.digest:
                raise ArtefactStale(
                    f"{kind} {ref.name} was made anew after {artefact.kind} {artefact.name}; make that again too: "
                    f"{artefact.remade_by()}"
                )
            return found
    raise ArtefactStale(f"{artefact.kind} {artefact.name} names no {kind} it was made from; make it again")


def standing(session: Any, spec: Any, source: Artefact) -> Artefact | None:
    """What an earlier command made of `source` by options of its own, which stay unless a table of --config says other.

    None where this command does that stage itself, and where what was made is gone or out of date.
    """
    if spec.verb in session.own_verbs or session.options.table(spec.verb):
        return None
    made = made_from(session, spec.writes, spec.stage, source)
    return None if made is None or session.work.outdated(made) else made


def ensure_edit_dataset(session: Any, region: Artefact, field: Artefact | None, config: Any = None) -> Artefact:
    """What the views show of a region, named as the region is; `field`: other than the one it was selected in."""
    from stages import edit_dataset

    if made := standing(session, edit_dataset.SPEC, region):
        return made
    inputs = {
        "scene": scene_behind(session, field) if field else input_of(session, region, "scene"),
        "field": field or input_of(session, region, "field", "field"),
        "region": region,
    }
    config = config or session.config_of("extract", ExtractConfig)
    by = ("--region", region.name, "--of", inputs["field"].name)
    return session.run(edit_dataset.SPEC, edit_dataset.run, inputs, config, region.name, by=by)


def ensure_distilled(session: Any, edit: Artefact, config: Any = None) -> Artefact:
    """The photos with an edit painted into them, a scene named as the edit is."""
    from stages import distill

    if made := standing(session, distill.SPEC, edit):
        return made
    dataset = edit_dataset_of(session, edit)
    inputs = {"scene": input_of(session, dataset, "scene"), "edit-dataset": dataset, "edit": edit}
    config = config or session.config_of("distill", DistillConfig)
    return session.run(distill.SPEC, distill.run, inputs, config, edit.name, by=("--edit", edit.name))


def edit_dataset_of(session: Any, edit: Artefact) -> Artefact:
    """The edit dataset that an edit was learnt from, through changes of its palette."""
    while any(ref.kind == "edit" for ref in edit.manifest.inputs):
        edit = input_of(session, edit, "edit")
    return input_of(session, edit, "edit-dataset")


def edit_of(session: Any, name: str) -> Artefact:
    """The edit of that name, or the only one there is."""
    if name:
        return session.work.find("edit", name)
    edits = session.work.artefacts("edit")
    if len(edits) > 1:
        raise UsageError(f"there are several edits: {', '.join(one.name for one in edits)}; give --edit NAME")
    return edits[0] if edits else session.work.get("edit", "edit")


def finetuned(session: Any, edit: Artefact, field: Artefact | None, config: Any) -> Artefact:
    """The field that has learnt an edit, named as the edit is. field: another than the one that was looked at."""
    from stages import finetune

    dataset = edit_dataset_of(session, edit)
    field = field or input_of(session, dataset, "field", "field")
    inputs = {"scene": ensure_distilled(session, edit), "field": field, "region": input_of(session, dataset, "region")}
    return session.run(finetune.SPEC, finetune.run, inputs, config, edit.name)


def learnt_edit(session: Any, region: Artefact, config: Any, changes: Any, name: str, changed: str) -> Artefact:
    """An edit of a region: learnt, and with changes of its palette, then called `changed`, where any are asked for.

    Changes need no training where any edit stands that was learnt just so; else it is learnt, as <name>-learnt.
    """
    from stages import edit_learn, edit_palette
    from stages.runner import recipe_of

    dataset = ensure_edit_dataset(session, region, None)
    inputs = {"edit-dataset": dataset}
    if not changes:
        return session.run(edit_learn.SPEC, edit_learn.run, inputs, config, name)
    name, changed = session.name or name, session.name or changed
    recipe = recipe_of(edit_learn.SPEC, inputs, config, session.context.seed)
    others = [one.name for one in session.work.artefacts("edit") if one.name != changed]
    found = (session.work.standing("edit", other, recipe) for other in others)
    learnt = next(filter(None, found), None)
    if learnt is None:
        by = ("--region", region.name)
        learnt = session.run(edit_learn.SPEC, edit_learn.run, inputs, config, f"{name}-learnt", own=False, by=by)
    return session.run(edit_palette.SPEC, edit_palette.run, {"edit": learnt}, changes, changed)
