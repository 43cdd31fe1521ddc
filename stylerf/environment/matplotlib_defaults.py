"""matplotlib with the settings that its package ships: charts look the same everywhere.

Left alone it reads a `matplotlibrc` in the current folder, or the user's: one line there, `text.usetex`, runs latex.
All of matplotlib is imported through this module.
"""

from importlib.util import find_spec
from pathlib import Path

from stylerf.environment.current_folder import current_folder

with current_folder(Path(find_spec("matplotlib").origin).parent / "mpl-data"):  # which holds the default matplotlibrc
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
