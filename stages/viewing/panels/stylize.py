"""Stylize: a painting, cropped and zoomed; method and strokes; a run to watch, stop, resume and save."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from stages.viewing.recolorer import EDIT_MARK
from stages.viewing.styles import METHODS, Wish

SHOWN = 320  # pixels of the painting's longer side on the page
WHOLE = "(whole scene)"


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, desk, stylizer = page.gui, page.desk, page.desk.stylizer
    state: dict[str, Any] = {"image": None}
    upload = gui.add_upload_button("Choose a painting", mime_type="image/*")
    painting = gui.add_image(np.full((8, 8, 3), 40, np.uint8), label="No painting yet")
    zoom = gui.add_slider("Zoom", 1.0, 8.0, 0.1, 1.0)
    across = gui.add_slider("Across", 0.0, 1.0, 0.01, 0.5)
    down = gui.add_slider("Down", 0.0, 1.0, 0.01, 0.5)
    where = gui.add_dropdown("Where", [WHOLE, *desk.library.regions(desk.display.field)])
    method = gui.add_dropdown("Method", METHODS)
    strength = gui.add_slider("Strength", 0.1, 4.0, 0.1, 1.0)
    stroke = gui.add_slider("Stroke size", 0.25, 4.0, 0.05, 1.0)
    budget = gui.add_text("Budget", "60s", hint="Time (60s, 2m); for the whole scene also a number of style steps")
    name = gui.add_text("Name", "stylized")
    run = gui.add_button("Run")
    stop = gui.add_button("Stop")
    keep = gui.add_button("Keep as it is", hint="Ends the run and makes a field from the steps taken so far")
    shown = gui.add_markdown("")

    def part() -> np.ndarray | None:
        image = state["image"]
        if image is None:
            return None
        from stages.viewing.style_uploads import cropped  # imports torch, which must not delay the page

        return cropped(image, across.value, down.value, 1 / zoom.value)

    def draw() -> None:
        found = part()
        if found is not None:
            stride = max(1, max(found.shape[:2]) // SHOWN)
            painting.image = (found[::stride, ::stride, :3] * 255 + 0.5).astype(np.uint8)
            painting.label = f"{found.shape[1]}x{found.shape[0]} pixels of the painting"

    def wish(style: str) -> Wish:
        return Wish(
            style,
            method.value,
            "" if where.value == WHOLE else where.value,
            float(strength.value),
            float(stroke.value),
            budget.value,
            name.value,
        )

    def tell() -> None:
        page.show_command(shown, lambda: stylizer.command(wish("PAINTING.png" if part() is not None else "")))

    def listing() -> None:
        regions = [WHOLE, *desk.library.regions(desk.display.field)]
        if tuple(where.options) != tuple(regions):
            where.options = regions
        tell()

    def taken(event: Any) -> None:
        from stages.viewing.style_uploads import read_upload

        state["image"] = read_upload(upload.value.name, upload.value.content)
        draw()
        tell()

    def begun(event: Any) -> None:
        from stages.viewing.style_uploads import kept

        found = part()
        style = "" if found is None else str(kept(found, desk.library.own / "styles"))
        region = "" if where.value == WHOLE else where.value
        started = desk.runs.start(
            stylizer.command(wish(style)), partial(finished, region, name.value, desk.showing_its_field())
        )
        if name.value:
            stylizer.watch(started, name.value, region)

    def finished(region: str, edit: str, show: Callable[[Any], None], run: Any) -> None:
        if region and run.code == 0 and edit:
            desk.recolorer.open(EDIT_MARK + edit)
        elif not region:
            show(run)

    page.rest.append(listing)
    upload.on_upload(page.act(taken))
    for one in (zoom, across, down):
        one.on_update(page.act(lambda event: draw()))
    for one in (where, method, strength, stroke, budget, name):
        one.on_update(lambda event: tell())
    run.on_click(page.act(begun))
    stop.on_click(page.act(lambda event: desk.runs.stop()))
    keep.on_click(page.act(lambda event: stylizer.keep(desk.showing_its_field())))
    tell()
