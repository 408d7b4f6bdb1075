"""Both directions of a bipolar rig: f_c and f_v of each, their difference, and the lag of a torque through zero.

Backward ramps are evaluated as forward ones, counted the other way. A swing is a torque that goes up and down between
both ends without a pause: its sliding stretches give f_c, f_v and J of each direction once more, now also with falling
torque, so that one slope determines J; and the zero crossings give the lag time until the shaft moves the other way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from friction_bench.experiment.identification import (
    IntervalEstimate,
    RampFriction,
    RampIdentification,
    RampTestResult,
    UnphysicalError,
    difference,
    evaluate,
    interval,
)
from friction_bench.experiment.record import (
    EARLIER_TICKS,
    MIN_READINGS,
    ONSET_TICKS,
    RampModel,
    RampRecord,
    SlidingWindow,
    fit_break_away,
    sliding_from,
)
from friction_bench.experiment.sliding_fit import fit_sliding
from friction_bench.rig.rig_file import Rig
from rx90_common.base.errors import IdentificationError

WAYS = ("forward", "backward")


class Half(NamedTuple):
    """The stretch of a swing with torque of one sign, counted in its direction.

    Attributes:
        record: all of the swing; angle and torques are positive in this direction.
        backward: the direction.
        first: the first reading with this torque.
        peak: the reading with the largest torque.
        stopped: the reading from which the shaft no longer slides the other way.
        low: the reading after which it slides this way; between the two, joints bend and spring back.
        top: the reading with the largest angle.
    """

    record: RampRecord
    backward: bool
    first: int
    peak: int
    stopped: int
    low: int
    top: int


@dataclass(frozen=True)
class SwingResult:
    """Results of the swings under one load; pairs are of WAYS.

    Attributes:
        friction: from the sliding stretches.
        difference: forward less backward, of f_c, Nm, and f_v, Nm s/rad.
        lags: mean lag time, s, and the torque then, Nm; None without a reversal to that direction.
        times: lag time of each reversal to that direction, s.
    """

    friction: tuple[RampFriction, RampFriction]
    difference: tuple[IntervalEstimate, IntervalEstimate]
    lags: tuple[tuple[IntervalEstimate, ...] | None, ...]
    times: tuple[list[float], list[float]]


@dataclass(frozen=True)
class Measurement:
    """The result of a measurement, in one direction or in both.

    Attributes:
        sides: forward and backward, by the ramps; one of them where the other carries no estimate, or was not run.
        differences: f_c and f_v forward less backward by the ramps, by load.
        swings: by load.
        records: of the swings.
        failures: why a direction or the swings of a load carry nothing, one line each.
    """

    sides: list[RampTestResult]
    differences: dict[str, tuple[IntervalEstimate, IntervalEstimate]] = field(default_factory=dict)
    swings: dict[str, SwingResult] = field(default_factory=dict)
    records: dict[str, list[RampRecord]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    @property
    def parts(self) -> dict[str, RampIdentification]:
        """Return the identified loads of all directions, by name."""
        return {name: part for side in self.sides for name, part in side.parts}

    @property
    def unphysical(self) -> list[str]:
        """Return the invalid values among the estimates: value, cause and remedy."""
        return [text for side in self.sides for text in side.unphysical]


def halves(record: RampRecord) -> list[Half]:
    """Return the stretches of a swing with torque of one sign, in the order of time."""
    assert record.torque is not None  # it is a swing by its torque
    sign = np.sign(record.torque)
    known = np.flatnonzero(sign)
    sign = sign[known[np.maximum(np.searchsorted(known, np.arange(sign.size), "right") - 1, 0)]]
    edges = [0, *(np.flatnonzero(np.diff(sign)) + 1).tolist(), sign.size]
    found: list[Half] = []
    for first, last in pairwise(edges):
        way = float(sign[first])
        counted = record.counted(way)
        angle = counted.angle
        peak = first + int(np.argmax(counted.torque[first:last]))  # type: ignore[index]  # it has one
        before = found[-1].peak if found else 0
        turning = angle[before : peak + 1] - angle[before : peak + 1].min()
        resting = np.flatnonzero(turning < sliding_from(record))
        stopped, low = before + int(resting[0]), before + int(resting[-1])
        beyond = edges[edges.index(last) + 1] if last < sign.size else last
        top = low + int(np.argmax(angle[low:beyond]))
        found.append(Half(counted, way < 0.0, first, peak, stopped, low, top))
    return found


def _windows(half: Half) -> list[SlidingWindow]:
    """Return where the shaft slides, with rising and with falling torque: the largest velocity ends the first one."""
    record, reach = half.record, sliding_from(half.record)
    angle = record.angle - record.angle[half.low]
    motion = np.arange(half.low, half.top + 1)
    sliding = motion[(angle[motion] >= reach) & (angle[half.top] - angle[motion] >= reach)]
    parts = (sliding[sliding <= half.peak], sliding[sliding >= half.peak])
    assert record.torque is not None
    return [
        SlidingWindow(record, record.time[part], angle[part], record.torque[part])
        for part in parts
        if part.size >= MIN_READINGS
    ]


def _friction(swings: Sequence[Sequence[Half]], scale: float) -> RampFriction:
    """Fit f_c, f_v and J to the sliding stretches of one direction, by swing: stretches of one swing are no repeats.

    Raises:
        IdentificationError: if there are none, or the result is not physical.
    """
    windows, runs = [], list[int]()
    for halves_of_one in swings:
        found = [window for half in halves_of_one for window in _windows(half)]
        runs += [max(runs, default=-1) + 1] * len(found)
        windows += found
    if len(windows) < 2:
        raise IdentificationError(
            f"{len(windows)} stretches of a sliding shaft in the swings; accepted: at least 2, "
            "by a larger end torque or a smaller slope"
        )
    fit = fit_sliding(windows, runs)
    _, viscous, inertia = fit.values.tolist()
    if not (viscous > 0.0 and inertia > 0.0):
        raise UnphysicalError(
            f"the swings give a viscous friction of {viscous:.3g} Nm s/rad and an inertia of {inertia:.3g} kg m²; "
            "accepted: > 0, by more repeats"
        )
    return RampFriction.of(fit.values, fit.covariance, scale, fit.freedom)


def _lag(half: Half, friction: RampFriction) -> float:
    """Return when the shaft began to move in the torque's direction, s after the torque was zero.

    A shaft that turns where the torque exceeds f_c is carried on by its inertia, and turns at once, in the middle of
    its slow readings. Another one rests until the torque is at f_c at least: that moment is fitted to the motion.

    Raises:
        IdentificationError: if it does not slide the other way.
    """
    record, low = half.record, half.low
    assert record.torque is not None
    rising = slice(half.first, half.peak + 1)
    zero = float(np.mean(record.time[rising] + record.tick / 2 - record.torque[rising] / record.slope))
    time, coulomb = record.time - zero, friction.coulomb.value
    if half.peak - low < ONSET_TICKS:
        raise IdentificationError(f"{record.label}: the shaft does not slide after the torque's change of sign")
    reversal = float(time[low + 1])
    middle = 0.5 * (float(time[half.stopped]) + reversal)
    if record.slope * middle > coulomb:
        return middle
    assert friction.inertia is not None  # swings determine it
    model = RampModel(coulomb, friction.viscous.value, friction.inertia.value, record.slope)
    onset = slice(low - 1, low + ONSET_TICKS)
    earliest = min(max(coulomb / record.slope, reversal - EARLIER_TICKS * record.tick), reversal - record.tick)
    return fit_break_away(
        time[onset],
        record.angle[onset] - record.angle[half.first],
        (earliest, reversal),
        lambda moment: replace(model, release=moment * record.slope - coulomb),
    )


def _mean_lag(lags: Sequence[float], tick: float, slope: float, scale: float) -> tuple[IntervalEstimate, ...] | None:
    """Return the mean lag, s, and the torque then, Nm, from their scatter and the torque's steps; None without lags."""
    if not lags:
        return None
    scatter = float(np.std(lags, ddof=1)) / math.sqrt(len(lags)) if len(lags) > 1 else 0.0
    # The torque rises in steps of a tick, which are those of all reversals alike.
    mean, error = float(np.mean(lags)), math.hypot(scatter, tick / math.sqrt(12.0))
    freedom = math.inf if scatter == 0.0 else (len(lags) - 1) * (error / scatter) ** 4
    return interval(mean, error, freedom, 0.0), interval(slope * mean, slope * error, freedom, scale)


