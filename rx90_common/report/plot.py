"""The description of a plot: curves, points and bands in panels. `picture` draws it by Matplotlib, `page` by Bokeh.

Arrays are float64 of shape (n,); NaN leaves a gap. Labels carry the units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np
from matplotlib.scale import SymmetricalLogTransform

from rx90_common.base.arrays import Array, least_and_largest

# Colour-blind safe (Okabe and Ito), one for each of seven friction elements.
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
INK: Final = "#222222"
GREY: Final = "#888888"
Dash: TypeAlias = Literal["solid", "dashed", "dotted", "dashdot"]
Scale: TypeAlias = Literal["linear", "log", "symlog"]

_MARGIN = 0.03  # of the data's range, on either side
LINEAR_PART = 0.3  # decades that the linear part of a symlog axis is wide, on either side


@dataclass(frozen=True, eq=False)
class Curve:
    """A line through points; with `dots` these are marked."""

    x: Array
    y: Array
    label: str = ""
    colour: str = COLOURS[0]
    width: float = 1.0
    dash: Dash = "solid"
    dots: bool = False


@dataclass(frozen=True, eq=False)
class Dots:
    """Points alone, with bars of `error` above and below where it is given."""

    x: Array
    y: Array
    label: str = ""
    colour: str = COLOURS[0]
    error: Array | None = None


@dataclass(frozen=True, eq=False)
class Band:
    """What lies between two curves."""

    x: Array
    low: Array
    high: Array
    label: str = ""
    colour: str = GREY


@dataclass(frozen=True)
class Level:
    """A straight line through the whole panel, at y or, with `upright`, at x."""

    at: float
    label: str = ""
    colour: str = INK
    dash: Dash = "solid"
    upright: bool = False


Mark: TypeAlias = Curve | Dots | Band | Level


@dataclass(frozen=True, eq=False)
class Panel:
    """Axes with their marks.

    Attributes:
        marks: from back to front; equal labels have one entry in the legend.
        title: one line.
        x_label: with unit; "" if the panel below has it.
        y_label: with unit.
        x_scale: symlog is logarithmic on either side of 0.
        y_scale: linear or log.
        from_zero: whether the y axis begins at 0.
        smallest: on a symlog axis, the size at which the logarithmic part begins.
    """

    marks: Sequence[Mark]
    title: str = ""
    x_label: str = ""
    y_label: str = ""
    x_scale: Scale = "linear"
    y_scale: Scale = "linear"
    from_zero: bool = False
    smallest: float = 1.0

    @property
    def x_range(self) -> tuple[float, float]:
        """Return the range of the x axis."""
        values = [mark.x for mark in self.marks if not isinstance(mark, Level)]
        values += [np.array([mark.at]) for mark in self.marks if isinstance(mark, Level) and mark.upright]
        if self.x_scale == "symlog":
            ends = _range([symlog(x, self.smallest) for x in values], "linear")
            low, high = _symlog_transform(self.smallest).inverted().transform(np.array(ends)).tolist()
            return low, high
        return _range(values, self.x_scale)

    @property
    def y_range(self) -> tuple[float, float]:
        """Return the range of the y axis."""
        values = []
        for mark in self.marks:
            if isinstance(mark, Band):
                values += [mark.low, mark.high]
            elif not isinstance(mark, Level):
                error = mark.error if isinstance(mark, Dots) and mark.error is not None else 0.0
                values += [mark.y - error, mark.y + error]
            elif not mark.upright:
                values.append(np.array([mark.at]))
        low, high = _range(values, self.y_scale)
        return (0.0 if self.from_zero else low), high


@dataclass(frozen=True, eq=False)
class Heat:
    """Correlations from -1 to 1 as colours, of shape (k, k), NaN where there is none; a panel of its own."""

    names: Sequence[str]
    values: Array
    title: str = ""


@dataclass(frozen=True, eq=False)
class Plot:
    """Panels row by row.

    Attributes:
        panels: one at least.
        columns: of panels; on a narrow screen they are below each other.
        height: of a panel, inches.
        share_x: whether all panels show the same range of x.
    """

    panels: Sequence[Panel | Heat]
    columns: int = 1
    height: float = 2.4
    share_x: bool = False

    @property
    def x_range(self) -> tuple[float, float]:
        """Return the range that all panels show where they share it."""
        ranges = [panel.x_range for panel in self.panels if isinstance(panel, Panel)]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    def worded(self, words: Callable[[str], str]) -> Plot:
        """Return the plot with its axes' labels, which carry the units, changed by a function."""
        panels = [
            replace(one, x_label=words(one.x_label), y_label=words(one.y_label)) if isinstance(one, Panel) else one
            for one in self.panels
        ]
        return replace(self, panels=panels)


