"""The way of the tip, and how far it is from the path of its set-points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.chain import RigidChain
from rx90_common.description.tip import tip_position
from rx90_emulator.view.bags.recording import Recording
from rx90_emulator.view.bags.track import Track

_BLOCK = 1 << 14  # samples at once
_AT_REST = 1e-3  # m/s, of the set-points: below it a path has no direction
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

    The part of the distance along the path, the lag, is no error of the path; where the set-points rest, all of it is.
    """
    arm, reference = recording.arm, recording.reference
    if reference is None:
        return None
    error = np.empty((len(arm.time_ns), 1))
    for start in range(0, len(arm.time_ns), _BLOCK):
        rows = slice(start, start + _BLOCK)
        error[rows, 0] = _distances(arm, reference, rows, chain)
    return Track((PATH_ERROR,), arm.time_ns, {"position": error}, arm.gap_ns)


def _distances(arm: Track, reference: Track, rows: slice, chain: RigidChain) -> Array:
    time_ns = arm.time_ns[rows]
    target = tip_position(chain, reference.at("position", time_ns))
    off = tip_position(chain, arm.values["position"][rows]) - target
    # The direction from one set-point to the next, both really sent.
    before = np.clip(np.searchsorted(reference.time_ns, time_ns, side="right") - 1, 0, len(reference.time_ns) - 2)
    step = (reference.time_ns[before + 1] - reference.time_ns[before]) * 1e-9
    ends = [tip_position(chain, reference.values["position"][before + k]) for k in range(2)]
    velocity = (ends[1] - ends[0]) / step[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    direction = np.where(speed > _AT_REST, 1.0, 0.0)[:, None] * velocity / np.maximum(speed, _AT_REST)[:, None]
    along = np.sum(off * direction, axis=1)[:, None]
    return np.asarray(np.linalg.norm(off - along * direction, axis=1))


def tip_path(arm: Track, error: Track | None, chain: RigidChain, pieces: int) -> TipPath:
    """Return the way of the tip in at most `pieces` pieces of equal time; of each the largest path error."""
    count = max(1, min(pieces, len(arm.time_ns) - 1))
    edges = arm.begin_ns + ((arm.end_ns - arm.begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
    points = tip_position(chain, arm.at("position", edges))
    if error is None:
        return TipPath(points, np.full(count, np.nan))
    _, values = error.envelope("position", arm.begin_ns, arm.end_ns, count)
    return TipPath(points, np.fmax(values[0::2, 0], values[1::2, 0]))
