"""The viewer without its page: its parts, each with the commands that do what it shows.

Threads of the page call them, and what is shown changes under one lock (Display.lock).
"""

from collections.abc import Callable

from stages.viewing.display import Display
from stages.viewing.library import Library
from stages.viewing.painter import Painter
from stages.viewing.path_editor import PathEditor
from stages.viewing.preparation import Preparation
from stages.viewing.recolorer import Recolorer
from stages.viewing.runs import Run, Runs
from stages.viewing.selector import Selector
from stages.viewing.stylizer import Stylizer


class Desk:
    """What one viewer works on.

    Attributes:
        display, preparation, selector, recolorer, stylizer, path, runs: Its parts.
    """

    def __init__(
        self,
        library: Library,
        painter: Painter,
        threads: int,
        said: Callable[[str], None] = lambda text: None,
        changed: Callable[[], None] = lambda: None,
        common: tuple[str, ...] = (),
    ) -> None:
        """Put the parts together.

        Args:
            library: of the work folder.
            painter: paints what is shown.
            threads: CPU threads.
            said: receives notes for the user.
            changed: called when runs have begun, spoken or ended.
            common: arguments that every command gets, such as --threads 2.
        """
        self.library, self.painter, self._changed = library, painter, changed
        self.display = Display(library, painter)
        self.preparation = Preparation(self.display, threads, said)
        self.selector = Selector(self.display, self.preparation, threads)
        self.recolorer = Recolorer(self.display)
        self.runs = Runs(common, changed)
        self.stylizer = Stylizer(self.display, self.runs)
        self.path = PathEditor(library)

    def show_newest(self, run: Run) -> None:
        """Show the newest field, if a run has made one."""
        if run.code == 0:
            newest = self.library.first_field()
            if newest != self.display.field:
                self.display.look(field=newest)
            self._changed()

    def close(self) -> None:
        """Interrupt the run and wait for its checkpoint; end what is computed in the background."""
        self.preparation.close()
        self.runs.close()
