"""The battery: for each case the arm, its trajectory and disturbances of the commands; and their runs.

A run records the messages between controller and arm; that of the CS7B is on the compiled loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.config import load_yaml, yaml_text
from rx90_common.base.errors import ConfigError, DivergenceError
from rx90_common.description.robot_files import RobotFiles
from rx90_common.process.files import write_text
from rx90_controller.lines.task import LineTask, load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.loop.line import plan_line
from rx90_emulator.loop.setup import Setup

START = 0.5
"""Start of the trajectory of each case, s: before it the controller takes over the weight of the arm."""
SETTLED = 1.0
"""Time of observation after a trajectory's end, s."""

_STEP = math.radians(2.0)
_STEP_ACCELERATION = 0.8  # times the least of the joints' largest accelerations
_REST_SPEED = 0.02  # rad/s
_WATCHED_REST = 6.0  # s
_DERATED = 0.8  # of the torque that the CS7B needs
_LOSS_RATE, _DUPLICATE_RATE = 0.02, 0.01  # of the ticks
_LINE_REST = 0.3  # s, before and after a line

_SLIDING = 0.06  # of the nominal speeds: all joints slide in one direction while the torques are swept
_SWEEP_PERIOD = 1.0  # s, of all sines together
_SWEEP_PERIODS = 3  # the first is discarded
_SINES = 12  # for each motor
_SLOWEST, _FASTEST = 6.0, 480.0  # Hz
_SINE_TORQUE = 0.01  # of the peak torque, each sine


class TorqueSines(NamedTuple):
    """Torques that are added to the commands, each sine's frequency for another motor in turn.

    Attributes:
        begin: s; from then on, for `_SWEEP_PERIODS` periods of 1 s.
        frequency: whole Hz, shape (n, k), no number twice.
        amplitude: Nm, motor side, shape (n,).
        phase: rad, shape (n, k).
    """

    begin: float
    frequency: Array
    amplitude: Array
    phase: Array

    @property
    def measured(self) -> tuple[float, float]:
        """Return begin and end of the periodic response, s."""
        return self.begin + _SWEEP_PERIOD, self.begin + _SWEEP_PERIODS * _SWEEP_PERIOD

    def torques(self, times: Array) -> Array:
        """Return the torques at `times`, s, shape (t,): Nm, shape (t, n); faded in over a tenth of a period."""
        since = times - self.begin
        inside = (since >= 0.0) & (since < _SWEEP_PERIODS * _SWEEP_PERIOD)
        fade = inside * np.clip(since / (0.1 * _SWEEP_PERIOD), 0.0, 1.0)
        angle = 2.0 * np.pi * since[:, None, None] * self.frequency + self.phase
        return np.asarray(fade[:, None] * self.amplitude * np.sin(angle).sum(axis=2))


@dataclass(frozen=True, eq=False)
class Case:
    """One run of the battery.

    Attributes:
        name: of the case.
        about: in words.
        setup: the simulated arm, read from its files; the controller is designed for the nominal one.
        points: the trajectory, which starts at START.
        duration: of the run, s.
        task: the line that the tool follows, if any.
        sines: torques that are added to the commands, if any.
        lost: ticks whose commands are lost, shape (ticks,); the drives keep the previous command.
        twice: ticks whose states are sent twice, as lock-step does when it repeats a request.
    """

    name: str
    about: str
    setup: Setup
    points: TrajectoryPoints
    duration: float
    task: LineTask | None = None
    sines: TorqueSines | None = None
    lost: Mask | None = None
    twice: Mask | None = None

    @property
    def ticks(self) -> int:
        """Return how many base ticks the run takes."""
        return self.setup.rates.ticks_of(self.duration)

    @property
    def times(self) -> Array:
        """Return the times of the ticks, s, shape (ticks,)."""
        return np.asarray(np.arange(self.ticks, dtype=np.float64) * self.setup.rates.period)

    @property
    def end(self) -> float:
        """Return when the trajectory ends, s."""
        return START + float(self.points.times[-1])


class Nominal(NamedTuple):
    """The basis of the cases.

    Attributes:
        setup: the nominal arm and the CS7B.
        folder: for the files of modified arms.
        needed: largest torques of the motors, Nm, shape (n,), in the CS7B's run of a case.
    """

    setup: Setup
    folder: Path
    needed: Callable[[Case], Array]

    @property
    def task(self) -> LineTask:
        """Return the robot's reference line, with short rests."""
        return replace(load_task(files_of(self.setup).required("task")), rest_before=_LINE_REST, rest_after=_LINE_REST)

    @property
    def pose(self) -> Array:
        """Return the beginning of the line, rad, shape (n,)."""
        return np.array(plan_line(self.setup, self.task).points.position[0])

    def scaled(self, role: str, keys: Sequence[str], factor: float | Array) -> Setup:
        """Return the arm with all values of these keys in one of its files times a factor, or one for each motor."""
        files = files_of(self.setup)
        target = self.folder / f"{role}_{len(list(self.folder.iterdir()))}.yaml"
        write_text(target, yaml_text(_times(load_yaml(files.required(role)).content, keys, factor)))
        return Setup.load(replace(files, **{role: target}), self.setup.rates, self.setup.seed)


def files_of(setup: Setup) -> RobotFiles:
    """Return the files that a setup was read from."""
    assert setup.files is not None
    return setup.files


def _times(value: Any, keys: Sequence[str], factor: float | Array, here: bool = False) -> Any:
    if isinstance(value, dict):
        return {key: _times(one, keys, factor, here or key in keys) for key, one in value.items()}
    if isinstance(value, list):
        if here and np.ndim(factor):
            return (np.asarray(value) * factor).tolist()
        return [_times(one, keys, factor, here) for one in value]
    return float(value * factor) if here and isinstance(value, int | float) else value


def _of_motion(nominal: Nominal, name: str, about: str, motion: Motion, watched: float = SETTLED) -> Case:
    points = motion.points(nominal.setup.robot.joint_names)
    return Case(name, about, nominal.setup, points, START + motion.duration + watched)


def _inward(pose: Array, setup: Setup) -> Array:
    """Return the direction of each joint away from its nearer limit, 1 or -1, shape (n,)."""
    return np.where(pose > 0.5 * (setup.robot.lower + setup.robot.upper), -1.0, 1.0)


def _step(nominal: Nominal, name: str) -> Case:
    pose, setup = nominal.pose, nominal.setup
    acceleration = _STEP_ACCELERATION * float(setup.controller.max_acceleration.min())
    motion = Motion(pose)
    motion.move(pose + _STEP * _inward(pose, setup), setup.robot.max_velocity, acceleration)
    about = f"all joints {math.degrees(_STEP):g} deg, as fast as {acceleration:g} rad/s² allow"
    return _of_motion(nominal, name, about, motion)


def _sweep(nominal: Nominal, name: str) -> Case:
    pose, setup = nominal.pose, nominal.setup
    plateau = _SWEEP_PERIODS * _SWEEP_PERIOD + 0.2
    speed = _SLIDING * setup.robot.max_velocity * _inward(pose, setup)
    motion = Motion(pose)
    motion.sweep(speed, 1.0, plateau, float(setup.controller.max_acceleration.min()))
    ramp = float(motion.points(setup.robot.joint_names).times[1])
    joints = len(pose)
    targets = np.geomspace(_SLOWEST, _FASTEST, joints * _SINES)
    whole: list[int] = []
    for frequency in targets:  # no number twice: the next one then
        whole.append(max(round(frequency), whole[-1] + 1 if whole else 0))
    frequency = np.array(whole, dtype=np.float64).reshape(_SINES, joints).T
    phase = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, frequency.shape)
    sines = TorqueSines(START + ramp + 0.1, frequency, _SINE_TORQUE * setup.drives.peak_torque, phase)
    about = (
        f"all joints slide at {_SLIDING:g} of their nominal speeds, while sines of {whole[0]} to {whole[-1]} Hz are "
        "added to the torques"
    )
    return replace(_of_motion(nominal, name, about, motion), sines=sines)


def _line(nominal: Nominal, name: str, about: str = "the nominal arm") -> Case:
    task = nominal.task
    points = plan_line(nominal.setup, task).points
    about = f"the robot's reference line, in which joints reverse: {about}"
    return Case(name, about, nominal.setup, points, START + float(points.times[-1]) + 0.2, task)


def _other_arm(nominal: Nominal, name: str, role: str, keys: Sequence[str], factor: float, what: str) -> Case:
    setup = nominal.scaled(role, keys, factor)
    return replace(_line(nominal, name, f"{what} times {factor:g}"), setup=setup)


def _rest(nominal: Nominal, name: str) -> Case:
    pose, setup = nominal.pose, nominal.setup
    motion = Motion(pose)
    motion.sweep(_inward(pose, setup), _REST_SPEED, 0.5, float(setup.controller.max_acceleration.min()))
    about = f"all joints creep to a set-point at {_REST_SPEED:g} rad/s and hold it for {_WATCHED_REST:g} s"
    return _of_motion(nominal, name, about, motion, _WATCHED_REST)


def _saturation(nominal: Nominal, name: str) -> Case:
    case = _step(nominal, name)
    share = np.minimum(1.0, _DERATED * nominal.needed(case) / nominal.setup.drives.peak_torque)
    about = f"the step with drives that give {_DERATED:g} of the torques that the CS7B needs for it"
    return replace(case, about=about, setup=nominal.scaled("drives", ("peak_current",), share))


def _dropped(nominal: Nominal, name: str) -> Case:
    case = _line(
        nominal, name, f"{_LOSS_RATE:.0%} of the commands are lost, {_DUPLICATE_RATE:.0%} of the states come twice"
    )
    chance = np.random.default_rng(1)
    lost, twice = chance.random(case.ticks) < _LOSS_RATE, chance.random(case.ticks) < _DUPLICATE_RATE
    lost[: case.setup.rates.ticks_of(START)] = False
    return replace(case, lost=lost, twice=twice)


