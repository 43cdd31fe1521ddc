"""The mathematics of stylized radiance fields and the public Python API: knows no disk, prints nothing."""

__version__ = "0.1.0"
