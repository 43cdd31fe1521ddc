"""Flags of os.open that Windows lacks: zero there, where what they guard against is checked otherwise or cannot be."""

import os

NOFOLLOW = getattr(os, "O_NOFOLLOW", 0)
NONBLOCK = getattr(os, "O_NONBLOCK", 0)  # opening a named pipe does not wait for its other end
DIRECTORY = getattr(os, "O_DIRECTORY", 0)  # zero: folders cannot be opened
