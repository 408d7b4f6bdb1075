"""What the stamps of one of two bags are moved by, so that the two can be laid over each other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.trajectories import read_trajectories

START = "start"
TRAJECTORY = "trajectory"


class Begins(Protocol):
    """A bag as far as it was read, that knows when it begins."""

    @property
    def path(self) -> Path:
        """Return its path."""

    @property
    def begin_ns(self) -> int:
        """Return its first stamp, ns; raises BagError if there is none."""


def time_shift(align: int | str, first: Begins, second: Begins) -> int:
    """Return what to add to the stamps of the second of two bags, ns; `align` as in `Scope`.

    Raises:
        BagError: if a bag has no trajectory, for TRAJECTORY, or no message, for START.
    """
    if isinstance(align, int):
        return align
    if align == TRAJECTORY:
        return read_trajectories(first.path)[-1].start_ns - read_trajectories(second.path)[-1].start_ns
    return first.begin_ns - second.begin_ns


def moved(series: dict[str, list[JointSeries]], shift_ns: int) -> dict[str, list[JointSeries]]:
    """Return the series with stamps that much later, ns."""
    if not shift_ns:
        return series
    return {topic: [replace(one, stamp_ns=one.stamp_ns + shift_ns) for one in found] for topic, found in series.items()}
