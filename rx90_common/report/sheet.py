"""A sheet of paper in inches, on which pictures are drawn.

matplotlib's figures, lines and texts are used as they are. Its axes are not: making them and their ticks takes several
times as long as writing the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.image import BboxImage
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.textpath import text_to_path
from matplotlib.transforms import Bbox, TransformedBbox

from rx90_common.base.arrays import Array

POINT = 1.0 / 72.0  # inches


@lru_cache
def font(size: float, *, bold: bool = False) -> FontProperties:
    """Return the font of `size` points in which pictures are written."""
    return FontProperties(family="DejaVu Sans", size=size, weight="bold" if bold else "normal")


@lru_cache(4000)
def text_width(words: str, size: float) -> float:
    """Return the width of a line of text, inches; what stands between dollars is a formula."""
    width, _, _ = text_to_path.get_text_width_height_descent(words, font(size), ismath=is_formula(words))
    return float(width) * POINT


def is_formula(words: str) -> bool:
    """Return whether the words are one of the formulas that the ticks of logarithmic axes are labelled with."""
    return words.startswith("$\\mathdefault{")


class Sheet:
    """A figure of `width` by `height` inches; what is drawn later lies over what was drawn before."""

    def __init__(self, width: float, height: float) -> None:
        self.figure = Figure(figsize=(width, height))
        self.width, self.height = width, height
        self._count = 0

    def text(
        self,
        x: float,
        y: float,
        words: str,
        size: float = 9.0,
        *,
        turned: bool = False,
        bold: bool = False,
        **look: Any,
    ) -> None:
        """Write a line; `look` says how it lies about (x, y), as matplotlib's Text takes it, and its colour."""
        if words:
            text = Text(x, y, words, rotation=90.0 if turned else 0.0, parse_math=is_formula(words),
                        fontproperties=font(size, bold=bold), **look)  # fmt: skip
            self._add(text)

    def line(self, x: Array, y: Array, clip: Bbox | None = None, **look: Any) -> None:
        """Draw a line or markers through points, of shape (n,), inside of `clip`; `look` as Line2D takes it."""
        self._add(Line2D(x, y, **look), clip)

    def segments(self, ends: Array, colour: str, width: float, clip: Bbox | None = None, alpha: float = 1.0) -> None:
        """Draw straight lines between pairs of points, of shape (n, 2, 2)."""
        if len(ends):
            codes = np.tile([Path.MOVETO, Path.LINETO], len(ends))
            path = Path(np.reshape(ends, (-1, 2)), codes.astype(Path.code_type))
            self._add(PathPatch(path, fill=False, edgecolor=colour, linewidth=width, alpha=alpha), clip)

    def area(
        self, outlines: Sequence[Array], colour: str, clip: Bbox | None = None, alpha: float = 1.0, edge: float = 0.0
    ) -> None:
        """Fill outlines, each of shape (n, 2), with an edge of so many points."""
        if outlines:
            path = Path.make_compound_path(*[Path(outline, closed=True) for outline in map(_closed, outlines)])
            look: Any = {"color": colour, "linewidth": edge, "alpha": alpha, "joinstyle": "round"}
            self._add(PathPatch(path, **look), clip)

    def box(self, box: Bbox, colour: str, width: float) -> None:
        """Draw a frame."""
        self._add(Rectangle(box.p0, box.width, box.height, fill=False, edgecolor=colour, linewidth=width))

    def image(self, box: Bbox, values: Array, colours: str) -> None:
        """Show values from -1 to 1 in a box, the first row at the top, NaN as nothing."""
        image = BboxImage(
            TransformedBbox(box, self.figure.dpi_scale_trans), cmap=colours, interpolation="nearest", origin="upper"
        )
        image.set_data(np.ma.masked_invalid(values))
        image.set_clim(-1.0, 1.0)
        self._add(image)

    def _add(self, artist: Artist, clip: Bbox | None = None) -> None:
        self._count += 1
        artist.set_zorder(self._count)
        if not isinstance(artist, BboxImage):
            artist.set_transform(self.figure.dpi_scale_trans)
        if clip is not None:
            artist.set_clip_box(TransformedBbox(clip, self.figure.dpi_scale_trans))
        self.figure.add_artist(artist)


def _closed(outline: Array) -> Array:
    return np.vstack([outline, outline[:1]])
