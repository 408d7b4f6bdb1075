"""Friction compensation whose bristles follow the measured velocity, instead of the set-points': what it would be like.

The observer of Canudas de Wit, Olsson, Astrom and Lischinsky (1995) with the exact bristle step, every base tick, seven
elements:

    dz/dt = v - |v| / g(v) z + k e        v: measured velocity, e: position error, set-point minus measured

The controller of the product has none of it; this is the evidence why.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rx90_common.base.arrays import Array, Record
from rx90_common.description.drives import to_joint, to_motor_torque
from rx90_common.friction.arm_elements import add_to_joints, element_inputs
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import element_arrays, load_elements
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load, store
from rx90_controller.law.loops import position_loop, velocity_loop
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.line import PathAccuracy, path_accuracy, plan_line
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant_step import plant_step

WORKSPACE = np.dtype(
    [
        ("z", np.float64, 7),
        ("velocity", np.float64, 6),
        ("error", np.float64, 6),
        ("joint", np.float64, 6),
        ("motor", np.float64, 6),
        ("held", np.float64, 6),
    ]
)


def run_measured(setup: Setup, task: LineTask, gain: float) -> tuple[PathAccuracy, Array]:
    """Run a line with the friction of the setup's model fed forward by measured velocities.

    Args:
        setup: its controller has `inverse_dynamics` on and the other parts for friction off.
        task: the line.
        gain: k, 1/s.

    Returns:
        The path error, and the joint positions, rad, shape (m, 6).
    """
    plan = plan_line(setup, task)
    plant, controller = setup.plant(), setup.cs7b()
    plant.reset(plan.start_pose)
    controller.reset(plant.motor_states()[0])
    controller.trajectory.accept(plan.points, 0, 0)
    rates = setup.rates
    count = rates.ticks_of(plan.duration) // rates.ratio
    setpoints, position = controller.trajectory.setpoints(0, count), np.empty((count, 6))
    model = setup.controller.model
    assert model is not None
    work = np.zeros(1, WORKSPACE)
    arguments = (
        plant.constants,
        plant.state,
        controller.law,
        controller.state,
        element_arrays(model.constants.friction),
        work,
    )
    _run(*arguments, setpoints, rates.ratio, gain, rates.period, position)
    times = np.arange(count) * rates.position_period
    return path_accuracy(setup.robot, task, times, position), position


@kernel
def _run(
    plants: Record,
    plant_states: Record,
    laws: Record,
    law_states: Record,
    elements: Record,
    work: Record,
    setpoints: Array,
    ratio: int,
    gain: float,
    period: float,
    position: Array,
) -> None:
    plant, law, own = plant_states[0], law_states[0], work[0]
    gear = laws[0].gear
    for k in range(len(setpoints) * ratio):
        row = k // ratio
        if k % ratio == 0:
            position[row] = plant.q
            position_loop(laws, law_states, setpoints[row], plant.motor_position, plant.motor_velocity)
            to_joint(gear, law.error, own.error)
            own.held[:] = law.feed_forward
        to_joint(gear, plant.motor_velocity, own.velocity)
        _add_friction(elements[0], own, gear, gain, period)
        for i in range(6):
            law.feed_forward[i] = own.held[i] + own.motor[i]
        velocity_loop(laws, law_states, plant.motor_velocity)
        plant_step(plants, plant_states, law.command, True)


@kernel
def _add_friction(elements: Any, own: Any, gear: Array, gain: float, period: float) -> None:
    z, torque = bristle_step(load_elements(elements, 7), load(own.z, 7), element_inputs(own.velocity), period)
    store(own.z, z + gain * period * element_inputs(own.error))
    own.joint[:] = 0.0
    add_to_joints(own.joint, torque)
    to_motor_torque(gear, own.joint, own.motor)
