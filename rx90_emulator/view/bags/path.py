"""The way of the tip, and how far it is from the path of its set-points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.chain import RigidChain
from rx90_common.description.tip import tip_position
from rx90_emulator.view.bags.recording import Recording
from rx90_emulator.view.bags.track import Track, blocks

_AT_REST = 1e-4  # m/s, of the set-points: below it they have no direction of their own
PATH_ERROR = "path error"


class TipPath(NamedTuple):
    """Where the tip has been.

    Attributes:
        points: (m, 3) in the order of time, m; NaN in gaps.
        error: (m - 1,) largest path error on the way from each point to the next, m; NaN where it is not known.
    """

    points: Array
    error: Array


def path_error_track(recording: Recording, chain: RigidChain) -> Track | None:
    """Return the distance of the tip from the path of its set-points under PATH_ERROR, m; None without set-points.

    It is the distance from the set-point of the same time, without its part along the path, which is the lag. Where the
    set-points rest, the path has the direction in which they moved last, before their first motion that of it.
    """
    arm, reference = recording.arm, recording.reference
    if reference is None:
        return None
    direction = _directions(reference, chain)
    error = np.empty((len(arm.time_ns), 1))
    for rows in blocks(len(arm.time_ns)):
        time_ns = arm.time_ns[rows]
        target = tip_position(chain, reference.at("position", time_ns))
        off = tip_position(chain, arm.values["position"][rows]) - target
        place = np.clip(np.searchsorted(reference.time_ns, time_ns, side="right") - 1, 0, None)
        across = off - np.sum(off * direction[place], axis=1)[:, None] * direction[place]
        error[rows, 0] = np.linalg.norm(across, axis=1)
    return Track((PATH_ERROR,), arm.time_ns, {"position": error}, arm.gap_ns)


def _directions(reference: Track, chain: RigidChain) -> Array:
    """Return the direction of the path at each set-point, shape (n, 3); 0 if the tip never moves."""
    count = len(reference.time_ns)
    tips = np.empty((count, 3))
    for rows in blocks(count):
        tips[rows] = tip_position(chain, reference.values["position"][rows])
    way = np.diff(tips, axis=0, append=tips[-1:])
    length = np.linalg.norm(way, axis=1)
    moving = length > _AT_REST * np.diff(reference.time_ns, append=reference.time_ns[-1] + 1) / NANOSECONDS
    if not moving.any():
        return np.zeros((count, 3))
    last = np.maximum.accumulate(np.where(moving, np.arange(count), -1))
    place = np.where(last >= 0, last, int(np.argmax(moving)))
    return np.asarray(way[place] / length[place, None])


def tip_path(arm: Track, error: Track | None, chain: RigidChain, pieces: int) -> TipPath:
    """Return the way of the tip in at most `pieces` pieces of equal time; of each the largest path error."""
    count = max(1, min(pieces, len(arm.time_ns) - 1))
    edges = arm.begin_ns + ((arm.end_ns - arm.begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
    points = tip_position(chain, arm.at("position", edges))
    if error is None:
        return TipPath(points, np.full(count, np.nan))
    _, values = error.envelope("position", arm.begin_ns, arm.end_ns, count)
    return TipPath(points, np.fmax(values[0::2, 0], values[1::2, 0]))
