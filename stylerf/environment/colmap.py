"""pycolmap without its SIGTERM handler, which prints a stack trace and ends the process immediately.

Import pycolmap only from here.
"""

import signal
import threading

import pycolmap

__all__ = ["pycolmap"]

# Python still knows its own handler; setting it again replaces pycolmap's.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM) or signal.SIG_DFL)
