"""Picture files by Matplotlib, in one style."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from rx90_common.process.files import write_all

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
