"""Scatter: a slow random walk of Coulomb and static torque, so that runs differ as those of a real robot do.

    tau_c (1 + w), tau_s (1 + w)
    w = deviation min(max(x, -4), 4)
    x(t + T) = d x(t) + sqrt(1 - d^2) e,  d = exp(-T / correlation_time)

x is an Ornstein-Uhlenbeck walk of mean 0 and variance 1, advanced by its exact transition once in a tick T (Gillespie
1996, Exact numerical simulation of the Ornstein-Uhlenbeck process, Phys. Rev. E 54), so its autocorrelation is
exp(-|lag| / correlation_time) whatever the tick. Its start is drawn from the distribution that it keeps.

The random numbers come from a seed by SplitMix64 (Steele, Lea and Flood 2014, Fast splittable pseudorandom number
generators), whole numbers with the same bits on every machine; each element has a sequence of its own. e is the sum of
four uniform numbers of 16 bits, of mean 0 and variance 1: over a correlation time thousands of them add up, and their
sum is normal. The bound of four deviations, which w reaches for 6e-5 of the time, keeps the sliding torque
positive; passive_damping of the element is that of (1 - 4 deviation) times its sliding torque.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np

from rx90_common.base.arrays import RecordType, record_type
from rx90_common.base.errors import ConfigError
from rx90_common.base.models import Positive, quantity
from rx90_common.base.quoting import quoted
from rx90_common.friction.parts.part import (
    FrictionPart,
    Moment,
    Part,
    Present,
    Surroundings,
    scaled,
)
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.elementary import GOLDEN, exponential_less_one_of, mixed, nearly_normal
from rx90_common.kernels.lanes import Lanes, load

BOUND = 4.0
"""Largest |w| in deviations."""

LARGEST_SEED = 2**53
"""Of a seed: whole numbers up to here are exact in every file format."""


def check_seed(seed: object) -> None:
    """Refuse an invalid seed."""
    if (
        isinstance(seed, bool)
        or not isinstance(seed, int | np.integer)
        or not 0 <= seed <= LARGEST_SEED
    ):
        raise ConfigError(
            f"seed is {quoted(seed)}; accepted: a whole number from 0 to {LARGEST_SEED}"
        )


class ScatterPart(FrictionPart):
    """A slow random walk of the friction.

    The equations stand in this module's docstring.
    """

    deviation: Annotated[
        Positive,
        quantity("1", "Standard deviation, share of Coulomb and static torque.", le=0.2),
    ]
    correlation_time: Annotated[
        float, quantity("s", "Time in which the walk forgets.", ge=1e-2, le=1e7)
    ]

    @property
    def least_factor(self) -> float:
        """Return the least number that Coulomb and static torque are multiplied with."""
        return 1.0 - BOUND * self.deviation


def scatter_dtype(width: int) -> RecordType:
    """Return the type of the constants; the deviation is 0 where the part is off."""
    return record_type(seed=np.uint64, deviation=width, decay=width, kick=width)


def scatter_state_dtype(width: int) -> RecordType:
    """Return the type of the state; the factor is what Coulomb and static torque are multiplied with."""
    return record_type(("counter", np.uint64, (width,)), walk=width, factor=width)


def fill_scatter(record: Any, e: int, part: ScatterPart, surroundings: Surroundings) -> None:
    """Write the constants of element e."""
    ticks = surroundings.period / part.correlation_time
    record["seed"] = surroundings.seed
    record["deviation"][e] = part.deviation
    record["decay"][e] = 1.0 + exponential_less_one_of(-ticks)
    record["kick"][e] = math.sqrt(-exponential_less_one_of(-2.0 * ticks))


@inlined
def _draw(walks: Any, element: int) -> float:
    """Return the next random number of an element: of mean 0 and variance 1, within 3.5."""
    walks.counter[element] += GOLDEN
    return nearly_normal(mixed(walks.counter[element]))


@inlined
def start_scatter(parts: Any, state: Any, transmitted: Lanes, _step: float, width: int) -> Lanes:
    """Draw where the walks begin, always the same for a seed."""
    walks = state.scatter
    for i in range(width):
        walks.counter[i] = mixed(parts.scatter.seed + mixed(np.uint64(i + 1) * GOLDEN))
        total = 0.0
        for _ in range(4):  # sixteen uniform numbers are normal as far as four deviations
            total += _draw(walks, i)
        walks.walk[i] = 0.5 * total
        walks.factor[i] = _factor(parts.scatter, walks, i)
    return transmitted


@inlined
def advance_scatter(parts: Any, state: Any, transmitted: Lanes, _step: float, width: int) -> Lanes:
    """Advance the walks by a tick."""
    part = parts.scatter
    walks = state.scatter
    for i in range(width):
        if part.deviation[i] > 0.0:
            walks.walk[i] = part.decay[i] * walks.walk[i] + part.kick[i] * _draw(walks, i)
            walks.factor[i] = _factor(part, walks, i)
    return transmitted


@inlined
def _factor(part: Any, walks: Any, element: int) -> float:
    """Return the number that Coulomb and static torque of an element are multiplied with."""
    walk: float = min(max(walks.walk[element], -BOUND), BOUND)
    return 1.0 + walk * float(part.deviation[element])


@inlined
def scattered(_parts: Any, state: Any, present: Present, _moment: Moment, width: int) -> Present:
    """Scale Coulomb and static torque."""
    return scaled(present, load(state.scatter.factor, width))


SCATTER = Part(
    (ScatterPart,),
    scatter_dtype,
    fill_scatter,
    state=scatter_state_dtype,
    present=scattered,
    settle=start_scatter,
    tick=advance_scatter,
)
