"""Plots of bags, one for each topic: its fields against time; of two bags both, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.plotting.chosen import pairs, read_chosen
from rx90_common.bags.topics import FIELDS
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, INK, Curve, Level, Panel, Plot
from rx90_common.report.still import PICTURES

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
    """

    topic: str
    plot: Plot
    messages: tuple[int, ...]
    differences: list[tuple[str, str, float, float, float, int]]


def plot_bags(
    paths: Sequence[Path],
    *,
    topics: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    align: int | str = 0,
    most: int = 3,
) -> list[TopicPlot]:
    """Return the plots of one bag, or of two and their difference (second less first).

    Args:
        paths: one bag or two.
        topics: JointState topics; by default joint states, friction and tracking error, as far as they are there.
        joints: names; by default all.
        align: moves the stamps of the second bag, as in `compare_bags`.
        most: topics by default.

    Raises:
        BagError: as `read_chosen` and `pairs`.
    """
    return [_topic_plot(paths, both) for both in read_chosen(paths, topics, joints, align, most)]


def bag_page(paths: Sequence[Path], plots: Sequence[TopicPlot]) -> str:
    """Return the page that shows the plots."""
    return render_page("rx90_common.bags.plotting", "bag.html.j2", names=_names(paths), paths=paths, plots=plots)


def picture_title(paths: Sequence[Path], plots: Sequence[TopicPlot]) -> str:
    """Return what stands above a picture: bags and topics."""
    return f"{' against '.join(reversed(_names(paths)))}: {listed(one.topic for one in plots)}"


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


def _topic_plot(paths: Sequence[Path], both: tuple[JointSeries, ...]) -> TopicPlot:
    first = both[0]
    start = min(int(series.stamp_ns[0]) for series in both)
    zero = start if start > _WALL_CLOCK else 0
    label = "time, s"
    if zero:
        date = datetime.fromtimestamp(zero // NANOSECONDS, timezone.utc)
        label = f"time since {date:%Y-%m-%d %H:%M:%S} and {zero % NANOSECONDS} ns UTC, s"
    titles = [first.topic, *[""] * len(FIELDS)]
    if len(both) == 1:
        fields = list(first.fields)
        panels = [
            Panel(_curves(first, field, zero), titles[k], label if field == fields[-1] else "", _axis(first, field))
            for k, field in enumerate(fields)
        ]
        return TopicPlot(first.topic, Plot(panels, height=_HEIGHT, share_x=True), (len(first.stamp_ns),), [])
    names = [name for name in first.names if name in both[1].names]
    fields = [field for field in first.fields if field in both[1].fields]
    if not names or not fields:
        raise BagError(
            f"{plain(first.topic)}: nothing is in both bags: joints {listed(first.names)} and {listed(both[1].names)}; "
            f"arrays {listed(first.fields) or 'none'} and {listed(both[1].fields) or 'none'}"
        )
    a, b = pairs(both, names)
    panels, rows = [], []
    words = _names(paths)
    for field in fields:
        over = [
            *_curves(both[0].select(names), field, zero, f", {words[0]}"),
            *_curves(both[1].select(names), field, zero, f", {words[1]}", second=True),
        ]
        apart = b.fields[field] - a.fields[field]
        time = (a.stamp_ns - zero) / NANOSECONDS
        quantity = a.quantities[field]
        curves = [Curve(time, apart[:, k], name, COLOURS[k % len(COLOURS)]) for k, name in enumerate(names)]
        panels.append(Panel(over, first.topic if field == fields[0] else "", "", _axis(first, field)))
        panels.append(
            Panel([Level(0.0, colour=INK), *curves], f"{words[1]} less {words[0]}",
                  label if field == fields[-1] else "", _axis(first, field))
        )  # fmt: skip
        for k, name in enumerate(names):
            at = int(np.nanargmax(np.abs(apart[:, k]))) if np.isfinite(apart[:, k]).any() else 0
            rms = float(np.sqrt(np.nanmean(apart[:, k] ** 2))) if np.isfinite(apart[:, k]).any() else np.nan
            rows.append((quantity, name, float(abs(apart[at, k])), float(a.time[at]), rms, len(a.stamp_ns)))
    messages = tuple(len(series.stamp_ns) for series in both)
    return TopicPlot(first.topic, Plot(panels, height=_HEIGHT, share_x=True), messages, rows)


def _curves(series: JointSeries, field: str, zero: int, suffix: str = "", *, second: bool = False) -> list[Curve]:
    time, values = (series.stamp_ns - zero) / NANOSECONDS, series.fields[field]
    return [
        Curve(
            time,
            values[:, k],
            f"{name}{suffix}",
            INK if second and len(series.names) == 1 else COLOURS[k % len(COLOURS)],
            1.0 if second or not suffix else 2.0,
            "dashed" if second else "solid",
        )
        for k, name in enumerate(series.names)
    ]


def _axis(series: JointSeries, field: str) -> str:
    return series.quantities[field].replace(" [", ", ").removesuffix("]")
