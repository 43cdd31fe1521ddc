"""Region: the stages that bring a region's edit into a field, one by one, and a field's deformation."""

from collections.abc import Callable
from typing import Any

from stages.viewing.edit_stages import deform_command, distill_command, extract_command, finetune_command

NONE = "(none)"


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, desk = page.gui, page.desk
    work = desk.library.work.root
    region = gui.add_dropdown("Region", [NONE, *desk.library.regions(desk.display.field)])
    edit = gui.add_dropdown("Edit", [NONE, *desk.library.all_edits()])
    seconds = gui.add_number("Seconds", 30, min=5, max=86_400, step=5)
    page.controls["seconds"] = seconds

    def chosen(control: Any) -> str:
        return "" if control.value == NONE else control.value

    stages: list[tuple[str, str, Callable[[], list[str]]]] = [
        ("1. Extract", "Renders what the views show of the region", lambda: extract_command(work, chosen(region))),
        ("3. Distill", "Paints the edit into the photos", lambda: distill_command(work, chosen(edit))),
        ("4. Fine-tune", "Trains a field on them", lambda: finetune_command(work, chosen(edit), int(seconds.value))),
        ("Deform the field", "So that desrf can bend its shapes", lambda: deform_command(work, desk.display.field)),
    ]
    shown = []
    for title, hint, made in stages:
        if title.startswith("3"):
            gui.add_markdown("2. Stylize or recolor the region: *Stylize* and *Recolor* show it while it is learned.")
        button = gui.add_button(title, hint=hint)
        shown.append((gui.add_markdown(""), made))
        button.on_click(page.act(lambda event, made=made: desk.runs.start(made(), desk.showing_its_field())))

    def tell() -> None:
        for handle, made in shown:
            page.show_command(handle, made)

    def listing() -> None:
        for control, now in ((region, desk.library.regions(desk.display.field)), (edit, desk.library.all_edits())):
            options = [NONE, *now]
            if tuple(control.options) != tuple(options):
                before = set(control.options)
                control.options = options
                if fresh := [one for one in now if one not in before]:
                    control.value = fresh[0]
        tell()

    page.rest.append(listing)
    for control in (region, edit, seconds):
        control.on_update(lambda event: tell())
    tell()
