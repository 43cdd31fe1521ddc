"""Changes the current folder for a moment, since libraries read configuration from it that anybody may have written."""

import os
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path


@contextmanager
def current_folder(folder: Path) -> Iterator[None]:
    """Make `folder` the current one inside the block. Affects all threads, so use it for imports only.

    The previous folder is held open rather than remembered by name, since it may be renamed or deleted.
    Windows can only go back by name, but lets nobody rename or delete a current folder.
    """
    if not hasattr(os, "fchdir"):
        with chdir(folder):
            yield
        return
    before = os.open(".", getattr(os, "O_PATH", os.O_RDONLY))
    try:
        os.chdir(folder)
        yield
    finally:
        os.fchdir(before)
        os.close(before)
