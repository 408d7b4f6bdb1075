"""Transformations of mm, and their yaw, pitch and roll in degrees (Z, new Y, new Z)."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from pinocchio import SE3, Quaternion

from rx90_common.base.arrays import Array
from rx90_common.description.rotations import axis_rotation
from rx90_emulator.cabinet.arm import Joints

X, Y, Z = np.eye(3)
_SMALLEST = 1e-9
_UPRIGHT = 1.25e-4
"""Sine of the pitch below which yaw and roll are about one axis: the yaw is 0 then, and the roll has all.

A recording of an arm that stands up shows yaw and roll apart at 0.008 degrees, 1.4e-4.
"""


def turned(axis: Array, degrees: float) -> SE3:
    """Return the transformation that turns about a unit vector."""
    return SE3(axis_rotation(axis, math.radians(degrees)), np.zeros(3))


def six(numbers: Iterable[float | None]) -> list[float]:
    """Return numbers up to the sixth; what is left out is 0."""
    return [*(number or 0.0 for number in numbers), *[0.0] * 6][:6]


def trans(*numbers: float | None) -> SE3:
    """Return the transformation of x, y, z, yaw, pitch and roll; what is left out is 0."""
    *position, yaw, pitch, roll = six(numbers)
    turn = turned(Z, yaw) * turned(Y, pitch) * turned(Z, roll)
    return SE3(turn.rotation, np.array(position))


def six_numbers(place: SE3 | Joints) -> tuple[float, ...]:
    """Return x, y, z, yaw, pitch in 0 to 180, roll; of a precision point its joint values."""
    if isinstance(place, Joints):
        return place
    x, y, _ = place.rotation[:, 2]
    yaw = math.degrees(math.atan2(y, x)) if math.hypot(x, y) > _UPRIGHT else 0.0
    level = (turned(Z, -yaw) * place).rotation
    pitch = math.degrees(math.atan2(abs(level[0, 2]), level[2, 2]))
    roll = math.degrees(math.atan2(level[1, 0], level[1, 1]))
    return (*place.translation.tolist(), yaw, pitch, roll)


def frame(origin: SE3, on_x: SE3, beside: SE3, place: SE3) -> SE3:
    """Return the frame with X from the first place to the second, the third on the side of +Y, at the fourth.

    Raises:
        ValueError: if the three lie on one line.
    """
    x = on_x.translation - origin.translation
    z = np.cross(x, beside.translation - origin.translation)
    if not np.linalg.norm(z) > _SMALLEST:
        raise ValueError
    axes = np.column_stack([x, np.cross(z, x), z])
    return SE3(axes / np.linalg.norm(axes, axis=0), place.translation)


def aligned(place: SE3) -> SE3:
    """Return a place turned so that its z points along the nearest axis of the world."""
    z = place.rotation[:, 2]
    nearest = np.sign(z) * np.eye(3)[np.argmax(np.abs(z))]
    turn = Quaternion.FromTwoVectors(z, nearest)
    return SE3(turn.matrix() @ place.rotation, place.translation)
