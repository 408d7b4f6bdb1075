"""The friction elements among the joints of an arm: one for each joint, and one for each motor that turns with several.

Code that steps the friction of a whole arm, plant or controller, converts from joints to elements and back with these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rx90_common.base.arrays import Array
from rx90_common.description.coupling import Coupling, by_gear, times, times_lanes
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.step import fill_parts
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, append, first, lane, load, size, store


def _element_inputs_of_wrist(_gear: Array, joint: Array) -> Lanes:
    return append(load(joint, 6), joint[4] + joint[5])


@by_gear(_element_inputs_of_wrist)
def element_inputs(gear: Any, joint: Array) -> Lanes:
    """Return the angles or velocities of the elements, which are also the brakes', for those of the joints."""
    return times(gear.element_columns, joint)


def _add_to_joints_of_wrist(_gear: Array, joint: Array, torque: Lanes) -> None:
    store(joint, load(joint, 6) + first(torque, 6))
    wrist = lane(torque, 6)
    joint[4] += wrist
    joint[5] += wrist


@by_gear(_add_to_joints_of_wrist)
def add_to_joints(gear: Any, joint: Array, torque: Lanes) -> None:
    """Add the torques of the elements to those of the joints, Nm, shape (n,)."""
    store(joint, load(joint, size(gear.ratio)) + times_lanes(gear.element, torque))


@inlined
def transmit(
    gear: Any, rotor: Array, torque: Array, acceleration: Array, transmitted: Array
) -> None:
    """Write the torque that passes through the elements to the links, Nm, shape (e,).

    Args:
        gear: of the arm.
        rotor: share of the rotors in the mass matrix, kg m^2, shape (n, n).
        torque: of the drives less friction, at the joints, Nm, shape (n,).
        acceleration: of the rotors, converted to the joints, rad/s^2, shape (n,).
        transmitted: overwritten.
    """
    for i in range(size(rotor)):
        transmitted[i] = torque[i]
        for j in range(size(rotor)):
            transmitted[i] -= rotor[i, j] * acceleration[j]
    share_among_elements(gear, transmitted)


def _share_among_elements_of_wrist(_gear: Array, transmitted: Array) -> None:
    transmitted[4] -= transmitted[5]
    transmitted[6] = transmitted[5]


@by_gear(_share_among_elements_of_wrist)
def share_among_elements(gear: Any, transmitted: Array) -> None:
    """Convert the torques of the n joints, Nm, to those of the elements, shape (e,).

    A motor's element transmits the motor's torque, the element of a joint without a motor of its own the joint's
    torque: on a wrist whose motor 6 turns with joints 5 and 6, the torque of link 6 passes through both.
    """
    store(transmitted, times(gear.passed, transmitted))


def _element_of_motor_of_wrist(_gear: Array, motor: int) -> int:
    return motor if motor < 5 else 6


@by_gear(_element_of_motor_of_wrist)
def element_of_motor(gear: Any, motor: int) -> int:
    """Return the number of the element, and of the brake, that turns with a motor."""
    element: int = gear.element_of_motor[motor]
    return element


def _of_motors_of_wrist(_gear: Array, motor: Lanes) -> Lanes:
    return append(motor, lane(motor, 5))


@by_gear(_of_motors_of_wrist)
def of_motors(gear: Any, motor: Lanes) -> Lanes:
    """Return the value of each element's motor, from values of the motors; both lanes.

    The element of a joint without a motor of its own gets a value that must not be used.
    """
    return times_lanes(gear.belongs, motor)


def fill_arm_parts(
    record: Any,
    elements: Sequence[FrictionElement],
    coupling: Coupling,
    gear: Array,
    motor_heat: Array,
    period: float,
    seed: int = 0,
) -> None:
    """Write the parts of an arm's elements; the angle of a motor is that of its element times the gear ratio.

    Args:
        record: of `parts_dtype` for as many elements, zero before.
        elements: of the arm.
        coupling: of its motors.
        gear: turns of the motors for a turn of the joints, shape (n,).
        motor_heat: of the motors, W for the square of the torque in Nm, shape (n,).
        period: of a tick, s.
        seed: of the scatter.
    """
    # A motor that turns with several joints warms the element that turns with it, and no joint's own.
    sums = [float(gear[i]) for i in coupling.sums]
    fill_parts(
        record,
        elements,
        [*gear.tolist(), *sums],
        period,
        seed,
        coupling.of_elements(motor_heat.tolist(), 0.0),
    )
