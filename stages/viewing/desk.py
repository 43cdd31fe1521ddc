"""The viewer without its page: its parts, each with the commands that reproduce what it shows.

The page's threads call them, and what is shown changes under one lock (Display.lock).
"""

from collections.abc import Callable

from schemas.work_folder import Artifact
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
    """The state of one viewer.

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
        """Create the parts.

        Args:
            library: of the work folder.
            painter: paints what is shown.
            threads: CPU threads.
            said: receives notes for the user.
            changed: called when runs have started, printed a line or ended.
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

    def showing_its_field(self) -> Callable[[Run], None]:
        """Return a callback for the end of a run that starts now: it shows the field that the run has made, if any."""
        before = self._newest().digest

        def ended(run: Run) -> None:
            made = self._newest()
            if run.code == 0 and made.digest != before:
                self.display.look(field=made.name)
                self._changed()

        return ended

    def _newest(self) -> Artifact:
        return self.library.work.get("field", self.library.first_field())

    def close(self) -> None:
        """Interrupt the run and wait for its checkpoint; stop background computations."""
        self.preparation.close()
        self.runs.close()
