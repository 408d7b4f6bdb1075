"""Plots of bags, one for each topic: its fields against time; for two bags both, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

from rx90_common.bags.comparison import align as align_series
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import BagReader, read_joint_bag
from rx90_common.bags.recorded import time_shift
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.report.style import COLOURS, INK

USUAL = ("/joint_states", "/friction_states", "/rx90_controller/tracking_error")
"""What is drawn unless topics are chosen."""
_WALL_CLOCK = 10**8 * NANOSECONDS  # later stamps, from 1973 on, are no simulated time


class TopicLine(NamedTuple):
    """A joint's values over the time, s, with a name for the legend."""

    name: str
    time: Array
    values: Array
    colour: str
    width: float = 1.0
    dash: Literal["solid", "dashed"] = "solid"


class TopicPanel(NamedTuple):
    """Lines over one axis of time, with title and label."""

    title: str
    label: str
    lines: list[TopicLine]


@dataclass(frozen=True, eq=False)
class TopicPlot:
    """A topic of one bag or of two, as it is drawn.

    Attributes:
        names: of the bags.
        series: of each bag, with the same joints.
        less: second less first, if there are two.
        zero_ns: stamp from which the times are counted.
    """

    names: Sequence[str]
    series: tuple[JointSeries, ...]
    less: JointSeries | None
    zero_ns: int = 0

    @property
    def time_label(self) -> str:
        """Return the label of the axis of time."""
        return f"time since {self.zero_ns / NANOSECONDS:.9f} s, s" if self.zero_ns else "time, s"

    @property
    def panels(self) -> list[TopicPanel]:
        """Return a panel for each field, its differences below; the second of two bags is dashed, over wide lines."""
        panels: list[TopicPanel] = []
        first = self.series[0]
        for field in first.fields:
            label = first.quantities[field].replace(" [", ", ").removesuffix("]")
            lines = self._lines(first, field)
            if len(self.series) > 1:
                second = self._lines(self.series[1], field)
                alone = len(second) == 1
                lines = [line._replace(name=f"{line.name}, {plain(self.names[0])}", width=2.0) for line in lines]
                lines += [
                    line._replace(name=f"{line.name}, {plain(self.names[1])}", colour=INK if alone else line.colour,
                                  dash="dashed") for line in second
                ]  # fmt: skip
            panels.append(TopicPanel("" if panels else first.topic, label, lines))
            if self.less is not None:
                title = f"{self.names[1]} less {self.names[0]}"
                panels.append(TopicPanel(title, label, self._lines(self.less, field)))
        return panels

    def _lines(self, series: JointSeries, field: str) -> list[TopicLine]:
        time = (series.stamp_ns - self.zero_ns) / NANOSECONDS
        return [
            TopicLine(plain(name), time, series.fields[field][:, k], COLOURS[k % len(COLOURS)])
            for k, name in enumerate(series.names)
        ]


def plot_bags(
    paths: Sequence[Path],
    topics: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    align: int | str = 0,
    mapping: LogMapping | None = None,
) -> list[TopicPlot]:
    """Return the plots of one bag, or of two and their difference (second less first).

    Args:
        paths: one bag or two.
        topics: of joint states; by default those of USUAL that the bags have, or else their first topic.
        joints: names; by default all.
        align: moves the stamps of the second bag, as in `compare_bags`.
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
    names = both if topics is not None else [name for name in USUAL if name in both] or both[:1]
    bags = [read_joint_bag(path, names, mapping=mapping) for path in paths]
    if len(bags) > 1:
        bags[1] = bags[1].moved(time_shift(align, *bags))
    words = [path.resolve().name for path in paths]
    if len(set(words)) < len(words):
        words = [str(path) for path in paths]
    plots = [_topic_plot(words, [bag.one(name, joints, "say which with --joint") for bag in bags]) for name in names]
    start = min(int(series.stamp_ns[0]) for plot in plots for series in plot.series)
    return [replace(plot, zero_ns=start) for plot in plots] if start > _WALL_CLOCK else plots


def _topic_plot(words: Sequence[str], series: Sequence[JointSeries]) -> TopicPlot:
    """Return the plot of a topic of one bag, or of two, which have these words for names."""
    if len(series) == 1:
        return TopicPlot(words, (series[0],), None)
    first, second = series
    names = [name for name in first.names if name in second.names]
    fields = [f for f in first.fields if f in second.fields and first.units[f] == second.units[f]]
    if not names or not fields:
        raise BagError(f"{plain(first.topic)}: nothing is in both bags; accepted: bags with the same joints and units")
    first = first.select(names).only(fields)
    second = second.select(names).only(fields)
    alignment = align_series(first, second)
    if not len(alignment.stamp_ns):
        raise BagError(f"{plain(first.topic)}: no stamp is in both bags; accepted: the same times, or --align start")
    differences = {
        field: second.fields[field][alignment.rows_b] - first.fields[field][alignment.rows_a] for field in fields
    }
    less = JointSeries(first.topic, first.names, alignment.stamp_ns, **differences, effort_unit=first.effort_unit)
    return TopicPlot(words, (first, second), less)
