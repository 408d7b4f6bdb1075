"""The seven friction elements among the six joints of an arm: element 7 turns with joints 5 and 6, as motor 6 does.

Whoever steps the friction of a whole arm, plant or controller, goes from joints to elements and back by these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rx90_common.base.arrays import Array
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.step import fill_parts
from rx90_common.kernels.compiled import inlined
from rx90_common.kernels.lanes import Lanes, append, first, lane, load, store


@inlined
def element_inputs(joint: Array) -> Lanes:
    """Return the angles or velocities of the seven elements, which are also the brakes', for those of the joints."""
    return append(load(joint, 6), joint[4] + joint[5])


@inlined
def add_to_joints(joint: Array, torque: Lanes) -> None:
    """Add the torques of the seven elements to those of the joints, Nm, shape (6,)."""
    store(joint, load(joint, 6) + first(torque, 6))
    wrist = lane(torque, 6)
    joint[4] += wrist
    joint[5] += wrist


@inlined
def transmit(rotor: Array, torque: Array, acceleration: Array, transmitted: Array) -> None:
    """Write what goes through the seven elements on to the links, Nm, shape (7,).

    Motor 6 turns with joints 5 and 6, so what goes on to link 6 goes through element 7 and element 6.

    Args:
        rotor: share of the rotors in the mass matrix, kg m^2, shape (6, 6).
        torque: of the drives less friction, at the joints, Nm, shape (6,).
        acceleration: of the rotors, seen at the joints, rad/s^2, shape (6,).
        transmitted: overwritten.
    """
    for i in range(6):
        transmitted[i] = torque[i]
        for j in range(6):
            transmitted[i] -= rotor[i, j] * acceleration[j]
    share_among_elements(transmitted)


@inlined
def share_among_elements(transmitted: Array) -> None:
    """Make the torques of the six joints, Nm, those of the seven elements, shape (7,)."""
    transmitted[4] -= transmitted[5]
    transmitted[6] = transmitted[5]


@inlined
def of_motors(motor: Lanes) -> Lanes:
    """Return what belongs to the motor of each of the seven elements, for the six motors.

    Motor 6 is that of the seventh; the sixth has none, and what it gets here must not count.
    """
    return append(motor, lane(motor, 5))


def fill_arm_parts(
    record: Any,
    elements: Sequence[FrictionElement],
    gear: Array,
    motor_heat: Array,
    period: float,
    seed: int = 0,
) -> None:
    """Write the parts of an arm's elements; the angle of a motor is that of its element times the gear ratio.

    Args:
        record: of `parts_dtype(7)`, zero before.
        elements: seven.
        gear: turns of the motors for a turn of the joints, shape (6,).
        motor_heat: of the motors, W for the square of the torque in Nm, shape (6,).
        period: of a tick, s.
        seed: of the scatter.
    """
    # Motor 6 turns with joints 5 and 6 together, as the seventh element does, and warms that one alone.
    heat = motor_heat.tolist()
    fill_parts(record, elements, [*gear.tolist(), float(gear[5])], period, seed, [*heat[:5], 0.0, heat[5]])
