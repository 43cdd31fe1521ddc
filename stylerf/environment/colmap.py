"""pycolmap without its handler of SIGTERM, which prints a stack trace and ends the process at once.

Import pycolmap from here only.
"""

import signal
import threading

import pycolmap

__all__ = ["pycolmap"]

# Python still knows its own handler; setting it again puts it back in place of pycolmap's.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM) or signal.SIG_DFL)
