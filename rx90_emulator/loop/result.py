"""What a run of the closed loop gives: series by topic with names and units, also as a bag."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, FailureError, check_type
from rx90_common.description.coupling import ArmSize
from rx90_common.exchange.topics import (
    CORRECTION,
    DETAIL_DECIMATION,
    DETAILS,
    MOTOR_COMMANDS,
    MOTOR_STATES,
    PARAMETERS,
    SEED,
    TRAJECTORY_ACCEPTED,
    motor_names,
)
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.correction import Correction
from rx90_controller.trajectory.points import message_content
from rx90_emulator.loop.setup import Setup

_NOT_DECIMATED = (MOTOR_STATES, MOTOR_COMMANDS)


class MotionCommand(NamedTuple):
    """A trajectory that the controller follows from a position tick on, with its correction; None stops the arm."""

    start: int
    points: TrajectoryPoints | None
    correction: Correction | None = None


class FastSeries(NamedTuple):
    """What is sampled on every base tick, motor side; position, velocity, torque, each shape (n, 3, 6)."""

    motor_states: Array
    motor_commands: Array


class SlowSeries(NamedTuple):
    """What is sampled on every position tick; each row holds position, velocity, effort.

    Attributes:
        joint_states: rad, rad/s, drive torque at the joint Nm, shape (m, 3, j).
        friction_states: bristle deflection rad, input velocity rad/s, friction torque Nm, shape (m, 3, e).
        reference: set-point rad, rad/s, feed-forward torque Nm, shape (m, 3, j).
        tracking_error: rad, rad/s, commanded torque Nm, shape (m, 3, j).
        details: acceleration to the next set-point rad/s^2, joints; commanded and motor current A, motors; shape
            (m, 3, j). The motor current is what the drives report, where their current sensors have errors.
        temperatures: of the friction elements, degrees Celsius, at the rate of temperatures, shape (k, e), 0 for those
            that have none; k is 0 where neither joints nor windings get warm.
        windings: of the motors' windings, the same, shape (k, j).
        correction: offsets of the position set-points, rad, shape (m, j), or (0, j) where nothing was corrected.
    """

    joint_states: Array
    friction_states: Array
    reference: Array
    tracking_error: Array
    details: Array
    temperatures: Array
    windings: Array
    correction: Array


def empty_series(
    ticks: int, ratio: int, record_fast: bool, warm_ticks: int = 0, *, arm: ArmSize
) -> tuple[FastSeries, SlowSeries]:
    """Return arrays for a run of `ticks` base ticks; temperatures are kept once in `warm_ticks`, not at all for 0.

    Raises:
        FailureError: if they do not fit into memory.
    """
    n, e, _ = arm
    rows = -(-ticks // ratio)
    fast_rows = ticks * record_fast
    warm_rows = -(-ticks // warm_ticks) if warm_ticks else 0
    with within_memory(ticks):
        fast = FastSeries(np.empty((fast_rows, 3, n)), np.empty((fast_rows, n)))
        of_joints = (np.empty((rows, 3, columns)) for columns in (n, e, n, n, n))
        slow = SlowSeries(
            *of_joints, np.empty((warm_rows, e)), np.empty((warm_rows, n)), np.empty((0, n))
        )  # type: ignore[call-arg]
    return fast, slow


@contextmanager
def within_memory(ticks: int) -> Iterator[None]:
    """Let the arrays of a run that are made in a block be refused where they do not fit into memory."""
    try:
        yield
    except (
        MemoryError,
        ValueError,
        OverflowError,
    ) as error:  # of more than any machine could address
        raise FailureError(
            f"a run of {ticks:g} ticks does not fit into memory; accepted: a shorter one"
        ) from error


@dataclass(frozen=True, eq=False)
class RunResult:
    """One run of the closed loop.

    Attributes:
        setup: what ran.
        fast: series on base ticks 0, 1, ...; motor_commands has shape (n, j), Nm. None if not asked for.
        slow: series on position ticks 0, 1, ...
        saturated: ticks in which each amplifier was at its limit, shape (j,).
        commands: the trajectories.
        substeps: plant steps in a tick.
    """

    setup: Setup
    fast: FastSeries | None
    slow: SlowSeries
    saturated: NDArray[np.int64]
    commands: tuple[MotionCommand, ...]
    substeps: int

    @property
    def times(self) -> Array:
        """Return the times of the slow series, s, shape (m,)."""
        return (
            np.arange(len(self.slow.joint_states), dtype=np.float64)
            * self.setup.rates.position_period
        )

    @cached_property
    def series(self) -> dict[str, JointSeries]:
        """Return the series by topic, as a bag of the nodes holds them; those on base ticks if the run kept them."""
        joints = self.setup.robot.joint_names
        friction = self.setup.friction
        rates = self.setup.rates
        motors = motor_names(len(joints))
        slow = self.slow
        period = rates.period_ns * rates.ratio
        series = [
            series_of("joint_states", joints, slow.joint_states, period),
            series_of("friction_states", friction.names, slow.friction_states, period),
            series_of("rx90_controller/reference", joints, slow.reference, period),
            series_of("rx90_controller/tracking_error", joints, slow.tracking_error, period),
        ]
        rows = np.flatnonzero(slow.correction.any(axis=1))
        if len(rows):
            topic = f"/rx90_controller/{CORRECTION}"
            series.append(
                JointSeries(topic, joints, rows.astype(np.int64) * period, slow.correction[rows])
            )
        for k, (name, names) in enumerate(zip(DETAILS, (joints, motors, motors), strict=True)):
            values = np.ascontiguousarray(slow.details[::DETAIL_DECIMATION, k])
            series.append(
                series_of(f"rx90_controller/{name}", names, values, period * DETAIL_DECIMATION)
            )
        if self.fast is not None:
            series.append(series_of(MOTOR_STATES, motors, self.fast.motor_states, rates.period_ns))
            series.append(
                series_of(MOTOR_COMMANDS, motors, self.fast.motor_commands, rates.period_ns)
            )
        return {one.topic.removeprefix("/"): one for one in series}


def series_of(topic: str, names: tuple[str, ...], rows: Array, period_ns: int) -> JointSeries:
    """Return a series of rows of position, velocity, effort, shape (n, 3, m), or of efforts alone, shape (n, m)."""
    values = (None, None, rows) if rows.ndim == 2 else np.moveaxis(rows, 1, 0)
    return JointSeries(f"/{topic}", names, np.arange(len(rows)) * period_ns, *values)


def write_bag(run: RunResult, path: Path | str, decimation: int = 1) -> None:
    """Write a run to a new bag folder, as if the nodes had been recorded.

    Args:
        run: the run.
        path: folder to make; must not exist.
        decimation: keep every n-th message of all topics but those on base ticks.

    Raises:
        BagError: if the folder exists or cannot be written.
        ConfigError: if `decimation` is not at least 1.
    """
    check_type(run=(run, RunResult))
    # Here, because it takes as long as the plant's import.
    from rx90_common.bags.writing import string_message, write_joint_states
    from rx90_emulator.loop.run_messages import parameter_message, trajectory_message

    names = run.setup.robot.joint_names
    rates = run.setup.rates
    period_ns = rates.period_ns * rates.ratio
    others = [
        string_message("/robot_description", run.setup.robot.urdf),
        parameter_message(f"/rx90_sim/{PARAMETERS}", "/rx90_sim", SEED, run.setup.seed),
    ]
    for start, points, _ in run.commands:
        content = (
            message_content(names, points) if points else {"joint_names": list(names), "points": []}
        )
        others.append(
            trajectory_message(
                f"/rx90_controller/{TRAJECTORY_ACCEPTED}", start * period_ns, content
            )
        )
    if not isinstance(decimation, int | np.integer) or decimation < 1:
        raise ConfigError(f"decimation is {decimation}; accepted: a whole number >= 1")
    kept = slice(None, None, decimation)
    series = [
        one if topic in _NOT_DECIMATED else one.take(kept) for topic, one in run.series.items()
    ]
    write_joint_states(path, series, messages=others)
