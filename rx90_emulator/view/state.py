"""What is known of an arm at one time."""

from __future__ import annotations

from dataclasses import dataclass

from rx90_common.base.arrays import Array


@dataclass(frozen=True, eq=False)
class ElementState:
    """The friction elements at one time: one for each joint, and one for the coupled wrist.

    Attributes:
        deflection: (7,) of the bristles, rad.
        velocity: (7,) that the elements see, rad/s.
        torque: (7,) friction, Nm.
    """

    deflection: Array
    velocity: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class ArmState:
    """An arm at one time, from running nodes or from a bag.

    Attributes:
        time: simulated, s.
        position: (6,) rad.
        velocity: (6,) rad/s.
        torque: (6,) of the drives, Nm.
        friction: the friction elements, where they are known.
    """

    time: float
    position: Array
    velocity: Array
    torque: Array
    friction: ElementState | None = None
