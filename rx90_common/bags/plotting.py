"""Plots of bags, one for each topic: its fields against time; for two bags both, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from rx90_common.bags.comparison import align as align_series
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import BagReader, Progress, read_joint_bag, silent
from rx90_common.bags.recorded import robot_of, time_shift
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.report.style import COLOURS, INK

USUAL = ("/joint_states", "/friction_states", "/rx90_controller/tracking_error")
"""What is drawn unless topics are chosen."""
_PARTS = 1000  # of each bag, in which progress is reported
_WALL_CLOCK = 10**8 * NANOSECONDS  # later stamps, from 1973 on, are no simulated time


class TopicLine(NamedTuple):
    """A joint's values over the time, s, with a name for the legend."""

    name: str
    time: Array
    values: Array
    colour: str
    width: float = 1.0
    dash: Literal["solid", "dashed"] = "solid"


@dataclass(frozen=True, eq=False)
class TopicPlot:
    """A topic of one bag or of two, as it is drawn.

    Attributes:
        names: of the bags.
        series: of each bag, with the same joints.
        fields: that are drawn, of the series.
        less: second less first, if that is drawn: of two bags of the same robot.
        messages: of each bag.
        robots: the names of two different robots, if the bags have them.
    """

    names: Sequence[str]
    series: tuple[JointSeries, ...]
    fields: Sequence[str]
    less: JointSeries | None
    messages: tuple[int, ...]
    robots: tuple[str, ...] = ()

    @property
    def topic(self) -> str:
        """Return the name of the topic."""
        return self.series[0].topic

    @property
    def _zero(self) -> int:
        """Return the stamp, ns, from which the times are counted."""
        start = min(int(series.stamp_ns[0]) for series in self.series)
        return start if start > _WALL_CLOCK else 0

    @property
    def time_label(self) -> str:
        """Return the label of the axis of time."""
        zero = self._zero
        if not zero:
            return "time, s"
        date = datetime.fromtimestamp(zero // NANOSECONDS, timezone.utc)
        return f"time since {date:%Y-%m-%d %H:%M:%S} and {zero % NANOSECONDS} ns UTC, s"

    def label(self, field: str) -> str:
        """Return the label of the axis of a field, with its unit."""
        return self.series[0].quantities[field].replace(" [", ", ").removesuffix("]")

    def lines(self, field: str) -> list[TopicLine]:
        """Return the lines of a field: of the second of two bags dashed, over wide ones."""
        if len(self.series) == 1:
            return self._lines(self.series[0], field)
        first, second = self.series
        lines = [
            line._replace(name=f"{line.name}, {plain(self.names[0])}", width=2.0) for line in self._lines(first, field)
        ]
        for line in self._lines(second, field):
            colour = INK if len(second.names) == 1 else line.colour
            lines.append(line._replace(name=f"{line.name}, {plain(self.names[1])}", colour=colour, dash="dashed"))
        return lines

    def lines_less(self, field: str) -> list[TopicLine]:
        """Return the lines of the differences of a field; none where no difference is drawn."""
        return [] if self.less is None else self._lines(self.less, field)

    def _lines(self, series: JointSeries, field: str) -> list[TopicLine]:
        time = (series.stamp_ns - self._zero) / NANOSECONDS
        return [
            TopicLine(plain(name), time, series.fields[field][:, k], COLOURS[k % len(COLOURS)])
            for k, name in enumerate(series.names)
        ]

    @property
    def differences(self) -> list[tuple[str, str, float, float, float, int]]:
        """Return differences: quantity, joint, the largest, its time in s, RMS, messages with common stamps."""
        less = self.less
        rows: list[tuple[str, str, float, float, float, int]] = []
        if less is None:
            return rows
        for field in self.fields:
            for name, values in zip(less.names, less.fields[field].T, strict=True):
                known = bool(np.isfinite(values).any())
                at = int(np.nanargmax(np.abs(values))) if known else 0
                rms = float(np.sqrt(np.nanmean(values**2))) if known else np.nan
                largest = float(abs(values[at]))
                rows.append((less.quantities[field], name, largest, float(less.time[at]), rms, len(values)))
        return rows


def plot_bags(
    paths: Sequence[Path],
    *,
    topics: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    align: int | str = 0,
    most: int = 3,
    progress: Progress = silent,
    mapping: LogMapping | None = None,
) -> list[TopicPlot]:
    """Return the plots of one bag, or of two and their difference (second less first).

    Bags of different robots, by the descriptions in them, are drawn over each other without a difference.

    Args:
        paths: one bag or two.
        topics: of joint states; by default the first `most` of USUAL that the bags have, or else their
            first topic.
        joints: names; by default all.
        align: moves the stamps of the second bag, as in `compare_bags`.
        most: topics by default.
        progress: called with the part of the bags read so far, and the total; no unit.
        mapping: of the columns of tables; by default the files beside them.
    """
    there = []
    for path in paths:
        with BagReader(path, mapping) as bag:
            there.append([topic.name for topic in bag.series_topics(topics)])
    both = [name for name in there[0] if all(name in names for names in there)]
    if not both:
        each = (f"{plain(path)} has {listed(names)}" for path, names in zip(paths, there, strict=True))
        raise BagError(f"no topic is in both bags: {'; '.join(each)}")
    names = both if topics is not None else [name for name in USUAL if name in both][:most] or both[:1]

    def tell(before: int, done: int, total: int) -> None:
        progress(_PARTS * before + _PARTS * done // total, _PARTS * len(paths))

    bags = [read_joint_bag(path, names, partial(tell, k), mapping) for k, path in enumerate(paths)]
    if len(bags) > 1:
        bags[1] = bags[1].moved(time_shift(align, *bags))
    if topics is None and joints is not None:  # of the usual topics those that have these joints
        recorded = {
            name: [[set(joints) <= set(one.names) for one in bag.series[name]] for bag in bags] for name in names
        }
        names = [name for name in names if all(map(any, recorded[name]))] or names[:1]
    chosen = [[bag.one(name, joints, "say which with --joint") for bag in bags] for name in names]
    robots = tuple(name for name in map(robot_of, paths) if name is not None) if len(bags) > 1 else ()
    robots = robots if len(set(robots)) > 1 else ()
    return [_topic_plot(_names(paths), series, robots) for series in chosen]


def _names(paths: Sequence[Path]) -> list[str]:
    """Return names for bags: their file names, or if these are equal their paths."""
    names = [path.resolve().name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _topic_plot(words: Sequence[str], series: Sequence[JointSeries], robots: tuple[str, ...]) -> TopicPlot:
    """Return the plot of a topic of one bag, or of two, which have these words for names."""
    first = series[0]
    second = series[-1]
    names = [name for name in first.names if name in second.names]
    fields = [f for f in first.fields if f in second.fields and first.units[f] == second.units[f]]
    if not names or not fields:
        raise BagError(
            f"{plain(first.topic)}: nothing is in both bags: joints {listed(first.names)} and {listed(second.names)}; "
            f"arrays {listed(first.fields) or 'none'} and {listed(second.fields) or 'none'}"
        )
    messages = tuple(len(one.stamp_ns) for one in series)
    same = tuple(one.select(names) for one in series)
    less = _less(same[0], same[1], fields) if len(series) > 1 and not robots else None
    return TopicPlot(words, same, fields, less, messages, robots)


def _less(first: JointSeries, second: JointSeries, fields: Sequence[str]) -> JointSeries:
    """Return the second less the first, at the stamps that both have."""
    alignment = align_series(first, second)
    if not len(alignment.stamp_ns):
        spans = [f"{one.time.min():.9g} to {one.time.max():.9g} s" for one in (first, second)]
        raise BagError(
            f"{plain(first.topic)}: no stamp is in both bags, t = {spans[0]} and {spans[1]}; accepted: bags of the "
            "same times, or --align start"
        )
    rows_a, rows_b, stamps, *_ = alignment
    less: dict[str, Array] = {field: second.fields[field][rows_b] - first.fields[field][rows_a] for field in fields}
    return JointSeries(first.topic, first.names, stamps, **less, effort_unit=first.effort_unit)
