"""The page: browser panels around a Desk. This module deals with viser; the desk does the work."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import StylerfError, one_line
from stages.artifacts.camera_shots import focus_depth
from stages.viewing.cameras import Pose, level_up
from stages.viewing.commands import COMMAND_WIDTH, fenced, wrapped
from stages.viewing.desk import Desk
from stages.viewing.moving_splats import MovingSplats
from stages.viewing.panels import look, paths, recolor, region, select, session, stylize
from stylerf.errors import InvalidValue
from stylerf.geometry.camera_paths import average_up, looked_at

MOST_FRUSTA = 60
THUMBNAIL = 96  # pixels of its longer side
SETTLED_SECONDS = 3.0  # after which a page has applied the camera that it was given
JPEG_MOVING, JPEG_EXACT = 70, 92


class Page:
    """The page of one viewer.

    Attributes:
        desk: The viewer's state.
        server: viser's.
        gui: Where panels add their controls.
    """

    def __init__(self, server: Any, desk: Desk) -> None:
        self.server, self.desk, self.gui = server, desk, server.gui
        self.controls: dict[str, Any] = {}  # by name, for tests
        self.rest: list[Callable[[], None]] = []  # called when lists of fields, regions or runs may have changed
        self._frusta: list[Any] = []
        self._complaint = ""  # shown last, so that it is not shown again with each line of a run
        self._splats: dict[int, MovingSplats] = {}
        server.gui.configure_theme(
            control_width="large",
            show_logo=False,
            show_share_button=False,
            dark_mode=True,
        )
        server.gui.main_panel.dock_right()
        server.gui.set_panel_label(f"stylerf {desk.library.work.root.resolve().name}")
        self._aim()
        self.status = self.gui.add_markdown("")
        tabs = self.gui.add_tab_group()
        for title, panel in (
            ("Look", look), ("Select", select), ("Recolor", recolor),
            ("Stylize", stylize), ("Region", region), ("Paths", paths), ("Session", session),
        ):  # fmt: skip
            with tabs.add_tab(title):
                panel.add(self)
        server.on_client_connect(self._opened)
        server.on_client_disconnect(self._closed)

    def _aim(self) -> None:
        """Set the initial camera of a page: the first training view, orbiting what the cameras look at."""
        scene = self.desk.library.scene
        cameras = [scene.cameras[i] for i in scene.splits["train"]] or scene.cameras
        first = cameras[0]
        ahead = float((looked_at(cameras, focus_depth(scene)) - first.center) @ first.forward)
        away = ahead if ahead > 0 else 1.0
        self.up = average_up(cameras)
        self.server.scene.set_up_direction(tuple(self.up.tolist()))
        start = self.server.initial_camera
        start.position = first.center
        start.look_at = first.center + first.forward * away
        start.up = level_up(self.up, first.world_from_camera)
        start.fov = 2 * float(np.arctan(first.height / 2 / first.fy))
        self.away, self._first = away, first

    def _start_pose(self, aspect: float) -> Pose:
        """Return the initial pose of a page."""
        return replace(Pose.of(self._first, aspect), fov=float(self.server.initial_camera.fov))

    # -- for the panels ------------------------------------------------------------------------------------------------

    def act(self, action: Callable[..., object], then: Callable[[], object] = lambda: None) -> Callable[[Any], None]:
        """Return a callback that runs `action` with the event, always runs `then` afterwards, and shows errors."""

        def do(event: Any) -> None:
            try:
                action(event)
            except (StylerfError, InvalidValue, ValueError) as error:
                self.tell(str(error), failed=True)
            finally:
                then()

        return do

    def tell(self, text: str, failed: bool = False) -> None:
        """Show a note on every page."""
        for client in self.server.get_clients().values():
            client.add_notification(
                "Not possible" if failed else "Note", text, auto_close_seconds=8.0, color="red" if failed else "blue"
            )

    def pose_of(self, client: Any) -> Pose:
        """Return the pose of a page's camera."""
        camera = client.camera
        (w, x, y, z), (px, py, pz) = camera.wxyz.tolist(), camera.position.tolist()
        return Pose((w, x, y, z), (px, py, pz), float(camera.fov), float(camera.aspect))

    def go_to(self, client: Any, pose: np.ndarray, fov: float | None = None) -> None:
        """Move a page's camera to world_from_camera [4, 4]."""
        from scipy.spatial.transform import Rotation

        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        with client.atomic():
            client.camera.wxyz = np.array([w, x, y, z])
            client.camera.position = pose[:3, 3]
            client.camera.look_at = pose[:3, 3] + pose[:3, 2] * self.away
            client.camera.up_direction = level_up(self.up, pose)
            if fov is not None:
                client.camera.fov = fov

    def show_command(self, handle: Any, make: Callable[[], list[str]]) -> None:
        """Show the command of an action, or why there is none."""
        try:
            handle.content = fenced("sh", wrapped(self.desk.runs.whole(make()), COMMAND_WIDTH))
        except (StylerfError, ValueError) as error:
            handle.content = f"*{_plain(str(error))}*"

    def changed(self) -> None:
        """Bring lists and progress up to date."""
        run = self.desk.runs.present
        if run is None:
            self.status.content = ""
        else:
            state = "runs" if run.code is None else "done" if run.code == 0 else f"ended with code {run.code}"
            self.status.content = f"**{run.arguments[0]}** {state}: `{_plain(self.within(run.last))[:160]}`"
        for one in self.rest:
            try:
                one()
            except Exception as error:  # such as of a damaged artifact: the other lists are still updated
                if (complaint := one_line(error)) != self._complaint:
                    self._complaint = complaint
                    self.tell(complaint, failed=True)
        if run is not None and run.code is not None:
            self.show_splats()

    def within(self, text: str) -> str:
        """Return text with paths in the work folder relative to it."""
        root = self.desk.library.work.root
        return text.replace(f"{root.resolve()}/", "").replace(f"{root}/", "")

    # -- pages that come and go ----------------------------------------------------------------------------------------

    def _opened(self, client: Any) -> None:
        desk, page = self.desk, client.client_id
        self._splats[page] = splats = MovingSplats(client, desk.display)
        if len(self.server.get_clients()) > 1:
            self.tell("another page of this viewer is open; both show and change the same state")

        def send(picture: np.ndarray, exact: bool, stride: int) -> None:
            if page not in self.server.get_clients():
                return  # closed while this was painted
            if splats.shown and not exact:
                return  # they are better than a picture with only part of the pixels
            quality = JPEG_EXACT if exact else JPEG_MOVING
            with client.atomic():
                client.scene.set_background_image(picture, format="jpeg", jpeg_quality=quality)
                splats.end()
            client.flush()

        desk.painter.open(page, send)
        desk.display.refresh()

        # A new page first reports viser's own camera, then ours; a reconnecting page only its own. A picture of ours is
        # ready before it does.
        opening, settled = self.pose_of(client), threading.Event()
        if opening.sound():
            desk.painter.move(page, self._start_pose(opening.aspect))

        @client.camera.on_update
        def _(camera: Any) -> None:
            pose = self.pose_of(client)
            if pose.sound() and (settled.is_set() or pose != opening):
                moved = settled.is_set()
                settled.set()
                desk.painter.move(page, pose, moved and splats.begin())

        def settle() -> None:
            if not settled.is_set() and opening.sound():
                settled.set()
                desk.painter.move(page, self.pose_of(client))

        desk.preparation.start()
        threading.Thread(target=splats.load, name="splats", daemon=True).start()
        timer = threading.Timer(SETTLED_SECONDS, settle)
        timer.daemon = True
        timer.start()

    def _closed(self, client: Any) -> None:
        self.desk.painter.close(client.client_id)
        self._splats.pop(client.client_id, None)

    def show_splats(self, wanted: bool | None = None) -> None:
        """Update the splats of every page.

        Args:
            wanted: whether they are shown while the camera moves; None: unchanged.
        """
        for one in list(self._splats.values()):
            one.wanted = one.wanted if wanted is None else wanted
            threading.Thread(target=one.load, name="splats", daemon=True).start()

    def show_frusta(self, visible: bool) -> None:
        """Show or hide the scene's cameras with their photos; a click on one goes there."""
        if visible and not self._frusta:
            self._add_frusta()
        for one in self._frusta:
            one.visible = visible

    def _add_frusta(self) -> None:
        from scipy.spatial.transform import Rotation

        scene = self.desk.library.scene
        chosen = np.unique(np.linspace(0, len(scene.cameras) - 1, min(len(scene.cameras), MOST_FRUSTA)).round())
        size = 0.05 * self.away
        for index in map(int, chosen):
            camera = scene.cameras[index]
            stride = max(1, max(camera.width, camera.height) // THUMBNAIL)
            photo = (scene.images(index)[::stride, ::stride, :3] * 255 + 0.5).astype(np.uint8)
            x, y, z, w = Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat()
            frustum = self.server.scene.add_camera_frustum(
                f"/cameras/{index}",
                fov=2 * float(np.arctan(camera.height / 2 / camera.fy)),
                aspect=camera.width / camera.height,
                scale=size,
                image=photo,
                wxyz=(w, x, y, z),
                position=tuple(camera.center),
            )
            frustum.on_click(lambda event, pose=camera.world_from_camera: self.go_to(event.client, pose))
            self._frusta.append(frustum)

    def fresh_file(self, folder: str, stem: str, suffix: str) -> Path:
        """Return a new path in the viewer's own folder."""
        place = self.desk.library.own / folder
        number = 1
        while (place / f"{stem}-{number}{suffix}").exists():
            number += 1
        return place / f"{stem}-{number}{suffix}"


def _plain(text: str) -> str:
    """Return text without Markdown syntax."""
    return "".join(" " if one in "`*_<>[]\n\\" else one for one in text)
