"""The command line: argparse, one module per verb. The only code that prints."""

import os
import sys


def _leave_current_folder_out() -> None:
    """Remove the current folder, which may contain untrusted modules, from the import path.

    Python adds it for `python -m` and for an empty entry of PYTHONPATH, such as one from a stray colon. It stays if
    PYTHONPATH names it in full, or if it is the checkout that this runs from.
    """
    try:
        here = os.path.realpath(os.getcwd())
    except OSError:  # deleted, so empty
        return
    if here != os.path.dirname(os.path.dirname(os.path.realpath(__file__))):
        named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
        sys.path[:] = [one for one in sys.path if os.path.realpath(one) != here or (one and one in named)]


_leave_current_folder_out()
