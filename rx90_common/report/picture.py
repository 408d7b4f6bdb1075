"""Picture files by Matplotlib, in one style."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from rx90_common.process.files import write_all

WIDTH = 8.2
"""Of a picture, inches."""
_FEW_DECADES = 1e3  # on a logarithmic axis: room for 1, 2 and 5 of each
# Any: matplotlib types the keys one by one.
_STYLE: Any = {
    "svg.hashsalt": "rx90_emulator",
    "savefig.dpi": 160,
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.03,
    "axes.formatter.useoffset": False,
    "grid.alpha": 0.3,
    "lines.linewidth": 1.0,
    "lines.markersize": 4.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "path.simplify_threshold": 0.5,
    "text.parse_math": False,  # a dollar in a name from outside makes no formula
}


@contextmanager
def picture(path: Path) -> Iterator[Figure]:
    """Give an empty figure in the style of all pictures, and write what was drawn in it.

    Equal figures give equal bytes. If it cannot be written an old file stays unchanged, and no new one is left. A
    letter that the font does not have is drawn as a box, silently.

    Args:
        path: the file; its suffix, one of `style.PICTURES`, says the format.
    """
    kind = path.suffix[1:].lower()
    date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    buffer = io.BytesIO()  # in memory: of a full disk matplotlib makes other errors
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        warnings.filterwarnings("ignore", "constrained_layout not applied")  # names without room
        figure = Figure(layout="constrained")
        yield figure
        figure.savefig(buffer, format=kind, metadata=date)
    write_all({path: buffer.getvalue()})


def plain_decades(panel: Axes) -> None:
    """Label logarithmic axes with plain numbers: Matplotlib's own labels are formulas, which are not read here."""
    for axis in (panel.xaxis, panel.yaxis):
        if axis.get_scale() == "log":
            low, high = axis.get_view_interval()
            if high < _FEW_DECADES * low:
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("")
