"""The arm in its closed loop, beat by beat: what a task of V+ runs on, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from rx90_common.base.arrays import Array
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.loop.closed_loop import run_setpoints
from rx90_emulator.loop.result import FastSeries, MotionCommand, RunResult, SlowSeries, empty_series
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.arm import ProgrammedArm
from rx90_emulator.vplus.motion import MotionQueue
from rx90_emulator.vplus.signals import Signals

PERIOD = 16e-3
"""Of set-points, s, from one beat to the next."""


class Drive(Protocol):
    """What follows the set-points: the closed loop, or running nodes."""

    def follow(self, position: Array, velocity: Array) -> None:
        """Go to joint angles, rad, with speeds, rad/s, within the next beat."""

    def position(self) -> Array:
        """Return the measured joint angles, rad, shape (6,)."""


@dataclass(eq=False)
class Cell:
    """The arm, its signals and the time, which goes on by one beat after the other.

    Attributes:
        arm: its kinematics and limits.
        drive: what moves it.
        queue: its motions.
        period: of a beat, s.
        signals: inputs and outputs.
        show: what TYPE shows goes there.
        ask: asks for a line of text.
        tolerance: of the position errors at the end of a motion, as a share of the arm's.
    """

    arm: ProgrammedArm
    drive: Drive
    queue: MotionQueue
    period: float = PERIOD
    signals: Signals = field(default_factory=Signals)
    show: Callable[[str, float, bool], None] = lambda text, time, ends: print(f"{text}")  # noqa: ARG005
    ask: Callable[[str], str] = lambda question: ""  # noqa: ARG005
    tolerance: float = 1.0
    beats: int = 0

    @property
    def time(self) -> float:
        """Return the simulated time, s."""
        return self.beats * self.period

    @property
    def settled(self) -> bool:
        """Return whether the arm stands where it should at the end of a motion."""
        error = np.degrees(np.abs(self.drive.position() - self.queue.position))
        return bool(error.max() <= self.tolerance * self.arm.speeds.null_tolerance)

    def advance(self) -> None:
        """Let one beat pass."""
        self.drive.follow(*self.queue.advance(self.period, self.time))
        self.beats += 1
        self.signals.advance(self.time)
        self.queue.begin_waiting(self.settled, self.time)


@dataclass(eq=False)
class Engine:
    """The closed loop of the emulator, a beat at a time.

    Attributes:
        setup: robot, drives, friction, controller, rates.
        start: joint angles at rest, rad, shape (6,).
        period: of a beat, s.
        keep: whether the series are kept.
        record_fast: whether those on base ticks are, too.
    """

    setup: Setup
    start: Array
    period: float = PERIOD
    keep: bool = True
    record_fast: bool = False

    def __post_init__(self) -> None:
        rates = self.setup.rates
        self._plant = self.setup.plant()
        self._law = self.setup.cs7b()
        self._plant.reset(self.start)
        self._law.reset(self._plant.motor_states()[0])
        self._ticks = rates.ticks_of(self.period)
        self._times: Array = np.arange(self._ticks // rates.ratio, dtype=np.float64) * rates.position_period
        self._knots = [np.stack([self.start, np.zeros(6)])]
        self._fast: list[FastSeries] = []
        self._slow: list[SlowSeries] = []

    def position(self) -> Array:
        """Return the measured joint angles, rad, shape (6,)."""
        return np.array(self._plant.joint_states()[0])

    def follow(self, position: Array, velocity: Array) -> None:
        """Go to joint angles, rad, with speeds, rad/s, within the next beat.

        Raises:
            DivergenceError: naming joint and tick.
            SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
        """
        before = self._knots[-1]
        knot = np.stack([position, velocity])
        both = np.stack([before, knot])
        rows = interpolate(np.array([0.0, self.period]), both[:, 0], both[:, 1], None).sample(self._times)
        ahead = np.concatenate([rows[1:, 1], velocity[None]])
        rows[:, 2] = (ahead - rows[:, 1]) / self.setup.rates.position_period  # as FollowedPath.leading
        setpoints = np.ascontiguousarray(rows)
        rates = self.setup.rates
        fast, slow = empty_series(self._ticks, rates.ratio, self.record_fast, arm=self.setup.drives.turning.size)
        run_setpoints(self._plant, self._law, setpoints, self._ticks, fast, slow)
        if self.keep:
            self._knots.append(knot)
            self._fast.append(fast)
            self._slow.append(slow)
        else:
            self._knots = [knot]

    def result(self) -> RunResult:
        """Return the run so far, as that of one trajectory."""
        slow = SlowSeries(*(np.concatenate(parts) for parts in zip(*self._slow, strict=True)))
        fast = FastSeries(*(np.concatenate(parts) for parts in zip(*self._fast, strict=True)))
        knots = np.array(self._knots)
        times: Array = np.arange(len(knots), dtype=np.float64) * self.period
        points = TrajectoryPoints(times, knots[:, 0], knots[:, 1], None)
        commands = (MotionCommand(0, points),)
        kept = fast if self.record_fast else None
        return RunResult(self.setup, kept, slow, self._law.saturated, commands, self._plant.substeps)
