"""The way of the tip, and how far it is from the path of its set-points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.chain import RigidChain
from rx90_common.description.tip import tip_position
from rx90_controller.lines.task import SETTLING
from rx90_emulator.view.bags.recording import Recording
from rx90_emulator.view.bags.track import Track, blocks

_AT_REST = 1e-4  # m/s, of the set-points: below it they have no direction of their own
PATH_ERROR = "path error"


class TipPath(NamedTuple):
    """Where the tip has been.

    Attributes:
        points: (m, 3) in the order of time, m; NaN in gaps.
        error: (m - 1,) largest path error on the way from each point to the next, m; NaN where none counts.
    """

    points: Array
    error: Array


def path_error_track(recording: Recording, chain: RigidChain) -> Track | None:
    """Return the distance of the tip from the path of its set-points under PATH_ERROR, m; None without set-points.

    It is the distance from the set-point of the same time, without its part along the path, which is the lag. It counts
    as `LineTask.counted` says of a line: while the set-points move and until the arm has settled, where their path has
    the direction of their last motion. Elsewhere it is NaN.
    """
    arm, reference = recording.arm, recording.reference
    if reference is None:
        return None
    direction, counted = _directions(reference, chain)
    error = np.empty((len(arm.time_ns), 1))
    for rows in blocks(len(arm.time_ns)):
        time_ns = arm.time_ns[rows]
        target = tip_position(chain, reference.at("position", time_ns))
        off = tip_position(chain, arm.values["position"][rows]) - target
        place = np.searchsorted(reference.time_ns, time_ns, side="right") - 1
        across = off - np.sum(off * direction[place], axis=1)[:, None] * direction[place]
        error[rows, 0] = np.where(counted[place] & (place >= 0), np.linalg.norm(across, axis=1), np.nan)
    return Track((PATH_ERROR,), arm.time_ns, {"position": error}, arm.gap_ns)


def _directions(reference: Track, chain: RigidChain) -> tuple[Array, NDArray[np.bool_]]:
    """Return the direction of the path at each set-point, shape (n, 3), and whether its path error counts, (n,)."""
    count = len(reference.time_ns)
    tips = np.empty((count, 3))
    for rows in blocks(count):
        tips[rows] = tip_position(chain, reference.values["position"][rows])
    way = np.diff(tips, axis=0, append=tips[-1:])
    length = np.linalg.norm(way, axis=1)
    moving = length > _AT_REST * np.diff(reference.time_ns, append=reference.time_ns[-1] + 1) / NANOSECONDS
    last = np.maximum.accumulate(np.where(moving, np.arange(count), -1))
    ended = reference.time_ns[np.minimum(last + 1, count - 1)]
    counted = (last >= 0) & (reference.time_ns - ended <= SETTLING * NANOSECONDS)
    return np.asarray(way[last] / np.where(length[last] > 0.0, length[last], 1.0)[:, None]), counted


def tip_path(arm: Track, error: Track | None, chain: RigidChain, pieces: int) -> TipPath:
    """Return the way of the tip in at most `pieces` pieces of equal time; of each the largest path error."""
    count = max(1, min(pieces, len(arm.time_ns) - 1))
    edges = arm.begin_ns + ((arm.end_ns - arm.begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
    points = tip_position(chain, arm.at("position", edges))
    if error is None:
        return TipPath(points, np.full(count, np.nan))
    _, values = error.envelope("position", arm.begin_ns, arm.end_ns, count)
    return TipPath(points, np.fmax(values[0::2, 0], values[1::2, 0]))
