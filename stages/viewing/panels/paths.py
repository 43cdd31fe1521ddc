"""Paths: keyframes, the spline through them, playback, a file for `stylerf render --path`, and its frames."""

import time
from typing import Any

import numpy as np

ORANGE = (255, 160, 0)


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, desk, path = page.gui, page.desk, page.desk.path
    put = gui.add_button("Add keyframe here")
    drop = gui.add_button("Remove last keyframe")
    between = gui.add_slider("Frames between", 1, 120, 1, path.keyframes.between)
    counted = gui.add_markdown("")
    play = gui.add_button("Play")
    name = gui.add_text("Name", "path")
    save = gui.add_button("Save")
    render = gui.add_button("Save and render")
    shown = gui.add_markdown("")
    drawn: list[Any] = []

    def tell() -> None:
        frames = path.keyframes
        counted.content = f"{len(frames.poses)} keyframes, {frames.count} frames"
        page.show_command(shown, lambda: path.command(path.file(name.value), desk.display.field))

    def draw() -> None:
        for one in drawn:
            one.remove()
        drawn.clear()
        poses = path.keyframes.poses
        if len(poses) > 1:
            at = np.linspace(0, path.keyframes.count - 1, min(path.keyframes.count, 200)).round().astype(int)
            points = np.array([path.keyframes.pose(int(frame))[:3, 3] for frame in at])
            segments = np.stack([points[:-1], points[1:]], 1)
            lines = page.server.scene.add_line_segments(
                "/path", segments, ORANGE, thickness=3.0, thickness_units="screen"
            )
            drawn.append(lines)
        tell()

    def played(event: Any) -> None:
        client = event.client
        for frame in range(path.keyframes.count):
            page.go_to(client, path.keyframes.pose(frame), path.keyframes.fov(frame))
            client.flush()
            time.sleep(1 / 24)

    def rendered(event: Any) -> None:
        desk.runs.start(path.command(path.save(name.value), desk.display.field))

    put.on_click(page.act(lambda event: path.add(page.pose_of(event.client)), draw))
    drop.on_click(page.act(lambda event: path.drop(), draw))
    between.on_update(page.act(lambda event: path.space(int(between.value)), draw))
    play.on_click(page.act(played))
    name.on_update(lambda event: tell())
    save.on_click(page.act(lambda event: page.tell(f"saved {path.save(name.value)}")))
    render.on_click(page.act(rendered))
    page.rest.append(tell)
    tell()
