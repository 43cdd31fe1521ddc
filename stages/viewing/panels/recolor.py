"""Recolor: the colors of a palette with their shares; color, weight and bias of each; saved as a field or an edit."""

import threading
from typing import Any

NONE = "(none)"


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, recolorer, runs = page.gui, page.desk.recolorer, page.desk.runs
    palette = gui.add_dropdown("Palette", [NONE, *recolorer.palettes()], initial_value=NONE)
    learn = gui.add_button("Learn a palette of the scene")
    place = gui.add_folder("Colors")
    reset = gui.add_button("Reset")
    name = gui.add_text("Name", "")
    keep = gui.add_button("Keep")
    shown = gui.add_markdown("")
    controls: list[Any] = []
    drawing, opened_here = threading.Lock(), [""]
    page.controls["palette"] = palette

    def tell() -> None:
        page.show_command(shown, lambda: recolorer.command(name.value))

    def listing() -> None:
        now = [NONE, *recolorer.palettes()]
        if tuple(palette.options) != tuple(now):
            palette.options = now
        if recolorer.palette != opened_here[-1]:  # opened elsewhere, such as by stylizing a region
            palette.value = recolorer.palette or NONE
        tell()

    def opened(event: Any) -> None:
        chosen = "" if palette.value == NONE else palette.value
        opened_here[:] = [chosen]
        if chosen != recolorer.palette:
            recolorer.open(chosen)
        draw()
        page.changed()

    def reverted(event: Any) -> None:
        recolorer.reset()
        draw()

    def draw() -> None:
        with drawing:
            for one in controls:
                one.remove()
            controls.clear()
            for swatch in recolorer.swatches():
                _color(swatch)

    def _color(swatch: Any) -> None:
        changes = recolorer.changes
        index, hint = swatch.index, f"{swatch.name}, {swatch.share:.0%} of what is shown"
        with place:
            color = gui.add_rgb(
                f"{index}: {swatch.share:.0%}", _numbers(changes.colors.get(index, swatch.now)), hint=hint
            )
            weight = gui.add_slider("weight", 0.0, 4.0, 0.05, changes.weights.get(index, 1.0))
            bias = gui.add_slider("bias", -0.5, 0.5, 0.02, changes.biases.get(index, 0.0))
        controls.extend((color, weight, bias))
        page.controls[f"color {index}"] = color
        color.on_update(page.act(lambda event: recolorer.change(index, color=_text(color.value)), tell))
        weight.on_update(page.act(lambda event: recolorer.change(index, weight=float(weight.value)), tell))
        bias.on_update(page.act(lambda event: recolorer.change(index, bias=float(bias.value)), tell))

    page.rest.append(listing)
    palette.on_update(page.act(opened))
    reset.on_click(page.act(reverted, tell))
    name.on_update(lambda event: tell())
    learn.on_click(page.act(lambda event: runs.start(recolorer.decompose_command())))
    keep.on_click(page.act(lambda event: runs.start(recolorer.command(name.value))))
    tell()


def _numbers(text: str) -> tuple[int, int, int]:
    red, green, blue = (int(text[at : at + 2], 16) for at in (1, 3, 5))
    return red, green, blue


def _text(color: tuple[int, int, int]) -> str:
    return "#" + "".join(f"{int(value):02x}" for value in color)
