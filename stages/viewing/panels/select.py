"""Select: seeds by clicks and strokes, a box, growing, other regions; saved as a region."""

from typing import Any

from stages.viewing.selection import MOST_STEPS
from stages.viewing.strokes import Place, Strokes, seeds_along

MODES = ("look", "click", "erase", "box")
HOW = ("union", "subtract", "intersect")


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, desk, scene = page.gui, page.desk, page.server.scene
    selector = desk.selector
    mode = gui.add_dropdown("Pointer", MODES, initial_value="look")
    page.controls["pointer"] = mode
    gui.add_markdown("*click*: add and grow. *erase*: exclude. Drag with Shift: a stroke, or in *box* mode a box.")
    start = selector.history.now
    tolerance = gui.add_slider("Color tolerance", 0.0, 60.0, 1.0, start.tolerance)
    page.controls["tolerance"] = tolerance
    steps = gui.add_slider("Growing steps", 0, MOST_STEPS, 1, start.steps)
    cells = gui.add_number("Cells per step", start.iterations, min=1, max=10_000_000, step=1000)
    with gui.add_folder("With other regions", expand_by_default=False):
        other = gui.add_dropdown("Region", ["(none)", *desk.library.regions(desk.display.field)])
        how = gui.add_dropdown("Do", HOW)
        combine = gui.add_button("Combine")
    undo = gui.add_button("Undo")
    clear = gui.add_button("Clear")
    name = gui.add_text("Name", "region")
    keep = gui.add_button("Keep region")
    counted = gui.add_markdown("")
    shown = gui.add_markdown("")

    def tell() -> None:
        counted.content = f"{selector.cells} cells selected" if selector.history.now else "nothing is selected"
        page.show_command(shown, lambda: selector.command(name.value))

    def again(action: Any) -> Any:
        return page.act(action, tell)

    def listing() -> None:
        regions = ["(none)", *desk.library.regions(desk.display.field)]
        if tuple(other.options) != tuple(regions):
            other.options = regions
        now = selector.history.now
        if steps.value != now.steps:
            steps.value = now.steps
        tell()

    def clicked(event: Any) -> None:
        if mode.value in ("click", "erase"):
            selector.click(page.pose_of(event.client), *event.screen_pos, avoid=mode.value == "erase")

    def stroked(client: Any, way: list[Place]) -> None:
        pose = page.pose_of(client)
        selector.scribble(pose, seeds_along(way, pose.aspect), avoid=mode.value == "erase")

    def boxed(event: Any) -> None:
        selector.box(page.pose_of(event.client), event.screen_min, event.screen_max)

    strokes = Strokes(page, lambda client, way: again(lambda event: stroked(client, way))(None))
    box = again(boxed)

    def switched(event: Any) -> None:
        strokes.take(mode.value in ("click", "erase"))
        scene.remove_rect_select_callback(box)
        if mode.value == "box":
            scene.on_rect_select(modifier="shift")(box)

    def combined(event: Any) -> None:
        if other.value != "(none)":
            selector.change(**{how.value: (*getattr(selector.history.now, how.value), other.value)})

    def undone(event: Any) -> None:
        selector.undo()
        listing()

    page.rest.append(listing)
    scene.on_click()(again(clicked))
    mode.on_update(switched)
    tolerance.on_update(again(lambda event: selector.change(tolerance=float(tolerance.value))))
    steps.on_update(again(lambda event: selector.change(steps=int(steps.value))))
    cells.on_update(again(lambda event: selector.change(iterations=int(cells.value))))
    combine.on_click(again(combined))
    undo.on_click(again(undone))
    clear.on_click(again(lambda event: selector.clear()))
    name.on_update(lambda event: tell())
    keep.on_click(again(lambda event: desk.runs.start(selector.command(name.value))))
    tell()
