"""Selecting in the shown field: clicks, strokes and boxes become options of `stylerf select`, and their cells."""

import numpy as np

from schemas.errors import BadInput, UsageError
from schemas.work_folder import valid_name
from stages.viewing.cameras import Pose, pixel_at
from stages.viewing.commands import command
from stages.viewing.display import Display
from stages.viewing.preparation import Preparation
from stages.viewing.selection import History

CLICK_PIXELS = 200_000.0  # of the camera in which clicks are looked up; its pixels are finer than any field
BOX_RAYS = 24  # rays per side through a rectangle that becomes a box

Place = tuple[float, float]  # across and down, 0..1 from the top left


class Selector:
    """A selection in progress.

    Attributes:
        history: Its options so far.
    """

    def __init__(self, display: Display, preparation: Preparation, threads: int) -> None:
        self._display, self._library, self._threads = display, display.library, threads
        self._preparation = preparation
        self.history = History()

    def click(self, pose: Pose, across: float, down: float, avoid: bool = False) -> str:
        """Add what the picture shows at a position to the selection, or exclude it; return the seed.

        Args:
            across, down: in 0..1, from the top left.

        Raises:
            BadInput: the position hits nothing, or no training view shows it.
        """
        seed = self._seeds(pose, [(across, down)], skipping=False)[0]
        with self._display.lock:
            self.history.add("avoid" if avoid else "at", seed)
            self.grow()
        return seed

    def scribble(self, pose: Pose, places: list[Place], avoid: bool = False) -> int:
        """Add several positions along a stroke; return how many of them hit something that a view shows.

        Raises:
            BadInput: none of them does.
        """
        found = self._seeds(pose, places, skipping=True)
        if not found:
            raise BadInput("the stroke hits nothing of the field that a training view shows: draw over an object")
        name = "avoid" if avoid else "at"
        with self._display.lock:
            self.history.change(**{name: tuple(dict.fromkeys((*getattr(self.history.now, name), *found)))})
            self.grow()
        return len(found)

    def _seeds(self, pose: Pose, places: list[Place], skipping: bool) -> list[str]:
        """Return VIEW:X,Y of positions; skipping: leave out those that no view shows."""
        from stages.viewing.growing import place_of, seen_at

        camera, found = pose.camera(CLICK_PIXELS), list[str]()
        field = self._display.source().field
        for place in places:
            pixel = pixel_at(camera, *place)
            try:
                there = place_of(field, camera, pixel, self._threads)
                toward = camera.rays(np.array([pixel]))[1][0].astype(float)
                found.append("{}:{},{}".format(*seen_at(self._library.scene, field, there, toward, self._threads)))
            except BadInput:
                if not skipping:
                    raise
        return found

    def box(self, pose: Pose, low: Place, high: Place) -> tuple[float, ...]:
        """Set the selection's box around the surfaces that a rectangle of the picture shows; return its corners."""
        from stages.viewing.growing import box_around
        from stylerf.editing.selection import ends_of_rays

        camera = pose.camera(CLICK_PIXELS)
        across = np.linspace(min(low[0], high[0]), max(low[0], high[0]), BOX_RAYS).clip(0, 1) * (camera.width - 1)
        down = np.linspace(min(low[1], high[1]), max(low[1], high[1]), BOX_RAYS).clip(0, 1) * (camera.height - 1)
        pixels = (down.astype(int)[:, None] * camera.width + across.astype(int)).ravel()
        field = self._display.source().field
        x, alpha = ends_of_rays(field, camera, pixels, self._threads)
        if not (alpha > 0.5).any():
            raise BadInput("the rectangle contains nothing of the field: draw it over an object")
        corners = box_around(field.space.unwarp(np.clip(x[alpha > 0.5], 1e-6, 1 - 1e-6)))
        self.change(box=corners)
        return corners

    def change(self, **values: object) -> None:
        """Change options of the selection, such as tolerance=10.0 or union=("a",)."""
        with self._display.lock:
            self.history.change(**values)
            self.grow()

    def undo(self) -> None:
        """Undo the last change of the selection."""
        with self._display.lock:
            self.history.undo()
            self.grow()

    def clear(self) -> None:
        """Select nothing."""
        with self._display.lock:
            self.history.clear()
            self.grow()

    def grow(self) -> None:
        """Compute the selection's cells and show them; an invalid selection is undone."""
        with self._display.lock:
            self._display.selected = None
            if self.history.now:
                try:
                    self._display.selected = self._preparation.grower().cells(self.history.now)
                except (BadInput, ValueError):
                    self.history.undo()
                    raise
            self._display.refresh()

    @property
    def cells(self) -> int:
        """Number of marked cells."""
        return 0 if self._display.selected is None else int(self._display.selected.sum())

    def command(self, name: str = "") -> list[str]:
        """Return the command that makes a region from the selection.

        Raises:
            UsageError: nothing is selected.
        """
        if not self.history.now:
            raise UsageError("nothing is selected: click an object first")
        config, root = self.history.now.config(), self._library.work.root
        return command("select", root, config, of=self._display.field, name=name and valid_name(name))
