"""Flags of os.open that Windows lacks. There they are zero, and other checks replace them."""

import os

NOFOLLOW: int = getattr(os, "O_NOFOLLOW", 0)
NONBLOCK: int = getattr(os, "O_NONBLOCK", 0)  # do not wait for the other end of a named pipe
DIRECTORY: int = getattr(os, "O_DIRECTORY", 0)  # if zero, folders cannot be opened
