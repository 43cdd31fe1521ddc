"""Local edits under faults: select a region, learn and change its look, train the field.

The region grows from the opaque pixel nearest the center of the first training view, so that no choice favors a fault.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from schemas.canonical_json import digest_of
from schemas.work_folder import Artifact
from stages import decompose, distill, edit_dataset, edit_learn, edit_palette, finetune, recolor, region_select
from stages.configs.decompose import DecomposeConfig, RecolorConfig
from stages.configs.edit import DistillConfig, EditConfig, ExtractConfig, FinetuneConfig, PaletteConfig
from stages.configs.faults import Fault, Method
from stages.configs.fit import budget_of
from stages.configs.select import SelectConfig
from stages.configs.stress import Conditions
from stages.stress.test_views import central_pixel

SPECS = (region_select.SPEC, edit_dataset.SPEC, edit_learn.SPEC, edit_palette.SPEC, distill.SPEC, finetune.SPEC,
         decompose.SPEC, recolor.SPEC)  # fmt: skip
REACH = 0.12  # relative to the distance to that camera; the colors of such small photos alone would not stop the growth
ORDINARY = "all=#2050d0"
PALETTES = {"palette-full": "all=#00ff00", "palette-black": "all=#000000"}
QUICK_RECOLOR = {"palette_steps": 80, "pruned_steps": 10}
QUICK_PAINT = {"palette_steps": 80, "style_steps": 15, "style_side": 64}
QUICK_FINETUNE, QUICK_RAYS, QUICK_REFIT, QUICK_PIXELS = "60", 2048, 60, 512
UNTIMED = "1h"  # longer than any number of steps takes
REMEDIES_OF_LEARNING = {"start": "clusters"}  # keeps palette colors from collapsing into a few
Execute = Callable[[Any, dict[str, Artifact], Any, str], Artifact]


@dataclass(frozen=True)
class EditOptions:
    """Options of an edit, except its fit. changes: of the palette, empty with a style image."""

    method: Method
    learning: EditConfig | DecomposeConfig
    changes: tuple[str, ...]
    finetune: FinetuneConfig

    def described(self) -> dict:
        """Return the options for a digest, the style image by its content, not its path."""
        learning = self.learning
        if isinstance(learning, EditConfig) and learning.style:
            learning = replace(learning, style="-")
        return {"learning": learning, "changes": self.changes, "finetune": self.finetune, "reach": REACH}


def options_of(
    method: Method, fault: Fault, remedies: bool, conditions: Conditions, style: dict[str, str] | None
) -> EditOptions:
    """Return the options of one trial. style: options naming the style image and its features, None without one."""
    quick, budget = conditions["quick"], conditions["style_budget"]
    timed = budget_of(budget)[0] > 0
    budget = QUICK_FINETUNE if quick and not timed else budget
    teaching = FinetuneConfig(budget=budget)
    teaching = replace(teaching, rays=QUICK_RAYS) if quick else teaching
    changes = () if method.edit == "paint" else (PALETTES.get(fault.name, ORDINARY),)
    if method.edit == "palette":
        learning = DecomposeConfig(budget=budget)
        learning = replace(learning, refit_steps=QUICK_REFIT, pixels=QUICK_PIXELS) if quick else learning
        return EditOptions(method, learning, changes, teaching)
    look: dict[str, Any] = {"recolor": True} if style is None else dict(style)
    look |= {"start": "random"} if fault.name == "palette-random" else {}
    look |= (QUICK_PAINT if style else QUICK_RECOLOR) if quick else {}
    look |= REMEDIES_OF_LEARNING if remedies else {}
    return EditOptions(method, EditConfig(budget=budget if timed else UNTIMED, **look), changes, teaching)


def edited(
    execute: Execute, scene: Artifact, field: Artifact, options: EditOptions, threads: int
) -> tuple[Artifact, Artifact]:
    """Run the edit; return the edited field and the region."""
    place, away = central_pixel(scene, field, threads)
    inputs = {"scene": scene, "field": field}
    selection = SelectConfig(at=(place,), reach=round(REACH * away, 4))
    region = execute(region_select, inputs, selection, f"{field.name}-part")
    name = f"{field.name}-{options.method.name}-{digest_of(options.described()['learning'])[:8]}"
    changed = f"{name}-{digest_of(options.changes)[:8]}"
    if options.method.edit == "palette":
        learned = execute(decompose, inputs, options.learning, name)
        changes = RecolorConfig(palette=options.changes, at=(place,), reach=selection.reach)
        return execute(recolor, {"scene": scene, "field": learned}, changes, changed), region
    inputs |= {"region": region}
    dataset = execute(edit_dataset, inputs, ExtractConfig(exr=False), region.name)
    edit = execute(edit_learn, {"edit-dataset": dataset}, options.learning, name)
    if options.changes:
        edit = execute(edit_palette, {"edit": edit}, PaletteConfig(palette=options.changes), changed)
    inputs = {"scene": scene, "field": field, "edit-dataset": dataset, "edit": edit}
    photos = execute(distill, inputs, DistillConfig(), edit.name)
    return execute(finetune, inputs | {"scene": photos}, options.finetune, edit.name), region
