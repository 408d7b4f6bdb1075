"""Plant and controller in one compiled loop: tick k samples, commands, steps, as the nodes do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Record
from rx90_common.base.errors import SupervisionError, check_type
from rx90_common.description.coupling import to_joint, to_joint_torque
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.lanes import load, size, store
from rx90_controller.law.cs7b import CS7B, position_loop, velocity_loop
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_controller.trajectory.correction import Correction
from rx90_emulator.loop.learned_motion import check_correction
from rx90_emulator.loop.result import FastSeries, MotionCommand, RunResult, SlowSeries, empty_series
from rx90_emulator.loop.setup import Setup
from rx90_sim.drives import warm_motors
from rx90_sim.plant import Plant
from rx90_sim.plant_step import friction_states, plant_step

SetpointSource = Callable[[TrajectoryGenerator, Sequence[MotionCommand], int], Array]

TRIPPED = -2
"""How a run ends in which the controller's supervision cuts the power."""


@kernel
def run_ticks(
    plants: Record,
    plant_states: Record,
    laws: Record,
    law_states: Record,
    setpoints: Array,
    ratio: int,
    warm_ticks: int,
    first: int,
    ticks: int,
    fast: FastSeries,
    slow: SlowSeries,
) -> tuple[int, int]:
    """Run base ticks `first` to `first + ticks - 1`.

    Args:
        plants: constants of the plant.
        plant_states: state of the plant, advanced in place.
        laws: constants of the control law.
        law_states: state of the control law, advanced in place.
        setpoints: one for each position tick from tick 0 on, shape (m, 3, n), or with offsets (m, 4, n).
        ratio: base ticks in a position tick.
        warm_ticks: base ticks in a row of temperatures.
        first: number of the first tick.
        ticks: how many ticks.
        fast: series to write, or arrays of length 0 to write nothing.
        slow: series to write.

    Returns:
        How many ticks were run, and -1; or the joint that diverged in the last of them; or TRIPPED, if the
        controller's supervision cut the power in the tick after them.
    """
    state = plant_states[0]
    law = law_states[0]
    n = size(state.q)
    sensed = plants[0].sensor.used
    for k in range(first, first + ticks):
        row = k // ratio
        setpoint = setpoints[k // ratio]
        slow_tick = k % ratio == 0
        if slow_tick:
            # By lanes: assigning slices takes numba longer, an eighth of a tick in all.
            store(slow.joint_states[row, 0], load(state.q, n))
            store(slow.joint_states[row, 1], load(state.v, n))
            store(slow.joint_states[row, 2], load(state.drive_torque, n))
            store(slow.friction_states[row, 0], load(state.z, size(state.z)))
            friction_states(
                plants, plant_states, slow.friction_states[row, 1], slow.friction_states[row, 2]
            )
            if position_loop(
                laws, law_states, setpoint, state.motor_position, state.motor_velocity
            ):
                return k - first, TRIPPED
        velocity_loop(laws, law_states, state.motor_velocity)
        if slow_tick:
            _keep_law(laws[0].gear, law, setpoint, row, slow)
            if sensed:
                store(
                    slow.details[row, 2],
                    load(state.sensor.torque, n) / load(laws[0].torque_constant, n),
                )
        if slow.temperatures.shape[0] > 0 and k % warm_ticks == 0:
            slow.temperatures[k // warm_ticks] = state.parts.temperature.temperature
            slow.windings[k // warm_ticks] = state.temperature
        if fast.motor_commands.shape[0] > 0:
            store(fast.motor_states[k, 0], load(state.motor_position, n))
            store(fast.motor_states[k, 1], load(state.motor_velocity, n))
            store(
                fast.motor_states[k, 2],
                load(state.sensor.torque if sensed else state.motor_torque, n),
            )
            store(fast.motor_commands[k], load(law.command, n))
        joint = plant_step(plants, plant_states, law.command, True)
        if joint >= 0:
            return k + 1 - first, joint
    return ticks, -1


@inlined
def _keep_law(gear: Any, law: Any, setpoint: Array, row: int, slow: SlowSeries) -> None:
    """Write the row of what the control law makes of a set-point, shape (3, n)."""
    n = size(law.error)
    store(slow.reference[row, 0], load(setpoint[0], n))
    store(slow.reference[row, 1], load(setpoint[1], n))
    to_joint_torque(gear, law.feed_forward, slow.reference[row, 2])
    to_joint(gear, law.error, slow.tracking_error[row, 0])
    to_joint(gear, law.velocity_error, slow.tracking_error[row, 1])
    to_joint_torque(gear, law.command, slow.tracking_error[row, 2])
    store(slow.details[row, 0], load(setpoint[2], n))
    store(slow.details[row, 1], load(law.commanded, n))
    store(slow.details[row, 2], load(law.current, n))


def simulate(
    setup: Setup,
    points: TrajectoryPoints,
    initial_position: ArrayLike | None = None,
    duration: float | None = None,
    start_time: float = 0.0,
    correction: Correction | None = None,
    record_fast: bool = False,
) -> RunResult:
    """Run the closed loop without ROS.

    Args:
        setup: robot, drives, friction, controller, rates.
        points: the trajectory.
        initial_position: joint positions at rest, rad, shape (n,); by default the trajectory's first point.
        duration: simulated time, s; by default until the trajectory ends.
        start_time: when the trajectory starts, s.
        correction: offsets of the position set-points, as `learn_correction` finds them.
        record_fast: also keep the series on base ticks.

    Raises:
        ConfigError: if the duration is shorter than a tick, a time is not finite, or the correction
            was learned on another one, or on another robot.
        TrajectoryError: if the trajectory is refused.
        DivergenceError: naming joint and tick.
        SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
    """
    check_type(setup=(setup, Setup), points=(points, TrajectoryPoints))
    end = start_time + float(points.times[-1]) if duration is None else duration
    command = MotionCommand(setup.rates.start_tick(start_time), points, correction)
    start = points.position[0] if initial_position is None else initial_position
    return simulate_commands(setup, (command,), start, end, record_fast=record_fast)


def simulate_commands(
    setup: Setup,
    commands: Sequence[MotionCommand],
    initial_position: ArrayLike,
    duration: float,
    *,
    substeps: int | None = None,
    record_fast: bool = False,
    warn: bool = True,
    sample: SetpointSource | None = None,
) -> RunResult:
    """Run the closed loop without ROS along several trajectories.

    Args:
        setup: robot, drives, friction, controller, rates.
        commands: in the order of their start; each replaces the one before it at its start.
        initial_position: joint positions at rest, rad, shape (n,).
        duration: simulated time, s.
        substeps: plant steps in a tick; None for as many as the arm needs, usually 1.
        record_fast: also keep the series on base ticks.
        warn: of what means less than it seems to.
        sample: where set-points come from, in place of `setpoints_of`.

    Raises:
        ConfigError: if a correction was learned on another robot or trajectory.
        TrajectoryError: if a trajectory is refused.
        DivergenceError: naming joint and tick.
        SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
    """
    for _, points, correction in commands:
        if points is not None and correction is not None:
            check_correction(setup, points, correction, "the correction")
    if warn:
        setup.warn_of_friction()
    rates = setup.rates
    ticks = rates.ticks_of(duration)
    plant = setup.plant(substeps)
    controller = setup.cs7b()
    plant.reset(initial_position)
    controller.reset(plant.motor_states()[0])
    warm = bool(plant.constants["parts"]["temperature"]["used"][0]) or setup.drives.winding.used
    fast, slow = empty_series(
        ticks,
        rates.ratio,
        record_fast,
        rates.temperature_ticks if warm else 0,
        arm=setup.drives.turning.size,
    )
    setpoints = (sample or setpoints_of)(controller.trajectory, commands, len(slow.joint_states))
    run_setpoints(plant, controller, setpoints, ticks, fast, slow)
    if warn:
        setup.warn_of_heat(slow.temperatures)
    slow = slow._replace(
        correction=np.ascontiguousarray(setpoints[:, 3:].reshape(-1, setpoints.shape[2]))
    )
    return RunResult(
        setup,
        fast if record_fast else None,
        slow,
        controller.saturated,
        tuple(commands),
        plant.substeps,
    )


def setpoints_of(
    generator: TrajectoryGenerator, commands: Sequence[MotionCommand], count: int
) -> Array:
    """Return the set-points of `count` position ticks, (count, 3, n); with a correction's offsets (count, 4, n)."""
    parts = []
    at = 0
    for start, points, correction in commands:
        begin = min(max(start, at), count)
        parts.append(generator.corrected(at, begin - at))
        at = begin
        if points is None:
            generator.stop(begin, start)
        else:
            generator.accept(points, begin, start, correction)
    parts.append(generator.corrected(at, count - at))
    rows = max(part.shape[1] for part in parts)
    return np.concatenate(
        [np.pad(part, ((0, 0), (0, rows - part.shape[1]), (0, 0))) for part in parts]
    )


def run_setpoints(
    plant: Plant, controller: CS7B, setpoints: Array, ticks: int, fast: FastSeries, slow: SlowSeries
) -> None:
    """Run `ticks` base ticks from tick 0 along set-points, one for each position tick, shape (m, 3, n).

    Raises:
        DivergenceError: naming joint and tick.
        SupervisionError: naming joint, value, limit and time, if the controller's supervision cuts the power.
    """
    rates = controller.rates
    done, end = run_ticks(
        plant.constants, plant.state, controller.law, controller.state, setpoints, rates.ratio,
        rates.temperature_ticks, 0, ticks, fast, slow,
    )  # fmt: skip
    plant.tick = controller.tick = done
    if end >= 0:
        plant.raise_divergence(end)
    if end == TRIPPED:
        controller.note_fault()
        warm = warm_motors(plant.constants, plant.winding_temperatures())
        cut = f"{controller.fault}; the controller's supervision has cut the power"
        raise SupervisionError(f"{cut}; {warm}" if warm else cut)
