"""Errors of the mathematics, which stages translate into one-line messages."""


class InvalidValue(ValueError):
    """An argument outside a formula's domain: a matrix that is not a rotation, a zero focal length, a NaN."""


class Diverged(RuntimeError):
    """An optimization diverged to NaN or infinity, and rollbacks did not help."""


class ProcessLost(RuntimeError):
    """Another process of a distributed run has ended; holds its own message if it left one."""
