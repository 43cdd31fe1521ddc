"""Look: the field, the field compared with it, the plane, the scene's cameras, saved pictures."""

from typing import Any

from schemas.atomic_write import make_folder
from schemas.images import write_png
from stages.viewing.shown import PLANES

NONE = "(none)"


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, desk, scene = page.gui, page.desk, page.desk.library.scene
    display = desk.display
    fields = desk.library.fields()
    field = gui.add_dropdown("Field", fields, initial_value=display.field)
    beside = gui.add_dropdown("Compare with", [NONE, *fields], initial_value=NONE)
    wipe = gui.add_slider("Wipe", 0.0, 1.0, 0.01, 0.5)
    plane = gui.add_dropdown("Show", PLANES, initial_value="color")
    overlay = gui.add_dropdown("Region", [NONE, *desk.library.regions(display.field)], initial_value=NONE)
    views = [view.name for view in scene.views]
    view = gui.add_dropdown("Camera", views, initial_value=views[0])
    frusta = gui.add_checkbox("Cameras in the scene", False)
    moving = gui.add_checkbox("Splats while moving", True, hint="Where the field's splats are exported")
    picture = gui.add_button("Save picture")
    html = gui.add_button("Save scene as HTML")
    shown = gui.add_markdown("")
    page.controls |= {"field": field, "beside": beside, "plane": plane}

    def tell() -> None:
        page.show_command(shown, display.render_command)

    def listing() -> None:
        now = desk.library.fields()
        if tuple(field.options) != tuple(now):
            field.options, beside.options = now, [NONE, *now]
        regions = [NONE, *desk.library.regions(display.field)]
        if tuple(overlay.options) != tuple(regions):
            overlay.options = regions
        if field.value != display.field:
            field.value = display.field
        tell()

    def chosen() -> None:
        listing()
        page.show_splats()

    page.rest.append(listing)
    moving.on_update(page.act(lambda event: page.show_splats(moving.value)))
    field.on_update(page.act(lambda event: display.look(field=field.value), chosen))
    beside.on_update(page.act(lambda event: display.look(beside="" if beside.value == NONE else beside.value)))
    wipe.on_update(page.act(lambda event: display.look(wipe=float(wipe.value))))
    plane.on_update(page.act(lambda event: display.look(plane=plane.value)))
    overlay.on_update(page.act(lambda event: display.look(overlay="" if overlay.value == NONE else overlay.value)))
    frusta.on_update(page.act(lambda event: page.show_frusta(frusta.value)))

    def saved(event: Any) -> None:
        from stages.viewing.splat_page import write_page

        splats = desk.library.splats(display.field)
        if splats is None:
            page.tell("exporting splats of the field first; when that is done, the HTML file is written")
            desk.runs.start(display.splats_command(), lambda run: saved(event) if run.code == 0 else None)
            return
        target = page.fresh_file("pages", display.field, ".html")
        write_page(splats, target, page.server.initial_camera, page.up)
        page.tell(f"saved {target}")
        event.client.send_file_download(target.name, target.read_bytes())

    html.on_click(page.act(saved))

    @view.on_update
    def _(event: Any) -> None:
        if event.client is not None:
            page.go_to(event.client, scene.cameras[views.index(view.value)].world_from_camera)

    @picture.on_click
    def _(event: Any) -> None:
        exact = desk.painter.exact(event.client.client_id)
        if exact is None:
            page.tell("the picture is not finished; wait for the camera to rest", failed=True)
        else:
            path = page.fresh_file("pictures", display.field, ".png")
            make_folder(path.parent)
            write_png(path, exact)
            event.client.send_file_download(path.name, path.read_bytes())
            page.tell(f"saved {path}")

    tell()
