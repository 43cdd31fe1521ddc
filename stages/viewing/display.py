"""What the pages show: a field, the field compared with it, the plane, the tinted cells."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from schemas.errors import UsageError
from stages.configs.export import ExportConfig
from stages.configs.render import RenderConfig
from stages.viewing.commands import command
from stages.viewing.library import Library
from stages.viewing.painter import Painter
from stages.viewing.shown import PLANES, Shown, Source


@dataclass(frozen=True)
class Choice:
    """What is chosen to be shown.

    Attributes:
        field: Name of a field.
        beside: Name of the field to the right of the wipe, empty without one.
        wipe: Position of the wipe, 0..1 from the left.
        plane: One of PLANES.
        overlay: Name of a region to tint, empty for none.
    """

    field: str
    beside: str = ""
    wipe: float = 0.5
    plane: str = "color"
    overlay: str = ""

    def __post_init__(self) -> None:
        if self.plane not in PLANES:
            raise UsageError(f"planes are {', '.join(PLANES)}, not {self.plane}")


class Display:
    """Shows what is chosen on every page.

    Attributes:
        lock: Held while anything that is shown changes, by all parts of a desk.
        choice: The current one.
        selected: [s, s, s] bool, marked cells of a selection in progress, before any overlay; None: none.
        in_progress: The current state of a stylization, shown instead of the field; None: none.
        recolored: Applies the palette changes to a source.
        plain: Whether pages show a field as stored: alone, in color, without tints or changes.
    """

    def __init__(self, library: Library, painter: Painter) -> None:
        self.library, self.painter = library, painter
        self.lock = threading.RLock()
        self.choice = Choice(library.first_field())
        self.selected: np.ndarray | None = None
        self.in_progress: Source | None = None
        self.recolored: Callable[[Source], Source] = lambda source: source
        self.plain = True
        self._overlays: dict[str, np.ndarray] = {}  # the last one, by digest

    @property
    def field(self) -> str:
        """The shown field's name."""
        return self.choice.field

    def source(self) -> Source:
        """Return the shown field as it is stored."""
        return self.library.source(self.field)

    def look(
        self,
        field: str | None = None,
        beside: str | None = None,
        wipe: float | None = None,
        plane: str | None = None,
        overlay: str | None = None,
    ) -> None:
        """Change what is chosen; see Choice. None: unchanged."""
        with self.lock:
            now = self.choice
            self.choice = Choice(
                now.field if field is None else field,
                now.beside if beside is None else beside,
                now.wipe if wipe is None else wipe,
                now.plane if plane is None else plane,
                now.overlay if overlay is None else overlay,
            )
            self.refresh()

    def refresh(self) -> None:
        """Show what is to be shown now."""
        with self.lock:
            stored, marked = self.source(), self._marked()
            left = self.in_progress or self.recolored(stored)
            right = self.library.source(self.choice.beside) if self.choice.beside else None
            unchanged = left.field.color is stored.field.color
            self.plain = unchanged and right is None and marked is None and self.choice.plane == "color"
            self.painter.show(Shown(left, right, self.choice.wipe, self.choice.plane, marked))

    def _marked(self) -> np.ndarray | None:
        if self.selected is not None or not self.choice.overlay:
            return self.selected
        key = self.library.work.get("region", self.choice.overlay).digest
        if key not in self._overlays:
            self._overlays = {key: self.library.marked(self.choice.overlay)}
        return self._overlays[key]

    def render_command(self) -> list[str]:
        """Return the command that renders the shown field around the scene."""
        return command("render", self.library.work.root, RenderConfig(path="orbit"), of=self.field)

    def splats_command(self) -> list[str]:
        """Return the command that exports the shown field's splats for the page and for one HTML file."""
        config = ExportConfig(kind="splats", formats="ply", units="scene", budget="60s", splats=100_000)
        return command("export", self.library.work.root, config, of=self.field)
