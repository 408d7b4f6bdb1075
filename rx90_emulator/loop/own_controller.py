"""A controller of one's own in one process with the arm: a function from measurements to efforts, tick by tick.

The arm and what it is told are those of the node `rx90_sim` with `command_interface` joint, in lock-step: the same
function behind a node gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.arrays import Array, Mask, Record
from rx90_common.base.errors import ConfigError, check_type
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.topics import JOINT_COMMANDS, MEASURED_JOINT_STATES
from rx90_common.kernels.compiled import kernel
from rx90_emulator.loop.result import series_of, within_memory
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import JointInterface
from rx90_sim.plant_step import friction_states, plant_step

EffortController = Callable[[Array, Array, float], ArrayLike | None]
"""Takes measured joint positions rad, velocities rad/s, both of shape (n,), and time s; returns efforts at the joints,
Nm, shape (n,), or None for no torque and closed brakes."""


@kernel
def hold_torques(
    plants: Record,
    plant_states: Record,
    torque: Array,
    powered: bool,
    first: int,
    ticks: int,
    ratio: int,
    joint_rows: Array,
    friction_rows: Array,
) -> tuple[int, int]:
    """Run base ticks `first` to `first + ticks - 1` with the same motor torques.

    Args:
        plants: constants of the plant.
        plant_states: state of the plant, advanced in place.
        torque: motor side, Nm, shape (n,).
        powered: whether there is torque; else the brakes are closed.
        first: number of the first tick.
        ticks: how many.
        ratio: base ticks in a row of the series.
        joint_rows: written, shape (m, 3, n).
        friction_rows: written, shape (m, 3, e).

    Returns:
        How many ticks were run, and the joint that diverged in the last of them, or -1.
    """
    state = plant_states[0]
    for k in range(first, first + ticks):
        if k % ratio == 0:
            row = k // ratio
            joint_rows[row, 0] = state.q
            joint_rows[row, 1] = state.v
            joint_rows[row, 2] = state.drive_torque
            friction_rows[row, 0] = state.z
            friction_states(plants, plant_states, friction_rows[row, 1], friction_rows[row, 2])
        joint = plant_step(plants, plant_states, torque, powered)
        if joint >= 0:
            return k + 1 - first, joint
    return ticks, -1


@dataclass(frozen=True, eq=False)
class ControllerRun:
    """One run of an arm with a controller of one's own.

    Attributes:
        setup: the arm; its controller took no part.
        command_rate: how often efforts were asked for, Hz.
        joint_states: of the links, in each position tick: rad, rad/s, drive torque at the joint Nm, shape (m, 3, n).
        friction_states: bristle deflection rad, input velocity rad/s, friction torque Nm, shape (m, 3, e).
        measured: what the controller was given, and the efforts by the current sensors, shape (k, 3, n).
        efforts: what it returned, Nm, shape (k, n); 0 where it returned None.
        powered: whether it returned efforts, shape (k,).
        saturated: ticks in which each amplifier was at its limit, shape (n,).
    """

    setup: Setup
    command_rate: int
    joint_states: Array
    friction_states: Array
    measured: Array
    efforts: Array
    powered: Mask
    saturated: NDArray[np.int64]

    @cached_property
    def series(self) -> dict[str, JointSeries]:
        """Return the series by topic, as a bag of the node holds them, for `write_joint_states` and comparisons."""
        joints = self.setup.robot.joint_names
        rates = self.setup.rates
        slow = rates.period_ns * rates.ratio
        commands = NANOSECONDS // self.command_rate
        series = (
            series_of("joint_states", joints, self.joint_states, slow),
            series_of("friction_states", self.setup.friction.names, self.friction_states, slow),
            series_of(MEASURED_JOINT_STATES, joints, self.measured, commands),
            series_of(JOINT_COMMANDS, joints, self.efforts, commands).take(self.powered),
        )
        return {one.topic.removeprefix("/"): one for one in series}


def run_controller(
    setup: Setup,
    controller: EffortController,
    duration: float,
    initial_position: ArrayLike | None = None,
    *,
    command_rate: int | None = None,
) -> ControllerRun:
    """Run an arm with a controller of one's own in this process, without ROS.

    Args:
        setup: the arm; its controller takes no part.
        controller: called with joint positions, velocities and time at the beginning of each period; what it returns is
            held until the next call.
        duration: simulated time, s.
        initial_position: joint positions at rest, rad, shape (n,); by default all zeros.
        command_rate: how often it is called, Hz; by default as often as the position loop, 1 kHz.

    Raises:
        ConfigError: if the duration is shorter than a tick, the rate does not divide the base rate, or the controller
            returns anything but a finite number for each joint or None.
        DivergenceError: naming joint and tick.
    """
    check_type(setup=(setup, Setup))
    setup.warn_of_friction()
    rates = setup.rates
    ticks = rates.ticks_of(duration)
    command_hz = rates.position_hz if command_rate is None else command_rate
    plant = setup.plant()
    n = len(setup.robot.joint_names)
    plant.reset(np.zeros(n) if initial_position is None else initial_position)
    joints = JointInterface(plant, rates, command_hz)
    rows = -(-ticks // rates.ratio)
    calls = -(-ticks // joints.ticks)
    with within_memory(ticks):
        joint_rows = np.empty((rows, 3, n))
        friction_rows = np.empty((rows, 3, len(setup.friction.names)))
        measured = np.empty((calls, 3, n))
        efforts = np.zeros((calls, n))
        powered = np.zeros(calls, dtype=np.bool_)
    no_torque = np.zeros(n)
    for k in range(calls):
        measured[k] = joints.measure()
        position, velocity = measured[k, :2].copy()
        stamp = plant.tick * rates.period_ns
        torques = no_torque
        # As a node computes it from header.stamp.
        time = stamp // NANOSECONDS + stamp % NANOSECONDS * 1e-9
        answer = controller(position, velocity, time)
        if answer is not None:
            efforts[k] = _checked(answer, n, time)
            powered[k] = True
            torques = joints.motor_torques(efforts[k])
        done, diverged = hold_torques(
            plant.constants, plant.state, torques, powered[k], plant.tick, min(joints.ticks, ticks - plant.tick),
            rates.ratio, joint_rows, friction_rows,
        )  # fmt: skip
        plant.tick += done
        if diverged >= 0:
            plant.raise_divergence(diverged)
    return ControllerRun(
        setup, command_hz, joint_rows, friction_rows, measured, efforts, powered, plant.saturated
    )


def _checked(answer: ArrayLike, joints: int, time: float) -> Array:
    """Return what a controller returned, checked."""
    try:
        effort = np.asarray(answer, dtype=np.float64)
    except (TypeError, ValueError):
        effort = np.empty(0)
    if effort.shape != (joints,) or not np.isfinite(effort).all():
        shown = f"{answer!r}"[:100]
        accepted = f"{joints} finite efforts, Nm, or None"
        raise ConfigError(f"the controller returned {shown} at {time:g} s; accepted: {accepted}")
    return effort
