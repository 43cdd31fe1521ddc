"""The viewer as a whole: the folder's lock, the server, its page."""

import logging
import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from schemas.errors import OutOfResources, UsageError
from schemas.lock import Lock
from stages.configs.view import HERE, ViewConfig
from stages.viewing.guard import Guard, new_token
from stages.viewing.library import Library

LOCK = ".view.lock"


class Viewer:
    """A viewer of a work folder, served until close().

    Attributes:
        url: Of the page, with the token where there is one.
        page: The page, for tests.
    """

    def __init__(
        self,
        root: Path | str,
        config: ViewConfig,
        threads: int,
        of: str = "",
        say: Callable[[str], None] = lambda text: None,
        common: tuple[str, ...] = (),
    ) -> None:
        """Open a folder and serve it.

        Args:
            of: field to show first, the newest if empty.
            say: receives notes.
            common: arguments of every command that the page runs.

        Raises:
            UsageError: the field does not exist.
            ArtifactStale: the folder contains no scene or no field.
            OutOfResources: viser is missing, another viewer locks the folder (the message names it), or the port is
                taken.
        """
        viser = _viser()
        from stages.viewing.cameras import Pose
        from stages.viewing.desk import Desk
        from stages.viewing.display import Choice
        from stages.viewing.page import Page
        from stages.viewing.painter import Painter
        from stages.viewing.shown import Shown
        from stylerf.kernels.cpu.compiling import set_threads

        self._library = library = Library(root)
        first = library.work.find("field", of).name if of else library.first_field()
        self._lock = Lock(library.work.root / LOCK, "use its page", "shown")
        try:
            threads = set_threads(threads)
            like = library.scene.cameras[0]
            scale = config.size / max(like.width, like.height) if config.size else 1.0
            self._painter = Painter(
                threads,
                like.width * like.height * scale * scale,
                config.fps,
                failed=lambda error: say(f"a picture could not be rendered: {error}"),
            )
            self.desk = desk = Desk(library, self._painter, threads, say, self._changed, common)
            desk.display.choice = Choice(first)
            here = config.host in HERE
            guard = Guard("" if here else new_token())
            _check_port(config)
            logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
            with guard.set_over_servers() as started:
                self._server = viser.ViserServer(config.host, config.port, verbose=False)
            if len(started) != 1:
                self._server.stop()
                raise UsageError(
                    "this version of viser is not supported; reinstall it with pip install 'stylerf[view]'"
                )
            host = config.host if here or config.host not in ("0.0.0.0", "::") else socket.gethostname()
            query = f"/?token={guard.token}" if guard.token else ""
            self.url = f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}{query}"
            self.page: Any = Page(self._server, desk)
            desk.preparation.say = self.page.tell
            self._painter.start(Shown(library.source(first)), Pose.of(like, 1.5))
        except BaseException:
            self._lock.release()
            raise

    def _changed(self) -> None:
        if hasattr(self, "page"):
            self.page.changed()

    def wait(self) -> None:
        """Serve until interrupted."""
        threading.Event().wait()

    def close(self) -> None:
        """Interrupt the run, stop the server, unlock the folder."""
        self.desk.close()
        self._painter.stop()
        self._server.stop()
        self._lock.release()


def _viser() -> Any:
    os.environ.pop("_VISER_PORT_OVERRIDE", None)
    try:
        import rich
        import viser
    except ImportError as error:
        raise OutOfResources(
            f"the viewer needs viser, which cannot be imported ({error}); pip install 'stylerf[view]'"
        ) from error
    rich.get_console().quiet = True  # viser prints its address, and that it has stopped
    return viser


def _check_port(config: ViewConfig) -> None:
    """Raise OutOfResources if the address cannot be bound: viser itself would try others endlessly."""
    family = socket.AF_INET6 if ":" in config.host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((config.host, config.port))
    except OSError as error:
        raise OutOfResources(
            f"--host {config.host} --port {config.port} is not available ({error.strerror or error}); give another "
            "--port, or 0 for any free one"
        ) from error