_PAYLOAD, _FRICTION = ("mass", "inertia"), ("tau_c", "tau_s", "c2")
_MAKERS: dict[str, Callable[..., Case]] = {
    "step": _step,
    "sweep": _sweep,
    "line": _line,
    **{f"payload_{f:g}": partial(_other_arm, role="tool", keys=_PAYLOAD, factor=f, what="the payload's mass and "
                                 "inertia") for f in (0.7, 1.3)},
    **{f"friction_{f:g}": partial(_other_arm, role="friction", keys=_FRICTION, factor=f, what="the friction's tau_c, "
                                  "tau_s and c2") for f in (0.7, 1.3)},
    "rest": _rest,
    "saturation": _saturation,
    "dropped": _dropped,
}  # fmt: skip
CASES = tuple(_MAKERS)
"""Names of the cases, in their order."""


def make_case(name: str, nominal: Nominal) -> Case:
    """Return a case.

    Raises:
        ConfigError: for a payload of an arm without a tool, and a robot without a reference line.
    """
    if name.startswith("payload") and files_of(nominal.setup).tool is None:
        raise ConfigError(f"case {name}: the arm carries no tool; accepted: with a tool file, or other cases")
    return _MAKERS[name](nominal, name)


class Record:
    """A run of a case, command by command: the torques that the drives receive, and the recorded values.

    Args:
        case: what is run.
        at_joints: whether efforts at the joints are commanded (`joint_commands`), not torques of the motors
            (`motor_commands`).
        ticks: base ticks from one command to the next.

    Attributes:
        added: torques that are added to the commands, Nm, shape (t, n).
        fault: why the run ended early, if it did.
    """

    def __init__(self, case: Case, at_joints: bool = False, ticks: int = 1) -> None:
        self.case, self.at_joints, self.ticks = case, at_joints, ticks
        rows, joints = -(-case.ticks // ticks), len(case.setup.robot.joint_names)
        self.added = np.zeros((rows, joints))
        if case.sines is not None:
            scale = np.abs(case.setup.drives.gear) if at_joints else 1.0
            times = case.setup.rates.period * ticks * np.arange(rows, dtype=np.float64)
            self.added = case.sines.torques(times) * scale
        self._states, self._sent = np.full((rows, joints), np.nan), np.full((rows, joints), np.nan)
        self._held: Array | None = None
        self._done = 0
        self.fault: str | None = None

    def note_states(self, tick: int, position: Array) -> None:
        """Record the measured positions of a tick, rad, shape (n,), on the controller's side."""
        self._states[tick // self.ticks] = position

    def carry(self, tick: int, command: Array | None) -> Array | None:
        """Return the torques of the drives for a command, Nm, shape (n,), None for no torque; repeats do not count."""
        row, case = tick // self.ticks, self.case
        if command is not None:
            self._sent[row] = command
        self._done = row + 1
        if case.lost is not None and case.lost[tick]:
            return self._held
        self._held = None if command is None else command + self.added[row]
        return self._held

    @property
    def period(self) -> float:
        """Return the time from one command to the next, s."""
        return self.ticks * self.case.setup.rates.period

    @property
    def times(self) -> Array:
        """Return the times of the commands, s, shape (t,)."""
        return np.asarray(np.arange(self._done) * self.period)

    @property
    def sent(self) -> Array:
        """Return what the controller commanded, at motors or joints, Nm, shape (t, n); NaN for no torque."""
        return self._sent[: self._done]

    @property
    def torque(self) -> Array:
        """Return the commanded torques at the joints, Nm, shape (t, n)."""
        drives = self.case.setup.drives
        return self.sent if self.at_joints else self.sent * drives.gear @ drives.turning.turns

    @property
    def position(self) -> Array:
        """Return positions of the joints by the encoders, rad, shape (t, n)."""
        states, drives = self._states[: self._done], self.case.setup.drives
        return states if self.at_joints else states / drives.gear @ drives.turning.joint_turns.T


def run_cs7b(case: Case, nominal: Setup) -> Record:
    """Run a case with the CS7B of the nominal arm, without ROS; the numbers equal those of its node bit for bit."""
    plant, law, record = case.setup.plant(), nominal.cs7b(), Record(case)
    plant.reset(case.points.position[0])
    states = plant.motor_states()
    law.reset(states[0])
    law.trajectory.accept(case.points, 0, case.setup.rates.start_tick(START))
    try:
        for tick in range(case.ticks):
            record.note_states(tick, states[0])
            command = law.step(*states)
            plant.step(record.carry(tick, None if law.fault else command))
    except DivergenceError as error:
        record.fault = str(error)
    return record


def set_points(case: Case, nominal: Setup) -> Array:
    """Return position, velocity and acceleration of the set-points, one in each tick of the position loop, (m, 3, n).

    Before the trajectory the set-point is its start, after it its end.
    """
    law, rates = nominal.cs7b(), case.setup.rates
    law.trajectory.reset(np.array(case.points.position[0]))
    law.trajectory.accept(case.points, 0, rates.start_tick(START))
    return law.trajectory.setpoints(0, -(-case.ticks // rates.ratio))
