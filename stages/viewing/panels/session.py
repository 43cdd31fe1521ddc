"""Session: the run in progress, every command so far, and all of them as a shell script."""

from typing import Any

from schemas.atomic_write import make_folder, write_bytes
from stages.viewing.commands import as_text


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, desk = page.gui, page.desk
    stop = gui.add_button("Stop the run")
    again = gui.add_button("Resume the run")
    save = gui.add_button("Save as shell script")
    listed = gui.add_markdown("")
    said = gui.add_markdown("")

    def listing() -> None:
        lines = [as_text(one) for one in desk.commands]
        listed.content = "```sh\n" + "\n".join(lines) + "\n```" if lines else "no command has run yet"
        run = desk.run
        said.content = "```text\n" + "\n".join(list(run.lines)[-12:]).replace("```", "") + "\n```" if run else ""

    def resumed(event: Any) -> None:
        if desk.run is not None:
            desk.start(desk.run.arguments)

    def saved(event: Any) -> None:
        path = page.fresh_file("scripts", "session", ".sh")
        make_folder(path.parent)
        write_bytes(path, desk.script().encode())
        event.client.send_file_download(path.name, desk.script().encode())
        page.tell(f"saved {path}")

    stop.on_click(page.act(lambda event: desk.stop()))
    again.on_click(page.act(resumed))
    save.on_click(page.act(saved))
    page.rest.append(listing)
    listing()
