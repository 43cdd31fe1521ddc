"""Paths: keyframes, the spline through them, play, a file that `stylerf render --path` takes, and its frames."""

import time
from typing import Any

import numpy as np

ORANGE = (255, 160, 0)


def add(page: Any) -> None:
    """Add the panel's controls."""
    gui, desk = page.gui, page.desk
    put = gui.add_button("Add keyframe here")
    drop = gui.add_button("Remove last keyframe")
    between = gui.add_slider("Frames between", 1, 120, 1, desk.keyframes.between)
    counted = gui.add_markdown("")
    play = gui.add_button("Play")
    name = gui.add_text("Name", "path")
    save = gui.add_button("Save")
    render = gui.add_button("Save and render")
    shown = gui.add_markdown("")
    drawn: list[Any] = []

    def file() -> Any:
        return desk.library.own / "paths" / f"{name.value}.json"

    def tell() -> None:
        frames = desk.keyframes
        counted.content = f"{len(frames.poses)} keyframes, {frames.count} frames"
        page.show_command(shown, lambda: desk.path_command(file()))

    def draw() -> None:
        for one in drawn:
            one.remove()
        drawn.clear()
        poses = desk.keyframes.poses
        if len(poses) > 1:
            at = np.linspace(0, desk.keyframes.count - 1, min(desk.keyframes.count, 200)).round().astype(int)
            points = np.array([desk.keyframes.pose(int(frame))[:3, 3] for frame in at])
            segments = np.stack([points[:-1], points[1:]], 1)
            lines = page.server.scene.add_line_segments(
                "/path", segments, ORANGE, thickness=3.0, thickness_units="screen"
            )
            drawn.append(lines)
        tell()

    def played(event: Any) -> None:
        client = event.client
        for frame in range(desk.keyframes.count):
            page.go_to(client, desk.keyframes.pose(frame), desk.keyframes.fov(frame))
            client.flush()
            time.sleep(1 / 24)

    def rendered(event: Any) -> None:
        desk.start(desk.path_command(desk.save_path(name.value)))

    put.on_click(page.act(lambda event: desk.add_keyframe(page.pose_of(event.client)), draw))
    drop.on_click(page.act(lambda event: desk.set_keyframes(poses=desk.keyframes.poses[:-1]), draw))
    between.on_update(page.act(lambda event: desk.set_keyframes(between=int(between.value)), draw))
    play.on_click(page.act(played))
    name.on_update(lambda event: tell())
    save.on_click(page.act(lambda event: page.tell(f"saved {desk.save_path(name.value)}")))
    render.on_click(page.act(rendered))
    page.rest.append(tell)
    tell()
