"""matplotlib as hypose uses it: without a window, its list of fonts where hypose keeps what it can make again."""

from __future__ import annotations

import logging
import os

from hypose.compute import cache_folder

if "MPLCONFIGDIR" not in os.environ and (_folder := cache_folder()) is not None:
    os.environ["MPLCONFIGDIR"] = str(_folder / "matplotlib")
logging.getLogger("matplotlib").setLevel(logging.ERROR)  # where it keeps its fonts is nothing to warn of

from matplotlib import rc_context  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.patches import Patch  # noqa: E402

__all__ = ["Axes", "Figure", "FigureCanvasSVG", "Patch", "rc_context"]
