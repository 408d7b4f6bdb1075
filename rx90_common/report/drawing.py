"""The look of every report's plots, and figures as SVG text for one self-contained page."""

from __future__ import annotations

import io
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Colour-blind safe (Okabe and Ito), one for each of seven friction elements.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
_WIDTH = 8.2  # inches
_LEFT, _BETWEEN = 0.9, 0.5  # inches, of a grid: left of each panel, and between two rows
# Any: matplotlib types the keys one by one.
_STYLE: Any = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "rx90_emulator",
    "svg.fonttype": "path",
}


def make_figure(rows: int, height: float, *, share_x: bool = True) -> tuple[Figure, list[Axes]]:
    """Return a figure of the reports' width, `height` inches high, and its panels from the top."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        axes = figure.subplots(rows, 1, sharex=share_x, squeeze=False)
        return figure, list(axes[:, 0])


def make_grid(count: int, columns: int, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure of the reports' width with `count` panels in columns, row by row, each `height` inches high.

    The margins are fixed, for titles of one line, labels and ticks: a layout engine takes as long as the drawing.
    """
    rows = -(-count // columns)
    whole = height * rows + 0.5
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, whole))
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        panel = height - _BETWEEN
        share = 1.0 / columns
        figure.subplots_adjust(
            left=_LEFT / _WIDTH, right=1.0 - 0.1 / _WIDTH, bottom=0.5 / whole, top=1.0 - 0.3 / whole,
            hspace=_BETWEEN / panel, wspace=_LEFT / (share * _WIDTH - _LEFT),
        )  # fmt: skip
        for spare in axes[count:]:
            spare.remove()
        return figure, list(axes[:count])


def as_svg(figure: Figure) -> str:
    """Return the figure as an <svg> element; equal figures give equal text."""
    buffer = io.StringIO()
    with mpl.rc_context(_STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
