"""Plots of bags, one for each topic: its fields against time; of two bags both, and their difference."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from pathlib import Path

import numpy as np

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import JointBag, picked_with_messages, read_joint_bag
from rx90_common.bags.recorded import moved, robot_of, time_shift
from rx90_common.bags.storage import BagReader
from rx90_common.bags.topics import FIELDS
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.report.page import render_page
from rx90_common.report.picture import PICTURES
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
        plot: what is drawn.
        messages: of each bag.
        differences: of two bags: quantity, joint, largest difference, its time in s, RMS, and how many messages have
            stamps in common.
        robots: of two bags of different robots the names of these; then no difference is drawn.
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
    progress: Callable[[int, int], None] = lambda _done, _total: None,
    mapping: LogMapping | None = None,
) -> list[TopicPlot]:
    """Return the plots of one bag, or of two and their difference (second less first).

    Bags of different robots, by the descriptions in them, are drawn over each other without a difference.

    Args:
        paths: one bag or two.
        topics: of joint states or temperatures; by default joint states, friction and tracking error, as far as
            they are there.
        joints: names; by default all.
        align: moves the stamps of the second bag, as in `compare_bags`.
        most: topics by default.
        progress: called with how much of the bags is read, and of how much; no unit.
        mapping: what the columns of tables hold; by default as the files beside them say.

    Raises:
        BagError: as `read_chosen` and `pairs`.
    """
    chosen = read_chosen(paths, topics, joints, align, most, progress, mapping)
    if len(paths) == 1:
        return [_alone(both[0]) for both in chosen]
    robots = tuple(name for name in map(robot_of, paths) if name is not None)
    robots = robots if len(set(robots)) > 1 else ()
    return [_two(_names(paths), both, robots) for both in chosen]


def bag_page(paths: Sequence[Path], plots: Sequence[TopicPlot]) -> str:
    """Return the page that shows the plots."""
    return render_page(
        "rx90_common.bags",
        "bag.html.j2",
        names=_names(paths),
        paths=paths,
        plots=plots,
        robots=robots_text(paths, plots),
    )


def picture_title(paths: Sequence[Path], plots: Sequence[TopicPlot]) -> str:
    """Return what stands above a picture: bags and topics, or two robots."""
    names = " against ".join(reversed(_names(paths)))
    return robots_text(paths, plots) or f"{names}: {listed(one.topic for one in plots)}"


def robots_text(paths: Sequence[Path], plots: Sequence[TopicPlot]) -> str:
    """Return what is to be said of bags of different robots; nothing of others."""
    robots = next((one.robots for one in plots if one.robots), ())
    each = " and ".join(f"{plain(name)} of {plain(robot)}" for name, robot in zip(_names(paths), robots, strict=False))
    return f"two robots, {each}: drawn over each other, without a difference" if robots else ""


def joined(plots: Sequence[TopicPlot]) -> Plot:
    """Return all topics below each other, as one picture."""
    return Plot([panel for one in plots for panel in one.plot.panels], height=_HEIGHT, share_x=True)


def check_suffix(path: Path) -> bool:
    """Return whether a file is to be a page, and not a picture.

    Raises:
        BagError: if its name says neither.
    """
    kinds = (".html", *PICTURES)
    if path.suffix.lower() not in kinds:
        raise BagError(f"{plain(path)}: the suffix says what it is; accepted: {', '.join(kinds)}")
    return path.suffix.lower() == ".html"


def _names(paths: Sequence[Path]) -> list[str]:
    """Return what bags are called: their names, or where these are equal their paths."""
    names = [path.resolve().name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _alone(series: JointSeries) -> TopicPlot:
    zero, label = _times((series,))
    fields = list(series.fields)
    titles = [series.topic, *[""] * len(FIELDS)]
    panels = [
        Panel(_curves(series, field, zero), titles[k], label if field == fields[-1] else "", _axis(series, field))
        for k, field in enumerate(fields)
    ]
    return TopicPlot(series.topic, Plot(panels, height=_HEIGHT, share_x=True), (series.messages,), [])


def _two(words: Sequence[str], both: tuple[JointSeries, ...], robots: tuple[str, ...]) -> TopicPlot:
    first, second = both
    zero, label = _times(both)
    names = [name for name in first.names if name in second.names]
    fields = [f for f in first.fields if f in second.fields and first.units[f] == second.units[f]]
    if not names or not fields:
        raise BagError(
            f"{plain(first.topic)}: nothing is in both bags: joints {listed(first.names)} and {listed(second.names)}; "
            f"arrays {listed(first.fields) or 'none'} and {listed(second.fields) or 'none'}"
        )
    apart = None if robots else _Apart.of(both, names)
    panels: list[Panel] = []
    rows: list[tuple[str, str, float, float, float, int]] = []
    for field in fields:
        over = [
            *_curves(first.select(names), field, zero, f", {words[0]}"),
            *_curves(second.select(names), field, zero, f", {words[1]}", second=True),
        ]
        title, last = first.topic if field == fields[0] else "", label if field == fields[-1] else ""
        panels.append(Panel(over, title, last if apart is None else "", _axis(first, field)))
        if apart is not None:
            marks: list[Mark] = [Level(0.0, colour=INK), *_curves(apart.second_less_first, field, zero)]
            panels.append(Panel(marks, f"{words[1]} less {words[0]}", last, _axis(first, field)))
            rows += apart.rows(field)
    messages = tuple(series.messages for series in both)
    return TopicPlot(first.topic, Plot(panels, height=_HEIGHT, share_x=True), messages, rows, robots)


@dataclass(frozen=True, eq=False)
class _Apart:
    """The difference of two series, at the stamps that both have."""

    second_less_first: JointSeries

    @classmethod
    def of(cls, both: tuple[JointSeries, ...], names: Sequence[str]) -> _Apart:
        a, b = pairs(both, names)
        fields = {field: b.fields[field] - a.fields[field] for field in a.fields if field in b.fields}
        return cls(JointSeries(a.topic, a.names, a.stamp_ns, **fields, effort_unit=a.effort_unit))

    def rows(self, field: str) -> Iterator[tuple[str, str, float, float, float, int]]:
        """Yield what `TopicPlot.differences` says of each joint."""
        one = self.second_less_first
        for k, name in enumerate(one.names):
            values = one.fields[field][:, k]
            known = bool(np.isfinite(values).any())
            at = int(np.nanargmax(np.abs(values))) if known else 0
            rms = float(np.sqrt(np.nanmean(values**2))) if known else np.nan
            yield one.quantities[field], name, float(abs(values[at])), float(one.time[at]), rms, len(values)


def _times(both: Sequence[JointSeries]) -> tuple[int, str]:
    """Return the stamp at which the axis of times begins, ns, and what stands below that axis."""
    start = min(int(series.stamp_ns[0]) for series in both)
    if start <= _WALL_CLOCK:
        return 0, "time, s"
    date = datetime.fromtimestamp(start // NANOSECONDS, timezone.utc)
    return start, f"time since {date:%Y-%m-%d %H:%M:%S} and {start % NANOSECONDS} ns UTC, s"


def _curves(series: JointSeries, field: str, zero: int, suffix: str = "", *, second: bool = False) -> list[Curve]:
    time, values = (series.stamp_ns - zero) / NANOSECONDS, series.fields[field]
    # A temperature that has no message at a stamp is no gap in its curve.
    drawn = ~np.isnan(values) if series.temperature is not None else np.ones(values.shape, dtype=np.bool_)
    return [
        Curve(
            time[drawn[:, k]],
            values[drawn[:, k], k],
            f"{plain(name)}{suffix}",
            INK if second and len(series.names) == 1 else COLOURS[k % len(COLOURS)],
            1.0 if second or not suffix else 2.0,
            "dashed" if second else "solid",
        )
        for k, name in enumerate(series.names)
    ]


def _axis(series: JointSeries, field: str) -> str:
    return series.quantities[field].replace(" [", ", ").removesuffix("]")


def read_chosen(
    paths: Sequence[Path],
    topics: Sequence[str] | None,
    joints: Sequence[str] | None,
    align: int | str,
    most: int,
    progress: Callable[[int, int], None],
    mapping: LogMapping | None = None,
) -> list[tuple[JointSeries, ...]]:
    """Return a series of each bag for each topic, with equal joints.

    Args:
        paths: one bag or two.
        topics: topic names; by default the first `most` of USUAL that the bags have, or else their first topic.
        joints: names; by default all.
        align: what the stamps of the second bag are moved by, as in `compare_bags`.
        most: topics by default.
        progress: called with how much of the bags is read, and of how much; no unit.
        mapping: as in `plot_bags`.

    Raises:
        BagError: if a bag cannot be read, or a topic or joint is not there, with what is.
    """
    there = [_topics(path, topics, mapping) for path in paths]
    both = [name for name in there[0] if all(name in names for names in there)]
    if not both:
        a, b = (f"{plain(path)} has {listed(names)}" for path, names in zip(paths, there, strict=True))
        raise BagError(f"no topic is in both bags: {a}; {b}")
    usual = [name for name in USUAL if name in both][:most] or both[:1]
    wanted = both if topics is not None else usual

    def tell(before: int, done: int, total: int) -> None:
        progress(_PARTS * before + _PARTS * done // total, _PARTS * len(paths))

    bags = [read_joint_bag(path, wanted, partial(tell, k), mapping) for k, path in enumerate(paths)]
    found = [bag.series for bag in bags]
    if len(bags) > 1:
        found[1] = moved(found[1], time_shift(align, bags[0], bags[1]))
    names = [name for name in wanted if name in found[0]]
    if topics is None and joints is not None:  # of the usual topics those that have these joints
        names = [name for name in names if all(_has(bag.series[name], joints) for bag in bags)] or names[:1]
    return [
        tuple(_joints(bag, series[name], joints) for bag, series in zip(bags, found, strict=True)) for name in names
    ]


def pairs(both: tuple[JointSeries, ...], names: Sequence[str]) -> tuple[JointSeries, JointSeries]:
    """Return the messages of two series that have the same stamp, in the order of stamps, with these joints.

    Raises:
        BagError: if there are none.
    """
    a, b = (series.select(names) for series in both)
    _, rows_a, rows_b = np.intersect1d(a.stamp_ns, b.stamp_ns, return_indices=True)
    if not len(rows_a):
        spans = [f"{one.time.min():.9g} to {one.time.max():.9g} s" for one in both]
        raise BagError(
            f"{plain(a.topic)}: no stamp is in both bags, t = {spans[0]} and {spans[1]}; accepted: bags of the same "
            "times, or --align start"
        )
    return a.take(rows_a), b.take(rows_b)


def _topics(path: Path, topics: Sequence[str] | None, mapping: LogMapping | None) -> list[str]:
    with BagReader(path, mapping) as bag:
        return [topic.name for topic in picked_with_messages(bag, topics)]


def _has(found: Sequence[JointSeries], joints: Sequence[str]) -> bool:
    return any(set(joints) <= set(series.names) for series in found)


def _joints(bag: JointBag, found: Sequence[JointSeries], joints: Sequence[str] | None) -> JointSeries:
    where = f"{plain(bag.path)}: {plain(found[0].topic)}"
    if joints is None:
        if len(found) > 1:
            sets = "; ".join(listed(series.names) for series in found)
            raise BagError(f"{where} carries several sets of joints: {sets}; say which with --joint")
        return found[0]
    fitting = [series for series in found if set(joints) <= set(series.names)]
    if not fitting:
        known = dict.fromkeys(name for series in found for name in series.names)
        missing = next((name for name in joints if name not in known), joints[0])
        raise BagError(f"{where}: no joint {quoted(missing)}; there are {listed(known)}")
    return fitting[0].select(joints)
