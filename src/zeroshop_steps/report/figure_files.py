"""Plots as files: the same bytes each time."""

from pathlib import Path

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from zeroshop_steps.runtime.files import atomic_write


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure to `path` as .svg and as .png, whatever its own suffix."""
    with atomic_write(path.with_suffix(".png")) as temporary:  # first: print_svg leaves the figure at 72 dots per inch
        FigureCanvasAgg(figure).print_png(temporary, metadata={"Software": None})
    with matplotlib.rc_context({"svg.hashsalt": "zeroshop"}), atomic_write(path.with_suffix(".svg")) as temporary:
        FigureCanvasSVG(figure).print_svg(temporary, metadata={"Date": None})
