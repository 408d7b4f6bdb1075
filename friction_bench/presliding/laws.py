"""The experiments as laws of torque: what is on the DAC from tick to tick. Codes are those of the DAC.

Torque goes one way only, from zero to the motor's limit: a motion is turned round by taking torque away, and it is the
bent bristles that drive it back. So loops lie between zero and break-away, and no sliding joint is reversed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from friction_bench.presliding.follow import Law
from friction_bench.rig.client import Sample
from rx90_common.base.errors import IdentificationError

DWELL = 4
"""Ticks for which a torque is held in loops: the joint has come to rest at their end."""
_STILL = 15
"""Ticks for which a joint that slid is left alone, without torque."""
_SLIDE = 8e-3
"""How far the joint slides before an experiment, rad: beyond any presliding, so that it forgets what was before."""


def _higher(code: int, limit: int) -> int:
    """Return the next code for a joint that does not move yet.

    Raises:
        IdentificationError: if there is none: the joint broke away before, and does not any more.
    """
    if code >= limit:
        raise IdentificationError(f"the joint sticks at the highest code, {limit}, though it slid on the ramps")
    return code + 1


def slide_once(start: int, counts: float, limit: int) -> Law:
    """Raise the torque from `start` by a code a tick until the joint has moved by so many counts; then take it away.

    Raises:
        IdentificationError: if it has not at `limit`.
    """
    code = start
    first = yield code
    while (yield code).counts - first.counts < counts:
        code = _higher(code, limit)
    for _ in range(_STILL):
        yield 0


def ramp(rate: float, counts: float, limit: int) -> Law:
    """Raise the torque by `rate` codes a tick until the joint has moved by so many counts, or up to `limit`."""
    first = yield 0
    ticks = code = 0
    while code < limit:
        ticks += 1
        code = min(round(ticks * rate), limit)
        if (yield code).counts - first.counts >= counts:
            break
    for _ in range(_STILL):
        yield 0


def slide_counts(step: float) -> float:
    """Return the counts of a slide, for counts of `step` rad."""
    return _SLIDE / step


def loops(start: int, counts: float, limit: int, levels: Sequence[int], stride: int) -> Law:
    """Slide once, then go from level to level in strides of so many codes, each held for DWELL ticks."""
    yield from slide_once(start, counts, limit)
    code = 0
    for level in levels:
        while code != level:
            code += max(-stride, min(stride, level - code))
            for _ in range(DWELL):
                yield code


def cycles(start: int, counts: float, limit: int, low: int, high: int, half: int, number: int) -> Law:
    """Slide once, go up to `low`, then change between `high` and `low`, each for `half` ticks, so many times."""
    yield from slide_once(start, counts, limit)
    yield from _staircase(0, low)
    for _ in range(number):
        for code in (high, low):
            for _ in range(half):
                yield code


def _staircase(first: int, last: int) -> Law:
    for code in range(first, last + 1):
        for _ in range(2):
            yield code


class Rounding:
    """Rounds torques to codes so that the errors do not add up: each is carried to the next code."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._carried = 0.0

    def __call__(self, code: float) -> int:
        """Return the whole code; beyond the amplifier's range its end."""
        wanted = min(max(code + self._carried, 0.0), float(self._limit))
        whole = round(wanted)
        self._carried = wanted - whole
        return whole


def speeds(start: int, wanted: Sequence[float], ticks: int, gain: float, limit: int, tick: float) -> Law:
    """Hold one speed after the other, each for so many ticks, by a PI loop on the counts.

    Args:
        start: a code at which the joint does not slide yet.
        wanted: speeds, counts per tick.
        ticks: for each of them.
        gain: proportional gain, codes for a count per tick; the integral's time is INTEGRAL.
        limit: the highest code.
        tick: s.

    Raises:
        IdentificationError: if the joint does not move at `limit`.
    """
    rounding = Rounding(limit)
    code = start
    sample = yield code
    while True:
        before, sample = sample, (yield code)
        if sample.counts - before.counts >= wanted[0]:
            break
        code = _higher(code, limit)
    integral = float(code)
    for speed in wanted:
        for _ in range(ticks):
            error = speed - (sample.counts - before.counts) / (sample.tick - before.tick)
            integral += gain * error * tick / INTEGRAL
            before, sample = sample, (yield rounding(integral + gain * error))


INTEGRAL = 0.25
"""Time of the integral of the speed's loop, s."""


def pulled(stiffness: float, speed: float, ticks: int, limit: int, preload: float) -> Law:
    """Pull the joint by a spring whose other end moves at a steady speed; the host computes the spring.

    Args:
        stiffness: codes for a count.
        speed: counts per tick.
        ticks: how long.
        limit: the highest code.
        preload: code at the beginning.
    """
    rounding = Rounding(limit)
    sample = yield 0
    first: Sample = sample
    end = preload / stiffness
    for _ in range(ticks):
        end += speed
        stretch = end - (sample.counts - first.counts)
        sample = yield rounding(stiffness * stretch)


def loop_levels(break_away: int, kind: int) -> list[int]:
    """Return the torques between which a block of loops turns round, below break-away: large loops with inner ones.

    The inner ones begin and end at the same torque, so that a law with a memory of its own closes them there.
    """
    shares = (
        (0.85, 0.25, 0.6, 0.25, 0.85, 0.0),
        (0.8, 0.1, 0.5, 0.3, 0.5, 0.1, 0.8, 0.0),
        (0.9, 0.4, 0.75, 0.4, 0.9, 0.0),
        (0.5, 0.0, 0.3, 0.1, 0.3, 0.0, 0.7, 0.0),
        (0.75, 0.5, 0.65, 0.5, 0.88, 0.0, 0.4, 0.0),
    )
    return [math.floor(share * break_away) for share in shares[kind % len(shares)]]
