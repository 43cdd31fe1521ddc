"""Exported splats, drawn by the page itself instead of small pictures while the camera moves."""

import threading
from typing import Any

import numpy as np

from schemas.errors import StylerfError
from stages.viewing.display import Display
from stages.viewing.shown import bytes_of

BLANK = 8  # pixels per side of the uniform picture behind them


class MovingSplats:
    """The splats of the shown field on one page, hidden while its camera is at rest.

    Attributes:
        wanted: Whether they should be shown at all.
    """

    def __init__(self, client: Any, display: Display) -> None:
        self._client, self._display = client, display
        self.wanted = True
        self._node: Any = None
        self._loaded: tuple[str, str] = ("", "")  # digest of the field, file of the splats
        self._lock = threading.Lock()

    @property
    def shown(self) -> bool:
        """Whether the page shows them now."""
        return self._node is not None and bool(self._node.visible)

    def load(self) -> None:
        """Bring the shown field's newest splats to the page, or none if it has none."""
        from schemas.splat_ply import read_splat_ply
        from stages.viewing.splat_page import gaussians

        library = self._display.library
        with self._lock:
            try:
                key, path = library.work.get("field", self._display.field).digest, library.splats(self._display.field)
                if (key, str(path)) == self._loaded:
                    return
                parts = gaussians(read_splat_ply(path)) if path is not None else None
            except (StylerfError, OSError):
                return  # the field or its export is being replaced
            old, self._node = self._node, None
            if old is not None:
                old.remove()
            if parts is not None:
                self._node = self._client.scene.add_gaussian_splats("/splats", **parts, visible=False)
            self._loaded = key, str(path)

    def begin(self) -> bool:
        """Show them as the camera moves; return whether they exist and show the same as pictures would."""
        if self._node is None or not self.wanted or not self._display.plain:
            return False
        if not self._node.visible:
            level = np.full((BLANK, BLANK, 3), self._display.source().level)
            with self._client.atomic():
                self._client.scene.set_background_image(bytes_of(level), format="png")
                self._node.visible = True
        return True

    def end(self) -> None:
        """Hide them in favor of a better picture."""
        if self._node is not None:
            self._node.visible = False
