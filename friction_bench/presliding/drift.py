"""Elasto-plastic or LuGre: how far a joint drifts under ten thousand small cycles of torque below break-away.

A LuGre joint under a torque that changes slowly between `low` and `high`, both below its static torque F_s, goes on in
each cycle, for its bristles give way on the way up by more than on the way down. With a = high / F_s, b = low / F_s and
the deflection g = F_s / c0, dx = dz / (1 - z / g) up and dz / (1 + z / g) down give

    drift of a cycle   d = g ln((1 - b^2) / (1 - a^2))
    swing, downwards   s = g ln((1 + a) / (1 + b))

so that d / s does not depend on the stiffness: what LuGre's law says is known from the break-away torque alone. An
elasto-plastic joint is purely elastic up to its break-away deflection, and blocks of Maxwell slip close their loops:
both have d = 0. The drift of many cycles adds up to counts where that of one, and the swing, are far below a count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import stats

from friction_bench.presliding.motions import Trace
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError

LOW, HIGH = 0.05, 0.25
"""Of the break-away torque: the turning points of the cycles."""
HALF = 3
"""Ticks for each half of a cycle."""
BLOCKS = 20
"""Of cycles, whose drifts are compared."""
_UNCERTAIN = 0.25
"""Relative uncertainty of the break-away torque as a measure of LuGre's static torque."""
_NONE = 0.2
"""Of LuGre's drift: what is less is none."""
_LEAST_SWING = 1.5
"""Counts of a swing that is seen."""


class DriftVerdict(str, Enum):
    """What the drift says."""

    DRIFTS = "LuGre"
    STAYS = "no drift: elasto-plastic or Maxwell slip, not LuGre"
    UNKNOWN = "cannot tell"


@dataclass(frozen=True, eq=False)
class DriftResult:
    """What the cycles showed, in counts.

    Attributes:
        position: at the end of each cycle, counts, shape (n,).
        swing: of a cycle, counts.
        drift: of a cycle, counts, and the bounds of its 99 % interval.
        expected: drift over swing by LuGre's law, least and largest by the uncertainty of the break-away torque.
        low, high: turning points over the break-away torque.
        verdict, reason: what follows, and why.
    """

    position: Array
    swing: float
    drift: tuple[float, float, float]
    expected: tuple[float, float]
    low: float
    high: float
    verdict: DriftVerdict
    reason: str

    @property
    def by_lugre(self) -> tuple[float, float] | None:
        """Return the drift of a cycle by LuGre's law, counts, least and largest; None where no swing is seen."""
        return (self.expected[0] * self.swing, self.expected[1] * self.swing) if self.swing > 0.0 else None


def _verdict(swing: float, least: float, largest: float, lowest: float, highest: float) -> tuple[DriftVerdict, str]:
    """Return the verdict and its reason, from the drift's bounds and those of LuGre's drift over swing.

    The swing is the mean of differences of whole counts: a joint that drifts passes all phases of a count, and the
    mean is right; one that stays may be off by a count.
    """
    if largest < _NONE * lowest * (swing - 1.0) and swing >= _LEAST_SWING:
        return DriftVerdict.STAYS, f"the drift is less than {100 * _NONE:g} % of what LuGre's law would give"
    if least > 0.0 and swing > 0.0 and 0.5 * lowest < least / swing and largest / swing < 2.0 * highest:
        return DriftVerdict.DRIFTS, "the joint drifts as LuGre's law says"
    if swing < _LEAST_SWING and least <= 0.0:
        reason = "neither a swing nor a drift is seen: the joint is too stiff for the encoder"
    elif largest / max(swing, 1e-9) > 2.0 * highest:
        reason = "the joint drifts more than LuGre's law says: the torque is too near to break-away"
    else:
        reason = "the joint drifts, but less than LuGre's law says"
    return DriftVerdict.UNKNOWN, reason


def turning_codes(break_away: float) -> tuple[int, int]:
    """Return the codes between which small cycles go, for a break-away code."""
    return max(round(LOW * break_away), 1), round(HIGH * break_away)


def lugre_ratio(low: float, high: float) -> float:
    """Return drift over swing of a LuGre joint for turning points over the static torque; 1 where it breaks away."""
    if high >= 1.0:
        return 1.0
    return math.log((1.0 - low**2) / (1.0 - high**2)) / math.log((1.0 + high) / (1.0 + low))


def evaluate_drift(trace: Trace, low: int, high: int, break_away: float) -> DriftResult:
    """Tell from the readings of the cycles whether the joint drifts as LuGre's law says.

    Args:
        trace: the whole experiment.
        low: code of the lower turning point.
        high: of the upper one.
        break_away: code at which the joint breaks away.

    Raises:
        IdentificationError: if there are too few cycles.
    """
    code = trace.code
    last = np.flatnonzero(np.diff(code) != 0.0)  # the last reading of each code
    at_low = last[(code[last] == low) & (code[last + 1] == high)]
    at_high = last[code[last] == high]
    at_high = at_high[at_high > at_low.min(initial=code.size)]
    count = min(at_low.size, at_high.size)
    if count < 2 * BLOCKS:
        raise IdentificationError(f"{trace.label}: {count} cycles; accepted: at least {2 * BLOCKS}")
    lower, upper = trace.counts[at_low[:count]], trace.counts[at_high[:count]]
    per = count // BLOCKS
    ends = lower[: per * BLOCKS + 1 : per] if count > per * BLOCKS else np.append(lower[::per][:BLOCKS], lower[-1])
    drifts = np.diff(ends) / per
    reach = float(stats.t.ppf(0.995, BLOCKS - 1) * stats.sem(drifts)) + 1.0 / count  # a count of the whole is not known
    drift = float(ends[-1] - ends[0]) / (per * BLOCKS)
    a, b = high / break_away, low / break_away
    least, largest = (lugre_ratio(b * part, a * part) for part in (1 - _UNCERTAIN, 1 + _UNCERTAIN))
    swing = float(np.mean(upper[:-1] - lower[1:]))
    verdict = _verdict(swing, drift - reach, drift + reach, least, largest)
    return DriftResult(lower, swing, (drift, drift - reach, drift + reach), (least, largest), b, a, *verdict)
