"""Plots of bags, one for each topic: its fields against time; for two bags both, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from pathlib import Path

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
from rx90_common.process.files import write_text
from rx90_common.report.page import render_page
from rx90_common.report.picture import PICTURES, write_picture
from rx90_common.report.plot import COLOURS, INK, Curve, Level, Mark, Panel, Plot

USUAL = ("/joint_states", "/friction_states", "/rx90_controller/tracking_error")
"""What is drawn unless topics are chosen."""
_PARTS = 1000  # of each bag, in which progress is reported
_WALL_CLOCK = 10**8 * NANOSECONDS  # later stamps, from 1973 on, are no simulated time
_HEIGHT = 1.9  # of a panel, inches


@dataclass(frozen=True, eq=False)
class TopicPlot:
    """A topic of one bag or of two.

    Attributes:
        topic: its name.
        plot: the plot.
        messages: of each bag.
        differences: between two bags: quantity, joint, largest difference, its time in s, RMS, and the number of
            messages with common stamps.
        robots: the names of two different robots, if the bags have them; then no difference is drawn.
    """

    topic: str
    plot: Plot
    messages: tuple[int, ...]
    differences: list[tuple[str, str, float, float, float, int]]
    robots: tuple[str, ...] = ()


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


def write_plots(paths: Sequence[Path], plots: Sequence[TopicPlot], output: Path) -> str:
    """Write the plots of bags to a page or picture, by its suffix; return the remark on different robots."""
    names = _names(paths)
    robots = next((one.robots for one in plots if one.robots), ())
    each = " and ".join(f"{plain(name)} of {plain(robot)}" for name, robot in zip(names, robots, strict=False))
    note = f"two robots, {each}: drawn over each other, without a difference" if robots else ""
    if is_page(output):
        page = render_page("rx90_common.bags", "bag.html.j2", names=names, paths=paths, plots=plots, robots=note)
        write_text(output, page)
    else:  # all topics below each other
        title = note or f"{' against '.join(reversed(names))}: {listed(one.topic for one in plots)}"
        panels = [panel for one in plots for panel in one.plot.panels]
        write_picture(Plot(panels, height=_HEIGHT, share_x=True), output, title)
    return note


def is_page(path: Path) -> bool:
    """Return whether a file is a page, and not a picture, by its suffix."""
    kinds = (".html", *PICTURES)
    if path.suffix.lower() not in kinds:
        raise BagError(f"{plain(path)}: the suffix says what it is; accepted: {', '.join(kinds)}")
    return path.suffix.lower() == ".html"


def _names(paths: Sequence[Path]) -> list[str]:
    """Return names for bags: their file names, or if these are equal their paths."""
    names = [path.resolve().name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _topic_plot(words: Sequence[str], series: Sequence[JointSeries], robots: tuple[str, ...]) -> TopicPlot:
    """Return the plot of a topic of one bag, or of two, which have these words for names."""
    first = series[0]
    second = series[-1]
    start = min(int(one.stamp_ns[0]) for one in series)
    zero = 0
    label = "time, s"
    if start > _WALL_CLOCK:
        date = datetime.fromtimestamp(start // NANOSECONDS, timezone.utc)
        zero = start
        label = f"time since {date:%Y-%m-%d %H:%M:%S} and {start % NANOSECONDS} ns UTC, s"
    names = [name for name in first.names if name in second.names]
    fields = [f for f in first.fields if f in second.fields and first.units[f] == second.units[f]]
    if not names or not fields:
        raise BagError(
            f"{plain(first.topic)}: nothing is in both bags: joints {listed(first.names)} and {listed(second.names)}; "
            f"arrays {listed(first.fields) or 'none'} and {listed(second.fields) or 'none'}"
        )
    first = first.select(names)
    second = second.select(names)
    apart = None
    if len(series) > 1 and not robots:  # second less first, at the stamps that both have
        alignment = align_series(first, second)
        if not len(alignment.stamp_ns):
            spans = [f"{one.time.min():.9g} to {one.time.max():.9g} s" for one in (first, second)]
            raise BagError(
                f"{plain(first.topic)}: no stamp is in both bags, t = {spans[0]} and {spans[1]}; accepted: bags of the "
                "same times, or --align start"
            )
        rows_a, rows_b, stamps, *_ = alignment
        less: dict[str, Array] = {field: second.fields[field][rows_b] - first.fields[field][rows_a] for field in fields}
        apart = JointSeries(first.topic, first.names, stamps, **less, effort_unit=first.effort_unit)
    panels: list[Panel] = []
    differences: list[tuple[str, str, float, float, float, int]] = []
    for field in fields:
        title = first.topic if field == fields[0] else ""
        last = label if field == fields[-1] else ""
        axis = first.quantities[field].replace(" [", ", ").removesuffix("]")
        over = _curves(first, field, zero, f", {words[0]}" if len(series) > 1 else "")
        if len(series) > 1:
            over += _curves(second, field, zero, f", {words[1]}", second=True)
        panels.append(Panel(over, title, last if apart is None else "", axis))
        if apart is not None:
            marks: list[Mark] = [Level(0.0, colour=INK), *_curves(apart, field, zero)]
            panels.append(Panel(marks, f"{words[1]} less {words[0]}", last, axis))
            for name, values in zip(apart.names, apart.fields[field].T, strict=True):
                known = bool(np.isfinite(values).any())
                at = int(np.nanargmax(np.abs(values))) if known else 0
                rms = float(np.sqrt(np.nanmean(values**2))) if known else np.nan
                found = float(abs(values[at])), float(apart.time[at]), rms, len(values)
                differences.append((apart.quantities[field], name, *found))
    messages = tuple(len(one.stamp_ns) for one in series)
    return TopicPlot(first.topic, Plot(panels, height=_HEIGHT, share_x=True), messages, differences, robots)


def _curves(series: JointSeries, field: str, zero: int, suffix: str = "", *, second: bool = False) -> list[Curve]:
    time = (series.stamp_ns - zero) / NANOSECONDS
    values = series.fields[field]
    curves = []
    for k, name in enumerate(series.names):
        colour = INK if second and len(series.names) == 1 else COLOURS[k % len(COLOURS)]
        width = 1.0 if second or not suffix else 2.0
        label = f"{plain(name)}{suffix}"
        curves.append(Curve(time, values[:, k], label, colour, width, "dashed" if second else "solid"))
    return curves
