"""matplotlib with its package defaults, so that charts look the same everywhere.

By default, it reads a `matplotlibrc` in the current folder, or the user's, where `text.usetex` would even run latex.
Import matplotlib only through this module.
"""

from importlib.util import find_spec
from pathlib import Path

from stylerf.environment.trusted_paths import current_folder

_found = find_spec("matplotlib")
if _found is None or _found.origin is None:
    raise ImportError("matplotlib is not installed")
with current_folder(Path(_found.origin).parent / "mpl-data"):  # holds the default matplotlibrc
    import matplotlib
    from matplotlib import colormaps, rc_context
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import QuadMesh
    from matplotlib.colors import to_hex, to_rgb
    from matplotlib.figure import Figure
    from matplotlib.image import imsave
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogFormatter, MaxNLocator

__all__ = [
    "Axes", "Figure", "FigureCanvasAgg", "Line2D", "LogFormatter", "MaxNLocator", "QuadMesh", "colormaps", "imsave",
    "matplotlib", "rc_context", "to_hex", "to_rgb",
]  # fmt: skip