def _symlog_transform(smallest: float) -> SymmetricalLogTransform:
    return SymmetricalLogTransform(10.0, smallest, LINEAR_PART)


def symlog(values: Array, smallest: float) -> Array:
    """Return where values lie on a symlog axis, in decades, for `smallest` as in Panel."""
    return np.asarray(_symlog_transform(smallest).transform(values), dtype=np.float64)


def symlog_ticks(low: float, high: float, smallest: float) -> list[float]:
    """Return the decades from `smallest` on, either side, and 0, as far as they lie within the range."""
    largest = max(abs(low), abs(high))
    decades = 10.0 ** np.arange(np.ceil(np.log10(smallest) - 1e-9), np.floor(np.log10(largest)) + 1.0)
    ticks: list[float] = np.concatenate([-decades[::-1], [0.0], decades]).tolist()
    return [tick for tick in ticks if low <= tick <= high]


def with_fewer_points(plot: Plot, most: int) -> Plot:
    """Return a plot that looks the same, with about `most` points of a curve; curves with dots keep all of theirs.

    The first, the least, the largest and the last of the points in each of most / 4 columns of equal width are kept:
    lines through these cover the same dots as lines through all, on a canvas with as many columns (M4 of Jugel et al.,
    Proc. VLDB Endowment 7 (2014) 797). A curve that goes back in x keeps more.
    """
    panels = [
        panel if isinstance(panel, Heat) else replace(panel, marks=[_fewer(panel, mark, most) for mark in panel.marks])
        for panel in plot.panels
    ]
    return replace(plot, panels=panels)


def _fewer(panel: Panel, mark: Mark, most: int) -> Mark:
    if not isinstance(mark, Curve) or mark.dots or len(mark.x) <= most:
        return mark
    x = mark.x
    y = mark.y
    with np.errstate(divide="ignore", invalid="ignore"):  # values without a logarithm are no points
        x = np.log10(x) if panel.x_scale == "log" else symlog(x, panel.smallest) if panel.x_scale == "symlog" else x
        y = np.ascontiguousarray(np.log10(y) if panel.y_scale == "log" else y)
    known = np.isfinite(x) & np.isfinite(y)
    low, high = (x[known].min(), x[known].max()) if known.any() else (0.0, 0.0)
    place = np.where(known, x - low, 0.0) * ((most // 4) / (high - low) if high > low else 0.0)
    column = np.where(known, place.astype(np.int32), -1)  # a gap is a column of its own, whose ends are kept
    starts = np.append(0, np.flatnonzero(np.diff(column)) + 1)
    lengths = np.diff(np.append(starts, len(x)))
    filled = starts[known[starts]]
    rows = [starts, starts + lengths - 1]
    for extreme in least_and_largest(y, starts):
        equal = np.flatnonzero(y == np.repeat(extreme, lengths))
        rows.append(equal[np.searchsorted(equal, filled)])
    kept = np.unique(np.concatenate(rows))
    return replace(mark, x=mark.x[kept], y=mark.y[kept])


def _range(values: Sequence[Array], scale: Scale) -> tuple[float, float]:
    """Return the range of finite values, of positive ones on a logarithmic axis, with a margin on either side."""
    every = np.concatenate([np.ravel(one) for one in values]) if values else np.empty(0)
    every = every[np.isfinite(every) & ((every > 0.0) | (scale != "log"))]
    if not len(every):
        return (0.1, 1.0) if scale == "log" else (0.0, 1.0)
    low = float(every.min())
    high = float(every.max())
    if scale == "log":
        factor = (high / low) ** _MARGIN if high > low else 2.0
        return low / factor, high * factor
    margin = _MARGIN * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin
