"""The closed loop without ROS, a beat at a time: set-points come while it runs (as a `Drive` of the cabinet)."""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.loop.closed_loop import run_setpoints
from rx90_emulator.loop.result import FastSeries, MotionCommand, RunResult, SlowSeries, empty_series
from rx90_emulator.loop.setup import Setup


class SteppedLoop:
    """Plant and controller, a beat at a time.

    Args:
        setup: robot, drives, friction, controller, rates.
        start: joint angles in the beginning, rad, shape (n,).
        period: of a beat, s.
        keep: whether the series are kept.
        record_fast: whether those on base ticks are, too.

    Attributes:
        start: as given.
        outage: why the arm has no power: always empty, what cuts it is raised.
    """

    def __init__(
        self,
        setup: Setup,
        start: Array,
        period: float,
        *,
        keep: bool = True,
        record_fast: bool = False,
    ) -> None:
        self.start = start
        self.outage = ""
        self._setup = setup
        self._keep = keep
        self._record_fast = record_fast
        self._plant = setup.plant()
        self._law = setup.cs7b()
        self._series: list[tuple[FastSeries, SlowSeries]] = []
        self._knots: list[tuple[float, Array, Array]] = []
        self._reset(0.0, self.start)
        self._ticks = setup.rates.ticks_of(period)
        self._times = np.arange(0.0, period - 1e-9, setup.rates.position_period)

    def position(self) -> Array:
        """Return the measured joint angles, rad, shape (n,)."""
        return np.array(self._plant.joint_states()[0])

    def rest(self, time: float) -> Array:
        """Stand where the arm is from a time, s, on, its power cut; return its joint angles, rad, shape (n,)."""
        robot = self._setup.robot
        self._reset(time, np.clip(np.nan_to_num(self.position()), robot.lower, robot.upper))
        return self.position()

    def power(self, _: bool) -> None:
        """Do nothing: the servo holds the arm as its brakes would."""

    def _reset(self, time: float, q: Array) -> None:
        self._plant.reset(q)
        self._law.reset(self._plant.motor_states()[0])
        self._add(time, q, np.zeros_like(q))

    def _add(self, *knot: Any) -> None:
        if not self._keep:
            self._knots.clear()
        elif self._knots and self._knots[-1][0] == knot[0]:
            self._knots.pop()  # of the set-point at which the power was cut
        self._knots.append(knot)

    def send(self, time: float, position: Array, velocity: Array) -> None:
        """Go to joint angles, rad, with speeds, rad/s, within the next beat.

        Raises:
            DivergenceError: naming joint and tick.
            SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
        """
        rates = self._setup.rates
        begin, start, speed = self._knots[-1]
        times = np.array([0.0, time - begin])
        positions = np.array([start, position])
        velocities = np.array([speed, velocity])
        rows = interpolate(times, positions, velocities, None).sample(self._times)
        ahead = np.vstack([rows[1:, 1], velocity])
        rows[:, 2] = (ahead - rows[:, 1]) / rates.position_period  # as FollowedPath.leading
        series = empty_series(
            self._ticks, rates.ratio, self._record_fast, arm=self._setup.drives.turning.size
        )
        run_setpoints(self._plant, self._law, np.ascontiguousarray(rows), self._ticks, *series)
        self._add(time, position, velocity)
        if self._keep:
            self._series.append(series)

    def result(self) -> RunResult:
        """Return the run so far, as that of one trajectory."""
        fast, slow = zip(*self._series, strict=True)
        kept = (
            FastSeries(*map(np.concatenate, zip(*fast, strict=True))) if self._record_fast else None
        )
        series = SlowSeries(*map(np.concatenate, zip(*slow, strict=True)))
        times, positions, velocities = zip(*self._knots, strict=True)
        points = TrajectoryPoints(np.array(times), np.array(positions), np.array(velocities), None)
        commands = (MotionCommand(0, points),)
        return RunResult(
            self._setup, kept, series, self._law.saturated, commands, self._plant.substeps
        )
