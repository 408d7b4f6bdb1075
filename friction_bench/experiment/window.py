"""The part of a ramp in which the shaft slides, and what makes a ramp useless."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from friction_bench.experiment.ramp_model import RampModel
from friction_bench.experiment.record import RampRecord
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError

MOVED_COUNTS = 2.0
MOVED_SHARE = 1e-3
"""Break-away is certain after two counts (one may be jitter at an edge) and this share of the ramp's angle
(presliding moves the shaft a little before)."""
SLIDING_COUNTS = 10.0
"""The shaft slides from here on: presliding ends within one or two counts."""
MIN_READINGS = 15
"""Fewest readings of a sliding shaft that say something about friction and inertia."""
ONSET_TICKS = 5
"""Break-away is fitted to this many readings after the first certain motion."""
EARLIER_TICKS = 25
"""It is sought in this many readings before that."""
SATURATION_LIMIT = 0.06
"""Relative shortfall of the measured torque that counts as saturation."""


@dataclass(frozen=True)
class SlidingWindow:
    """The readings of one ramp from where the shaft slides.

    Attributes:
        time: since the torque's zero, s, shape (n,).
        angle: since the ramp's start, rad, shape (n,).
        torque: commanded, held from each reading to the next, Nm, shape (n,).
    """

    record: RampRecord
    time: Array
    angle: Array
    torque: Array

    @property
    def first_speed(self) -> float:
        """Return the velocity at the beginning, roughly, rad/s."""
        return float((self.angle[3] - self.angle[0]) / (self.time[3] - self.time[0]))

    @property
    def last_speed(self) -> float:
        """Return the velocity at the end, roughly, rad/s."""
        return float((self.angle[-1] - self.angle[-6]) / (self.time[-1] - self.time[-6]))


def sliding_window(record: RampRecord) -> SlidingWindow:
    """Return where the shaft slides.

    Raises:
        IdentificationError: no break-away, saturation, or too few readings.
    """
    time = record.time - record.origin
    angle = record.angle - record.angle[0]
    refuse_saturated_command(record, time)
    first_motion(record, angle)
    refuse_saturated_current(record)
    first = _stays_beyond(angle, max(SLIDING_COUNTS * record.angle_step, MOVED_SHARE * angle[-1]))
    if time.size - first < MIN_READINGS:
        raise IdentificationError(
            f"{record.label}: {time.size - first} readings of a sliding shaft; "
            f"accepted: at least {MIN_READINGS}; take a slower ramp or a higher end torque"
        )
    torque = record.torque if record.torque is not None else record.slope * (time + record.tick / 2)
    return SlidingWindow(record, time[first:], angle[first:], torque[first:])


def break_away(record: RampRecord, model: RampModel) -> float:
    """Return the time of break-away, s: the closed form of a release, fitted to the first readings of the motion.

    Args:
        record: the ramp.
        model: with the identified friction and inertia; friction is taken to fall to f_c at once.
    """
    time, angle = record.time - record.origin, record.angle - record.angle[0]
    first = first_motion(record, angle)
    onset = slice(max(first - 2, 0), first + ONSET_TICKS)

    def misfit(moment: float) -> float:
        released = replace(model, release=moment * model.slope - model.coulomb)
        return float(np.sum((released.angle(time[onset]) - angle[onset]) ** 2))

    latest = float(time[first])
    earliest = min(max(model.coulomb / model.slope, latest - EARLIER_TICKS * record.tick), latest - record.tick)
    return float(minimize_scalar(misfit, bounds=(earliest, latest), method="bounded").x)


def _stays_beyond(angle: Array, threshold: float) -> int:
    """Return the index of the first reading after which the angle never is below a threshold."""
    return int(np.argmax(np.logical_and.accumulate((angle >= threshold)[::-1])[::-1]))


def first_motion(record: RampRecord, angle: Array) -> int:
    """Return the index of the first reading after which the shaft never is back at its start.

    Raises:
        IdentificationError: if it never leaves its start, or does so before the first reading.
    """
    if angle[-1] < (MOVED_COUNTS - 0.5) * record.angle_step:
        reached = record.slope * (record.time[-1] - record.origin)
        raise IdentificationError(f"{record.label}: no break-away up to {reached:.3g} Nm; raise the end torque")
    first = _stays_beyond(angle, max((MOVED_COUNTS - 0.5) * record.angle_step, MOVED_SHARE * angle[-1]))
    if first == 0:
        raise IdentificationError(f"{record.label}: the shaft moves at the first reading; a ramp starts from rest")
    return first


def refuse_saturated_command(record: RampRecord, time: Array) -> None:
    """Refuse a ramp whose commanded torque leaves its line.

    Raises:
        IdentificationError: saying where and by how much.
    """
    if record.torque is None:
        return
    middle = time + record.tick / 2
    late = np.abs(record.torque - record.slope * middle)
    allowed = max(1.5 * float(np.abs(np.diff(record.torque)).max(initial=0.0)), 2 * record.slope * record.tick)
    if late.max() > allowed:
        when = float(time[int(np.argmax(late))])
        raise IdentificationError(
            f"{record.label}: the commanded torque leaves the ramp of {record.slope:.4g} Nm/s by "
            f"{late.max():.3g} Nm at {when:.2f} s; the command saturates or the slope is wrong"
        )


def refuse_saturated_current(record: RampRecord) -> None:
    """Refuse a ramp at whose end the measured torque falls behind the command.

    Raises:
        IdentificationError: saying by how much.
    """
    n = record.time.size // 5
    if record.torque is None or record.measured_torque is None or n == 0:
        return
    # A reading is taken just before the tick at which the command changes: it belongs to the one before.
    command, measured = record.torque[:-1], record.measured_torque[1:]
    scale = float(np.sum(measured[n : 3 * n]) / np.sum(command[n : 3 * n]))
    shortfall = 1.0 - float(np.mean(measured[-n:]) / np.mean(command[-n:])) / scale
    if shortfall > SATURATION_LIMIT:
        raise IdentificationError(
            f"{record.label}: the measured torque falls {100 * shortfall:.0f} % behind the command at the "
            "ramp's end; the amplifier saturates, end the ramp earlier"
        )
