"""Where an axis of a still picture has its ticks, and how they are labelled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import Formatter, LogFormatterSciNotation, LogLocator, MaxNLocator, ScalarFormatter

from rx90_common.base.arrays import Array
from rx90_common.report.plot import Scale, on_axis, symlog_ticks

_STEPS = [1, 2, 2.5, 5, 10]  # between ticks
_FEW_DECADES = 10.0**3  # on a logarithmic axis: room for 1, 2 and 5 of each


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of a panel.

    Attributes:
        scale: of the values.
        ends: the values at its ends.
        smallest: on a symlog axis, as in Panel.
        first: where it begins on the sheet, inches.
        length: inches.
    """

    scale: Scale
    ends: tuple[float, float]
    smallest: float
    first: float
    length: float

    def place(self, values: Array | Sequence[float]) -> Array:
        """Return where values lie on the sheet, inches; NaN for those that a logarithmic axis cannot have."""
        every = np.concatenate([self.ends[:1], np.asarray(values, np.float64), self.ends[1:]])
        low, *shown, high = on_axis(every, self.scale, self.smallest)
        places: Array = self.first + self.length * (np.array(shown) - low) / (high - low)
        return places


@dataclass(frozen=True, eq=False)
class AxisTicks:
    """The ticks of an axis.

    Attributes:
        values: of those with labels, shape (n,).
        labels: of these.
        offset: what all labels are to be multiplied by or added to, as in "1e-7+1"; or "".
        between: values of the small ones without labels.
    """

    values: Array
    labels: Sequence[str]
    offset: str = ""
    between: Sequence[float] = ()


def ticks_of(axis: Axis, most: int) -> AxisTicks:
    """Return the ticks of an axis, about `most` on a linear one."""
    low, high = axis.ends
    if axis.scale == "symlog":
        values = np.array(symlog_ticks(low, high, axis.smallest))
        return AxisTicks(values, [f"{value:g}" for value in values])
    if axis.scale == "linear":
        values = _within(MaxNLocator(most, steps=_STEPS).tick_values(low, high), axis)
        linear = _for_ends(ScalarFormatter(), axis)
        return AxisTicks(values, linear.format_ticks(values.tolist()), linear.get_offset())
    if high < _FEW_DECADES * low:
        values = _within(LogLocator(subs=(1.0, 2.0, 5.0)).tick_values(low, high), axis)
        return AxisTicks(values, [f"{value:g}" for value in values])
    values = _within(LogLocator(numticks=9).tick_values(low, high), axis)
    decades = _for_ends(LogFormatterSciNotation(), axis)
    between = _within(LogLocator(subs="auto", numticks=9).tick_values(low, high), axis)
    return AxisTicks(values, [decades(value) for value in values], "", between.tolist())


def _for_ends(formatter: Formatter, axis: Axis) -> Formatter:
    """Tell a formatter what the axis shows, by a stand-in for matplotlib's axis."""
    formatter.create_dummy_axis()
    stand_in: Any = formatter.axis
    stand_in.set_view_interval(*axis.ends)
    return formatter


def _within(values: Array | Sequence[float], axis: Axis) -> Array:
    values = np.asarray(values)
    places = (axis.place(values) - axis.first) / axis.length
    return values[(places > -1e-9) & (places < 1.0 + 1e-9)]
