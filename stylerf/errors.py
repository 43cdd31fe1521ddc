"""Errors raised by stylerf, which stages convert to one-line messages."""


class InvalidValue(ValueError):
    """An argument outside a formula's domain: a matrix that is not a rotation, a zero focal length, a NaN."""


class Diverged(RuntimeError):
    """An optimization diverged to NaN or infinity, and rolling back did not help."""


class ProcessLost(RuntimeError):
    """Another process of a distributed run has ended; holds that process's message if it left one."""
