"""A page with plots of a bag, or of two over each other: the fields of their topics against time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bokeh.plotting import figure

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import read_joint_bag
from rx90_common.bags.recorded import time_shift
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.page import render_page
from rx90_common.report.style import COLOURS

USUAL = ("/joint_states", "/friction_states", "/rx90_controller/tracking_error")
"""What is drawn unless topics are chosen."""
_HEIGHT = 140
_WIDE = 3.5  # pixels, of the line below another one


def plot_bags(
    paths: Sequence[Path],
    topics: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    align: int | str = 0,
    mapping: LogMapping | None = None,
) -> dict[str, list[figure]]:
    """Return the figures of each topic of one bag, or of two over each other.

    Args:
        paths: one bag or two.
        topics: of joint states; by default those of USUAL that the bags have.
        joints: names; by default all.
        align: moves the stamps of the second bag, as in `compare_bags`.
        mapping: of the columns of tables; by default the files beside them.
    """
    wanted = USUAL if topics is None else topics
    bags = [
        read_joint_bag(path, wanted, mapping=mapping, all_there=topics is not None)
        for path in paths
    ]
    if len(bags) > 1:
        bags[1] = bags[1].moved(time_shift(align, *bags))
    names = [name for name in bags[0].series if all(bag.series.get(name) for bag in bags)]
    if not names:
        raise BagError(
            f"{listed(paths)}: nothing of {listed(wanted)}; accepted: --topic, with joint states of all"
        )
    labels = [path.name for path in paths]
    if len(set(labels)) < len(labels):
        labels = [str(path) for path in paths]
    figures = {}
    for name in names:
        recorded = [bag.one(name, joints) for bag in bags]
        figures[name] = _figures(dict(zip(labels, recorded, strict=True)))
    return figures


def plot_page(paths: Sequence[Path], figures: Mapping[str, Sequence[figure]]) -> str:
    """Return the text of the page with these figures of one bag or two."""
    title = (
        f"{' against '.join(path.resolve().name for path in reversed(paths))}: {listed(figures)}"
    )
    return render_page("rx90_common.bags", "bag.html.j2", title=title, paths=paths, topics=figures)


def _figures(recorded: Mapping[str, JointSeries]) -> list[figure]:
    """Return a figure for each field that all have; the lines of the second lie over wide ones of the first."""
    first = next(iter(recorded.values()))
    every = recorded.values()
    names = [name for name in first.names if all(name in series.names for series in every)]
    fields = [
        field
        for field in first.fields
        if all(series.units[field] == first.units[field] for series in every)
    ]
    if not names:
        raise BagError(
            f"{plain(first.topic)}: no joint is in both bags; accepted: bags with the same joints"
        )
    start = int(first.stamp_ns[0])
    figures = []
    for field in fields:
        shown = chart(
            "", "", first.quantities[field].replace(" [", ", ").removesuffix("]"), height=_HEIGHT
        )
        figures.append(shown)
        for bag, series in recorded.items():
            time = (series.stamp_ns - start) / NANOSECONDS
            width = _WIDE if series is first and len(recorded) > 1 else 1.0
            for k, joint in enumerate(names if field in series.fields else ()):
                name = plain(f"{joint}, {bag}" if len(recorded) > 1 else joint)
                values = series.fields[field][:, series.names.index(joint)]
                shown.line(
                    time, values, name=name, color=COLOURS[k % len(COLOURS)], line_width=width
                )
    over_one_x(figures, f"time since {start / NANOSECONDS:.9f} s, s" if start else "time, s")
    return figures
