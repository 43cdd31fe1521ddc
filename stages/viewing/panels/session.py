"""Session: the run in progress, every command so far, and all of them as a shell script."""

from typing import Any

from schemas.atomic_write import make_folder, write_bytes
from stages.viewing.commands import COMMAND_WIDTH, fenced, wrapped


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, runs = page.gui, page.desk.runs
    stop = gui.add_button("Stop the run")
    again = gui.add_button("Resume the run")
    save = gui.add_button("Save as shell script")
    listed = gui.add_markdown("")
    said = gui.add_markdown("")

    def listing() -> None:
        lines = [wrapped(runs.whole(one), COMMAND_WIDTH) for one in runs.commands]
        listed.content = fenced("sh", "\n".join(lines)) if lines else "no command has run yet"
        run = runs.present
        said.content = fenced("text", page.within("\n".join(list(run.lines)[-12:]))) if run else ""

    def resumed(event: Any) -> None:
        if runs.present is not None:
            runs.start(runs.present.arguments)

    def saved(event: Any) -> None:
        path = page.fresh_file("scripts", "session", ".sh")
        make_folder(path.parent)
        write_bytes(path, runs.script().encode())
        event.client.send_file_download(path.name, runs.script().encode())
        page.tell(f"saved {path}")

    stop.on_click(page.act(lambda event: runs.stop()))
    again.on_click(page.act(resumed))
    save.on_click(page.act(saved))
    page.rest.append(listing)
    listing()
