"""How two recordings differ along time: each joint, and the tip of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain
from rx90_common.description.chain import RigidChain
from rx90_common.description.tip import tip_position
from rx90_emulator.view.bags.times import seconds
from rx90_emulator.view.bags.track import Track, blocks

TIP = "tip"


class Worst(NamedTuple):
    """A largest absolute difference, with its sign, and its time."""

    value: float
    time_ns: int


@dataclass(frozen=True, eq=False)
class Difference:
    """The second recording less the first, at the stamps of the first that both cover.

    Attributes:
        joints: position, rad, of each joint; nothing in gaps of the second.
        tip: position, the distance of both tips, m, under the name TIP.
        exact: share of the stamps at which the second has a sample of its own; at the others the line between two is
            taken.
    """

    joints: Track
    tip: Track
    exact: float

    @property
    def worst_joints(self) -> tuple[Worst, ...]:
        """Return the largest difference of each joint."""
        return tuple(_worst(self.joints, column) for column in range(len(self.joints.names)))

    @property
    def worst_tip(self) -> Worst:
        """Return the largest distance of the tips."""
        return _worst(self.tip, 0)


def difference(first: Track, second: Track, chain: RigidChain, paths: tuple[Path, Path]) -> Difference:
    """Compare the positions of two tracks of one arm; the second's times are already moved to the first's.

    Raises:
        BagError: if they have no time in common outside of gaps.
    """
    begin, end = max(first.begin_ns, second.begin_ns), min(first.end_ns, second.end_ns)
    low, high = np.searchsorted(first.time_ns, begin), np.searchsorted(first.time_ns, end, side="right")
    time_ns = first.time_ns[low:high]
    joints, tip = np.empty((len(time_ns), len(first.names))), np.empty((len(time_ns), 1))
    for rows in blocks(len(time_ns)):
        one, other = first.values["position"][low:high][rows], second.at("position", time_ns[rows])
        joints[rows] = other - one
        tip[rows, 0] = np.linalg.norm(tip_position(chain, other) - tip_position(chain, one), axis=1)
    known = np.isfinite(tip[:, 0])
    if not known.any():
        spans = " and ".join(
            f"{plain(path)} from {seconds(track.begin_ns)} to {seconds(track.end_ns)} s"
            for path, track in zip(paths, (first, second), strict=True)
        )
        raise BagError(f"{spans} have no time in common; accepted: --align start, trajectory, or a time in s")
    if not known.all():
        time_ns, joints, tip = time_ns[known], joints[known], tip[known]
    exact = float(np.isin(time_ns, second.time_ns, assume_unique=True).mean())
    return Difference(
        Track(first.names, time_ns, {"position": joints}, first.gap_ns),
        Track((TIP,), time_ns, {"position": tip}, first.gap_ns),
        exact,
    )


def _worst(track: Track, column: int) -> Worst:
    values: Array = track.values["position"][:, column]
    row = int(np.argmax(np.abs(values)))
    return Worst(float(values[row]), int(track.time_ns[row]))