def identify_swings(records: Sequence[RampRecord], scale_uncertainty: float) -> SwingResult:
    """Identify friction of each direction and the lag times from swings of one slope.

    Args:
        records: at least one.
        scale_uncertainty: relative standard uncertainty of the torque scale, which both directions share.

    Raises:
        IdentificationError: if one direction carries no estimate.
    """
    found = [halves(record) for record in records]
    forward, backward = (
        _friction([[half for half in one if half.backward is way] for one in found], scale_uncertainty)
        for way in (False, True)
    )
    times: tuple[list[float], list[float]] = [], []
    for one in found:
        for half in one[1:]:  # the first begins at rest, and reverses nothing
            with suppress(IdentificationError):  # the swing ended before the shaft moved
                times[half.backward].append(_lag(half, backward if half.backward else forward))
    lags = tuple(_mean_lag(some, records[0].tick, records[0].slope, scale_uncertainty) for some in times)
    return SwingResult((forward, backward), difference(forward, backward, scale_uncertainty), lags, times)


def evaluate_all(records: Sequence[RampRecord], rig: Rig, as_source: bool = False) -> Measurement:
    """Evaluate ramps forward, and ramps backward and swings where there are any.

    Args:
        records: of all of them, under one load or two.
        rig: on which they were run.
        as_source: also evaluate ramps of one direction as the source does.

    Raises:
        IdentificationError: if no direction carries an estimate.
    """
    if not any(record.backward or record.swing for record in records):
        return Measurement([evaluate(records, rig, as_source)])
    found, refused = Measurement([]), list[IdentificationError]()
    for way, name in enumerate(WAYS):
        ramps = [record for record in records if not record.swing and record.backward is bool(way)]
        try:
            found.sides.append(evaluate(ramps, rig, way=name))
        except IdentificationError as error:
            refused.append(error)
            found.failures.append(f"{name}: {error}")
    if not found.sides:
        raise refused[0]
    parts = found.parts
    for load, loaded in (("no-load", False), ("loaded", True)):
        both = [parts[f"{load} {way}"].best for way in WAYS if f"{load} {way}" in parts]
        if len(both) == len(WAYS):
            found.differences[load] = difference(both[0], both[1], rig.scale_uncertainty)
        chosen = [record for record in records if record.swing and record.loaded is loaded]
        if chosen:
            found.records[load] = chosen
            try:
                found.swings[load] = identify_swings(chosen, rig.scale_uncertainty)
            except IdentificationError as error:
                found.failures.append(f"{load}, through zero: {error}")
    return found
