"""What was used of each bag of sweeps, and why the rest was not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_emulator.identification.records.record import BagSource, JointRecord

USED = "used"
RESTS = "at rest"
CHANGES = "changes of velocity"
ACCELERATES = "steady acceleration or a crest"
SETTLES = "settling"
SHORT = "too short"
LITTLE_TRAVEL = "travel of less than 10 mrad"
UNSTEADY = "blocks of another velocity"
REASONS = (CHANGES, RESTS, LITTLE_TRAVEL, SETTLES, SHORT, ACCELERATES, UNSTEADY, USED)
"""What a sample was used for, or why not."""
RESTS_TRAVEL = 1e-3
"""Travel below which nothing moves, rad."""
_SHOWN = 0.05  # s: shorter times are not listed
_NOTED = 0.5  # s from which a stretch that was not used tells of a speed that is lacking


@dataclass(frozen=True, eq=False)
class BagUse:
    """What was used of one bag of sweeps.

    Attributes:
        bag: the bag.
        stretches: of constant velocity that were used.
        seconds: in these.
        speeds: rad/s, of each element the slowest and the fastest that was used, 0 without any, shape (n_el, 2).
        left_out: seconds by the reason for which they were not used.
        unused: mean speeds of the elements, rad/s, in stretches that were not used, shape (u, n_el); 0 at rest.
    """

    bag: BagSource
    stretches: int
    seconds: float
    speeds: Array
    left_out: Mapping[str, float]
    unused: Array

    @classmethod
    def of(cls, record: JointRecord, elements: Array, state: NDArray[np.intp], velocities: Sequence[Array]) -> BagUse:
        """Return the account of a record.

        Args:
            record: whose account it is.
            elements: E, joint velocities to input velocities of the friction elements, shape (n_el, n).
            state: of each sample, its place in REASONS, shape (m,).
            velocities: of each stretch's blocks, the elements' where they slide, 0 elsewhere, rad/s, shape (b, n_el).
        """
        period = float(np.median(np.diff(record.time))) if len(record.time) > 1 else 0.0
        speeds = np.zeros((len(elements), 2))
        for e in range(len(elements)):
            mine = [abs(float(v[:, e].mean())) for v in velocities if v[:, e].any()]
            if mine:
                speeds[e] = min(mine), max(mine)
        seconds = {why: float(np.sum(state == k)) * period for k, why in enumerate(REASONS)}
        used = seconds.pop(USED)
        lacking = ~np.isin(state, [REASONS.index(why) for why in (USED, RESTS, SETTLES)])
        edges = np.flatnonzero(np.diff(lacking, prepend=False, append=False)).reshape(-1, 2)
        unused = np.zeros((0, len(elements)))
        for begin, end in edges.tolist():
            lasted = float(record.time[end - 1] - record.time[begin])
            travel = np.abs(elements @ (record.position[end - 1] - record.position[begin]))
            if lasted >= _NOTED and travel.max() > RESTS_TRAVEL:
                unused = np.vstack([unused, np.where(travel > RESTS_TRAVEL, travel / lasted, 0.0)])
        return cls(record.bag, len(velocities), used, speeds, seconds, unused)

    def text(self, names: Sequence[str]) -> str:
        """Return it as a line.

        Args:
            names: of the elements.
        """
        ranges = [
            f"{name} {low:.3g}" + (f" to {high:.3g}" if f"{low:.3g}" != f"{high:.3g}" else "")
            for name, (low, high) in zip(names, self.speeds.tolist(), strict=True)
            if high
        ]
        used = (
            f"{self.seconds:.3g} s in {self.stretches} stretches, {', '.join(ranges)} rad/s"
            if self.stretches
            else "NOTHING"
        )
        rest = ", ".join(f"{seconds:.3g} s {reason}" for reason, seconds in self.reasons)
        return f"used {used}" + (f"; left out {rest}" if rest else "")

    @property
    def reasons(self) -> list[tuple[str, float]]:
        """Return why how many seconds were not used, the most first."""
        return sorted(((why, s) for why, s in self.left_out.items() if s >= _SHOWN), key=lambda pair: -pair[1])


def unused_speeds(usage: Sequence[BagUse], element: int, slowest: float) -> Array:
    """Return the speeds of an element below the slowest one that was used, rad/s, sorted, shape (k,)."""
    speeds = np.sort(np.concatenate([np.zeros(0), *(use.unused[:, element] for use in usage)]))
    return np.asarray(speeds[(speeds > 0.0) & (speeds < slowest)])
