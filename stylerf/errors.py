"""Faults of the mathematics; a stage turns them into a line for the user."""


class InvalidValue(ValueError):
    """An argument outside what a formula admits: a non-rotation, a zero focal length, a NaN."""


class Diverged(RuntimeError):
    """An optimization left the finite numbers and could not be brought back."""


class ProcessLost(RuntimeError):
    """Another of the processes that train together has ended; its own words where it left any."""
