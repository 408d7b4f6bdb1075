"""Set-points at the position loop's rate: those that a bag holds, or those of its measured path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly, make_interp_spline

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_common.base.rates import NANOSECONDS
from rx90_emulator.identification.excitation.filtering import FilteredRun
from rx90_emulator.identification.robot import BagLayout, topic_names
from rx90_emulator.loop.closed_loop import run_setpoints
from rx90_emulator.loop.result import FastSeries, SlowSeries, empty_series
from rx90_emulator.loop.setup import Setup

REFERENCE = "rx90_controller/reference"
_HOLD_S = 0.5  # s at rest before a motion, in which the integrators take the arm's weight
_MIN_LEAD_S = 0.5  # s, least time in which the arm gets the velocity that a record begins with
_REST_SPEED = 1e-6  # rad/s, of a set-point
_RANGE_SLACK = 1e-5  # of a range: times are whole nanoseconds
_MAX_GAP_PERIODS = 3.5  # periods between set-points that still are interpolated


@dataclass(frozen=True, eq=False)
class SetPoints:
    """What the simulated arm is to follow.

    Attributes:
        start: time of the first one by the bag's stamps, s.
        values: position rad, velocity rad/s, acceleration rad/s^2, one for each position tick, shape (m, 3, 6).
        begin: time from which they are the bag's, s; before it the arm is brought there.
        initial_position: where the simulated arm rests at `start`, rad, shape (6,).
        source: where they come from, in words.
    """

    start: float
    values: Array
    begin: float
    initial_position: Array
    source: str

    def beyond(self, bag: Path, setup: Setup) -> tuple[str, ...]:
        """Return a sentence for velocities, and one for accelerations, that the controller would refuse.

        A measured arm did move so: they are simulated all the same, up to what the controller's supervision stops.

        Raises:
            TrajectoryError: for positions beyond the joints' range, naming joint, value, time in the bag and range.
        """
        limits, found = setup.controller.limits(setup.robot), []
        for k, (what, unit, low, high) in enumerate((
            ("position", "rad", limits.lower, limits.upper),
            ("velocity", "rad/s", -limits.velocity, limits.velocity),
            ("acceleration", "rad/s^2", -limits.acceleration, limits.acceleration),
        )):  # fmt: skip
            values = self.values[:, k]
            beyond = np.maximum(low - values, values - high) / (high - low)
            row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
            if beyond[row, joint] <= _RANGE_SLACK:
                continue
            time = self.start + row * setup.rates.position_period
            where = f"{time:.3f} s" if time >= self.begin else "the lead-in, before the bag begins"
            fault = (
                f"{limits.names[joint]} needs the {what} {values[row, joint]:.4g} {unit} at {where}; accepted by the "
                f"robot's files: [{low[joint]:.4g}, {high[joint]:.4g}] {unit}"
            )
            if k == 0:
                raise TrajectoryError(f"{bag}: {fault}; set-points are {self.source}")
            found.append(f"{fault}; the simulation goes on nevertheless")
        return tuple(found)


def read_setpoints(
    bag: Path, names: Sequence[str], zero: Array | None, mapping: LogMapping | None = None
) -> tuple[JointSeries, Array, Array] | None:
    """Return the set-points of this project's controller that a bag holds; None where it holds none.

    Args:
        bag: the bag.
        names: of the joints.
        zero: recorded angles where those of the URDF are 0, rad, shape (6,); they are taken off the positions.
        mapping: what the columns of a table hold, where that is not in the file beside it.

    Returns:
        The series as it is in the bag, positions rad and velocities rad/s, shape (m, 6).
    """
    if absolute(REFERENCE) not in topic_names(bag, mapping):
        return None
    series = read_joint_states(bag, REFERENCE, names, mapping=mapping)
    if series.position is None or series.velocity is None:
        return None
    return series, series.position if zero is None else series.position - zero, series.velocity


def setpoint_rows(position: Array, velocity: Array, setup: Setup) -> Array:
    """Return set-points at the position loop's rate with the accelerations that belong to them, shape (m, 3, 6)."""
    acceleration = np.gradient(velocity, setup.rates.position_period, axis=0)
    return np.ascontiguousarray(np.stack([position, velocity, acceleration], axis=1))


