"""The rig's joint with parts beyond LuGre's law: other bristles, load, ripple, scatter, by the arm's own steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from friction_bench.rig.shaft import BRISTLE_STEPS, Shaft, turn
from rx90_common.friction.compiled_elements import element_arrays
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.load import advance_load
from rx90_common.friction.parts.scatter import advance_scatter
from rx90_common.friction.parts.step import fill_parts, parts_dtype, parts_state_dtype, parts_step, reset_parts
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import lane, load

Record = NDArray[np.void]


class RigJoint(NamedTuple):
    """One joint as compiled code has it, each of shape (1,): element, its parts, and their state."""

    element: Record
    parts: Record
    state: Record


def joint_record(element: FrictionElement, gear_ratio: float, period: float, seed: int) -> RigJoint:
    """Return the record of a joint that has not moved.

    Args:
        element: its friction.
        gear_ratio: turns of the motor for one of the joint.
        period: for which the torque is held, s.
        seed: of the scatter.
    """
    record = RigJoint(element_arrays((element,)), np.zeros(1, parts_dtype(1)), np.zeros(1, parts_state_dtype(1)))
    fill_parts(record.parts[0], (element,), (gear_ratio,), period, seed)
    start(record)
    return record


@kernel
def start(joint: RigJoint) -> None:
    """Begin anew: nothing is transmitted, no bristle is bent."""
    state = joint.state[0]
    state.transmitted[0] = 0.0
    reset_parts(joint.parts[0], state, load(state.transmitted, 1), 1)


@kernel
def friction_over(joint: RigJoint, z: float, angle: float, velocity: float, step: float) -> tuple[float, float]:
    """Advance the joint's bristles for a velocity that is held; angle, rad, and velocity, rad/s, of the joint.

    Returns:
        The new deflection, rad, and the mean friction torque, Nm.
    """
    state = joint.state[0]
    lanes = 0.0 * load(state.transmitted, 1)
    new, torque = parts_step(
        joint.element[0], joint.parts[0], state, lanes + z, lanes + angle, lanes + velocity, step, 1
    )
    return lane(new, 0), lane(torque, 0)


@kernel
def turn_with_parts(
    motion: tuple[float, float, float],
    torque: float,
    shaft: Shaft,
    gear: tuple[float, float],
    load_inertia: float,
    joint: RigJoint,
    dt: float,
) -> tuple[float, float, float]:
    """Advance as `turn_with_joint`, with a joint that has parts.

    Args:
        motion: angle and speed of the motor, rad and rad/s, deflection of the bristles, rad.
        torque: of the motor, Nm.
        shaft: what turns at the motor.
        gear: its ratio and efficiency.
        load_inertia: beyond the joint, kg m^2: its torque is the load that the joint transmits.
        joint: advanced in place.
        dt: s.
    """
    angle, speed, z = motion
    ratio, efficiency = gear
    step, state = dt / BRISTLE_STEPS, joint.state[0]
    for _ in range(BRISTLE_STEPS):
        z, friction = friction_over(joint, z, angle / ratio, speed / ratio, step)
        before = speed
        angle, speed = turn(angle, speed, torque - friction / (ratio * efficiency), shaft, step)
        state.transmitted[0] = load_inertia * (speed - before) / (ratio * step)
        advance_load(joint.parts[0].load, state, load(state.transmitted, 1), step, 1)
    advance_scatter(joint.parts[0].scatter, state)
    return angle, speed, z
