"""What a run of the closed loop gives: series by topic with names and units, also as a bag and as a NumPy file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, FailureError, check_type, write_error
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.topics import (
    DETAIL_DECIMATION,
    DETAILS,
    MOTOR_COMMANDS,
    MOTOR_NAMES,
    MOTOR_STATES,
    TEMPERATURES,
    TRAJECTORY_ACCEPTED,
)
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.message import message_content
from rx90_emulator.loop.setup import Setup

_ON_BASE_TICKS = (MOTOR_STATES, MOTOR_COMMANDS)


class MotionCommand(NamedTuple):
    """A trajectory that the controller follows from a position tick on; None stops the arm."""

    start: int
    points: TrajectoryPoints | None


class FastSeries(NamedTuple):
    """What is sampled on every base tick, motor side; position, velocity, torque, each shape (n, 3, 6)."""

    motor_states: Array
    motor_commands: Array


class SlowSeries(NamedTuple):
    """What is sampled on every position tick; each row holds position, velocity, effort.

    Attributes:
        joint_states: rad, rad/s, drive torque at the joint Nm, shape (m, 3, 6).
        friction_states: bristle deflection rad, input velocity rad/s, friction torque Nm, shape (m, 3, 7).
        reference: set-point rad, rad/s, feed-forward torque Nm, shape (m, 3, 6).
        tracking_error: rad, rad/s, commanded torque Nm, shape (m, 3, 6).
        details: set-point acceleration rad/s^2, joints; commanded and motor current A, motors; shape (m, 3, 6).
        temperatures: of the friction elements, degrees Celsius, once a second, shape (k, 7); k is 0 where none has one.
    """

    joint_states: Array
    friction_states: Array
    reference: Array
    tracking_error: Array
    details: Array
    temperatures: Array


def empty_series(ticks: int, ratio: int, record_fast: bool, base_hz: int = 0) -> tuple[FastSeries, SlowSeries]:
    """Return arrays for a run of `ticks` base ticks; temperatures are kept if `base_hz` says how often, once a second.

    Raises:
        FailureError: if they do not fit into memory.
    """
    rows = -(-ticks // ratio)
    fast_rows = ticks if record_fast else 0
    try:
        fast = FastSeries(np.empty((fast_rows, 3, 6)), np.empty((fast_rows, 6)))
        joints, friction, *others = (np.empty((rows, 3, columns)) for columns in (6, 7, 6, 6, 6))
        warmth = np.empty((-(-ticks // base_hz) if base_hz else 0, 7))
        slow = SlowSeries(joints, friction, others[0], others[1], others[2], warmth)
    except (MemoryError, ValueError, OverflowError) as error:  # the last two: more than any machine could address
        raise FailureError(f"a run of {ticks:g} ticks does not fit into memory; accepted: a shorter one") from error
    return fast, slow


@dataclass(frozen=True, eq=False)
class RunResult:
    """One run of the closed loop.

    Attributes:
        setup: what ran.
        fast: series on base ticks 0, 1, ...; motor_commands has shape (n, 6), Nm. None if not asked for.
        slow: series on position ticks 0, 1, ...
        saturated: ticks in which each amplifier was at its limit, shape (6,).
        commands: the trajectories.
    """

    setup: Setup
    fast: FastSeries | None
    slow: SlowSeries
    saturated: NDArray[np.int64]
    commands: tuple[MotionCommand, ...]

    @property
    def times(self) -> Array:
        """Return the times of the slow series, s, shape (m,)."""
        rows = np.arange(len(self.slow.joint_states), dtype=np.float64)
        return np.asarray(rows * self.setup.rates.position_period)

    @cached_property
    def series(self) -> dict[str, JointSeries]:
        """Return the series by topic, as a bag of the nodes holds them; those on base ticks if the run kept them."""
        joints, rates = self.setup.robot.joint_names, self.setup.rates
        position_period = rates.period_ns * rates.ratio
        slow = self.slow
        series = [
            _series("/joint_states", joints, slow.joint_states, position_period),
            _series("/friction_states", self.setup.friction.names, slow.friction_states, position_period),
            _series("/rx90_controller/reference", joints, slow.reference, position_period),
            _series("/rx90_controller/tracking_error", joints, slow.tracking_error, position_period),
        ]
        for k, (name, names) in enumerate(zip(DETAILS, (joints, MOTOR_NAMES, MOTOR_NAMES), strict=True)):
            values = np.ascontiguousarray(slow.details[::DETAIL_DECIMATION, k])
            series.append(
                JointSeries(
                    f"/rx90_controller/{name}",
                    names,
                    _stamps(values, position_period * DETAIL_DECIMATION),
                    effort=values,
                )
            )
        if self.fast is not None:
            series.append(_series(f"/{MOTOR_STATES}", MOTOR_NAMES, self.fast.motor_states, rates.period_ns))
            commands = self.fast.motor_commands
            series.append(
                JointSeries(f"/{MOTOR_COMMANDS}", MOTOR_NAMES, _stamps(commands, rates.period_ns), effort=commands)
            )
        return {one.topic.removeprefix("/"): one for one in series}


def _series(topic: str, names: tuple[str, ...], rows: Array, period_ns: int) -> JointSeries:
    return JointSeries(topic, names, _stamps(rows, period_ns), *(rows[:, k] for k in range(3)))


def _stamps(rows: Array, period_ns: int) -> NDArray[np.int64]:
    return np.arange(len(rows), dtype=np.int64) * period_ns


def write_bag(run: RunResult, path: Path | str, storage: str = "mcap", decimation: int = 1) -> None:
    """Write a run to a new bag folder, as if the nodes had been recorded.

    Args:
        run: the run.
        path: folder to make; must not exist.
        storage: "mcap" or "sqlite3".
        decimation: keep every n-th message of all topics but those on base ticks.

    Raises:
        BagError: if the folder exists or cannot be written.
        ConfigError: if `decimation` is not at least 1.
    """
    check_type(run=(run, RunResult))
    # Here, because it takes as long as the plant's import.
    from rx90_common.bags.writing import string_message, temperature_message, trajectory_message, write_joint_states

    names, period_ns = run.setup.robot.joint_names, run.setup.rates.period_ns * run.setup.rates.ratio
    others = [string_message("/robot_description", run.setup.robot.urdf)]
    for start, points in run.commands:
        content = message_content(names, points) if points else {"joint_names": list(names), "points": []}
        others.append(trajectory_message(f"/rx90_controller/{TRAJECTORY_ACCEPTED}", start * period_ns, content))
    for second, row in enumerate(run.slow.temperatures):
        for i, element in enumerate(run.setup.friction.elements):
            if element.temperature is not None:
                name = run.setup.friction.names[i]
                others.append(temperature_message(f"/{TEMPERATURES}", second * NANOSECONDS, name, float(row[i])))
    if not isinstance(decimation, int | np.integer) or decimation < 1:
        raise ConfigError(f"decimation is {decimation}; accepted: a whole number >= 1")
    kept = slice(None, None, decimation)
    series = [one if topic in _ON_BASE_TICKS else one.take(kept) for topic, one in run.series.items()]
    write_joint_states(path, series, storage=storage, messages=others)


def save_arrays(run: RunResult, file: Path | str) -> None:
    """Write a run to a new compressed NumPy file, `.npz`: arrays by `<series> <quantity> [unit]`, and names.

    The series are named as the topics, less their node. `time [s]`, shape (m,), belongs to those on position ticks,
    shape (m, joints); `detail time [s]` to set-point acceleration and currents, on every tenth of these; `base time
    [s]`, shape (n,), to `motor_states` and `motor_commands`, which are there if the run kept them; `temperature time
    [s]` to `temperature [degC]`, shape (k, elements), which is there if an element has one (0 for the others).

    Raises:
        Rx90Error: if the file cannot be written.
    """
    arrays: dict[str, Any] = {
        "joint names": np.array(run.setup.robot.joint_names),
        "element names": np.array(run.setup.friction.names),
        "time [s]": run.times,
        "detail time [s]": run.times[::DETAIL_DECIMATION],
    }
    if len(run.slow.temperatures):
        arrays["temperature time [s]"] = np.arange(len(run.slow.temperatures), dtype=np.float64)
        arrays["temperature [degC]"] = run.slow.temperatures
    for topic, series in run.series.items():
        if topic == MOTOR_STATES:
            ticks = np.arange(len(series.stamp_ns), dtype=np.float64)
            arrays["base time [s]"] = np.asarray(ticks * run.setup.rates.period)
        for field, values in series.fields.items():
            arrays[f"{topic.rpartition('/')[2]} {series.quantities[field]}"] = values
    try:
        stream = Path(file).open("xb")  # noqa: SIM115 - what fails from here on must not remove a file of others
    except OSError as error:
        raise write_error(file, error, "a new file") from error
    try:
        with stream:
            np.savez_compressed(stream, **arrays)
    except BaseException as error:
        Path(file).unlink(missing_ok=True)  # half a file is of no use
        if isinstance(error, OSError):
            raise write_error(file, error) from error
        raise
