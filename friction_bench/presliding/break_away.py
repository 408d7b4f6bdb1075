"""Break-away against the rate of the torque: the largest friction before the joint slides, from ramps of many rates.

Friction is the motor's torque less what accelerates the joint, so that inertia does not pass for friction; what is
left of a rate's influence is the law's. LuGre's break-away torque falls with the rate (Canudas de Wit and others 1995):
the joint is fast before its bristles are bent. Damping of the bristles, c1 rate / c0, raises it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_bench.presliding.trace import Trace
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError

RATES = (0.1, 0.4, 1.6, 6.0, 16.0)
"""Codes a tick."""
REPEATS = 3
_AVERAGED = 0.1
"""Rise of the torque, Nm, over which friction is averaged against the counts' noise, up to MOST_AVERAGED readings."""
_MOST_AVERAGED = 5


@dataclass(frozen=True, eq=False)
class BreakAway:
    """Break-away by rate.

    Attributes:
        rate: Nm/s at the joint, of each ramp, shape (n,).
        torque: of break-away, Nm, shape (n,).
    """

    rate: Array
    torque: Array

    def by_rate(self) -> tuple[Array, Array, Array]:
        """Return each rate, Nm/s, the mean of its torques, and their standard error, Nm."""
        rates = np.unique(self.rate)
        groups = [self.torque[self.rate == rate] for rate in rates]
        means = np.array([group.mean() for group in groups])
        errors = np.array([group.std(ddof=1) / np.sqrt(group.size) if group.size > 1 else 0.0 for group in groups])
        return rates, means, errors


def break_away_code(ramp: Trace, slid: float) -> float:
    """Return the code on the DAC when the joint has moved by half of what counts as a slide.

    Raises:
        IdentificationError: if it did not move as far.
    """
    if ramp.counts.max() < slid:
        raise IdentificationError(
            f"{ramp.label}: no break-away up to {ramp.torque.max():.3g} Nm; the joint sticks up to the motor's limit"
        )
    return float(ramp.code[int(np.argmax(ramp.counts >= 0.5 * slid))])


def evaluate_break_away(ramps: Sequence[tuple[float, Trace]], inertia: float) -> BreakAway:
    """Return break-away torques of ramps, each with its rate in codes a tick.

    Args:
        ramps: rates and readings.
        inertia: at the joint, kg m^2.
    """
    rate, torque = [], []
    for codes, ramp in ramps:
        per_second = codes * ramp.torque_step / ramp.tick
        rate.append(per_second)
        torque.append(_largest_friction(ramp, inertia, per_second))
    return BreakAway(np.array(rate), np.array(torque))


def _largest_friction(ramp: Trace, inertia: float, rate: float) -> float:
    rising = int(np.argmax(ramp.code))  # later readings belong to the slide's end
    angle, held = ramp.angle[: rising + 1], ramp.held[: rising + 1]
    acceleration = (angle[2:] - 2.0 * angle[1:-1] + angle[:-2]) / ramp.tick**2
    friction = 0.5 * (held[2:] + held[1:-1]) - inertia * acceleration
    count = int(np.clip(round(_AVERAGED / (rate * ramp.tick)), 1, _MOST_AVERAGED))
    return float(np.convolve(friction, np.full(count, 1.0 / count), "valid").max())