def run_along(
    setup: Setup, setpoints: Array, start: Array, *, record_fast: bool = False
) -> tuple[FastSeries, SlowSeries, Array]:
    """Run the closed loop along set-points, shape (m, 3, 6), from rest at `start`, rad, shape (6,).

    Returns:
        What the base rate and the position loop's rate recorded, and the share of the ticks in which each motor was at
        its limit, shape (6,).
    """
    ticks = len(setpoints) * setup.rates.ratio
    plant, controller = setup.plant(), setup.cs7b()
    plant.reset(start)
    controller.reset(plant.motor_states()[0])
    fast, slow = empty_series(ticks, setup.rates.ratio, record_fast=record_fast)
    run_setpoints(plant, controller, setpoints, ticks, fast, slow)
    return fast, slow, np.asarray(controller.saturated / ticks)


def recorded_setpoints(run: FilteredRun, first: Array, setup: Setup, layout: BagLayout) -> SetPoints | None:
    """Return the set-points of this project's controller that a bag holds; None where it holds none.

    A bag that begins at time 0 with an arm at rest is simulated as it ran, from its brakes on.

    Args:
        run: the measured motion.
        first: where the measured arm was at first, rad, shape (6,).
        setup: the robot.
        layout: of the bag, for its zeros and the columns of a table.

    Raises:
        IdentificationError: for a series with gaps, or one that ends before the measured motion begins.
    """
    bag, period = run.source.path, setup.rates.position_period
    found = read_setpoints(bag, run.names, layout.zero, layout.mapping)
    if found is None:
        return None
    series, position, velocity = found
    steps, time = np.diff(series.stamp_ns), series.time
    if len(steps) < 2 or not (steps > 0).all() or steps.max() > _MAX_GAP_PERIODS * np.median(steps):
        raise IdentificationError(f"{bag}: the set-points of {series.topic} have gaps; accepted: a steady stream")
    if time[0] > run.time[-1] or time[-1] < run.time[0]:
        raise IdentificationError(f"{bag}: {series.topic} and the measured states are of different times")
    if (steps != setup.rates.period_ns * setup.rates.ratio).any():
        since = (series.stamp_ns - series.stamp_ns[0]) / NANOSECONDS
        curve = BPoly.from_derivatives(since, np.stack([position, velocity], axis=1))
        even = np.arange(int(since[-1] / period + 1e-6) + 1) * period
        position, velocity = curve(even), curve(even, 1)
    values, source = setpoint_rows(position, velocity, setup), f"{REFERENCE} in the bag"
    if series.stamp_ns[0] == 0 and np.abs(velocity[0]).max() < _REST_SPEED:
        return SetPoints(0.0, values, 0.0, np.clip(first, setup.robot.lower, setup.robot.upper), source)
    return _with_lead_in(float(time[0]), values, setup, source)


def path_setpoints(run: FilteredRun, setup: Setup) -> SetPoints:
    """Return the smoothed measured path as set-points, with the velocities and accelerations that belong to it."""
    period = setup.rates.position_period
    # From 0 on: stamps of the wall clock are rounded too much for accelerations.
    samples = np.arange(len(run.time)) / run.rate
    count = int(samples[-1] / period + 1e-6) + 1
    values = _at(make_interp_spline(samples, run.position, k=5), np.minimum(np.arange(count) * period, samples[-1]))
    source = f"the measured path below {run.bandwidths.position:.3g} Hz"
    return _with_lead_in(float(run.time[0]), values, setup, source)


def _with_lead_in(begin: float, values: Array, setup: Setup, source: str) -> SetPoints:
    """Put a rest before set-points, and a motion from there to the velocity that they begin with."""
    period, limits = setup.rates.position_period, setup.controller.limits(setup.robot)
    position, velocity, _ = values[0]
    lasting = max(_MIN_LEAD_S, float(np.max(2.0 * np.abs(velocity) / limits.acceleration)))
    lead, hold = round(lasting / period), round(_HOLD_S / period)
    rest = np.clip(position - 0.5 * lead * period * velocity, limits.lower, limits.upper)
    rest = np.where(np.abs(velocity) < _REST_SPEED, position, rest)
    still = np.stack([rest, np.zeros(6), np.zeros(6)])
    moving = _at(BPoly.from_derivatives([0.0, lead * period], np.stack([still, values[0]])), np.arange(lead) * period)
    whole = np.ascontiguousarray(np.concatenate([np.broadcast_to(still, (hold, 3, 6)), moving, values]))
    return SetPoints(begin - (hold + lead) * period, whole, begin, rest, source)


def _at(curve: Any, time: Array) -> Array:
    """Return a curve and its first two derivatives, shape (m, 3, 6)."""
    return np.ascontiguousarray(np.stack([curve(time, nu) for nu in range(3)], axis=1))
