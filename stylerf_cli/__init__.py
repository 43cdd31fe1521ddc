"""The front door: argparse, one module a verb, the only code that prints."""

import os
import sys


def _leave_current_folder_out() -> None:
    """Imports nothing from the current folder, where a stranger's modules may lie.

    Python puts it on the path for `python -m`, and for an empty entry of PYTHONPATH, which one colon too many makes. It
    stays where PYTHONPATH names it in full, and where it is the checkout that this is run from.
    """
    try:
        here = os.path.realpath(os.getcwd())
    except OSError:  # deleted: there is nothing in it
        return
    if here != os.path.dirname(os.path.dirname(os.path.realpath(__file__))):
        named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
        sys.path[:] = [one for one in sys.path if os.path.realpath(one) != here or (one and one in named)]


_leave_current_folder_out()
