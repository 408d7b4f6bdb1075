"""Transformations: 4 x 4 arrays of mm, and their yaw, pitch and roll in degrees (Z, new Y, new Z)."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.rotations import axis_rotation

X, Y, Z = np.eye(3)
_SMALLEST = 1e-9
_UPRIGHT = 1.25e-4
"""Sine of the pitch below which yaw and roll are about one axis: the yaw is 0 then, and the roll has all.

A recording of an arm that stands up shows yaw and roll apart at 0.008 degrees, 1.4e-4.
"""


def placed(rotation: Array, position: Array) -> Array:
    """Return the transformation of a rotation and a position."""
    return np.block([[rotation, position[:, None]], [0.0, 0.0, 0.0, 1.0]])


def turned(axis: Array, degrees: float) -> Array:
    """Return the transformation that turns about a unit vector."""
    return placed(axis_rotation(axis, math.radians(degrees)), np.zeros(3))


def six(numbers: Iterable[float | None]) -> list[float]:
    """Return numbers up to the sixth; what is left out is 0."""
    return [*(number or 0.0 for number in numbers), *[0.0] * 6][:6]


def trans(*numbers: float | None) -> Array:
    """Return the transformation of x, y, z, yaw, pitch and roll; what is left out is 0."""
    x, y, z, yaw, pitch, roll = six(numbers)
    place = turned(Z, yaw) @ turned(Y, pitch) @ turned(Z, roll)
    place[:3, 3] = x, y, z
    return place


def six_numbers(place: Array) -> tuple[float, ...]:
    """Return x, y, z, yaw, pitch in 0 to 180, roll."""
    yaw = 0.0
    if math.hypot(place[0, 2], place[1, 2]) > _UPRIGHT:
        yaw = math.degrees(math.atan2(place[1, 2], place[0, 2]))
    level = turned(Z, -yaw) @ place
    pitch = math.degrees(math.atan2(abs(level[0, 2]), level[2, 2]))
    roll = math.degrees(math.atan2(level[1, 0], level[1, 1]))
    return (*place[:3, 3].tolist(), yaw, pitch, roll)


def inverse(place: Array) -> Array:
    """Return the inverse."""
    back = place[:3, :3].T
    return placed(back, -back @ place[:3, 3])


def frame(origin: Array, on_x: Array, beside: Array, place: Array) -> Array:
    """Return the frame with X from the first place to the second, the third on the side of +Y, at the fourth.

    Raises:
        ValueError: if the three lie on one line.
    """
    x = on_x[:3, 3] - origin[:3, 3]
    z = np.cross(x, beside[:3, 3] - origin[:3, 3])
    if not np.linalg.norm(z) > _SMALLEST:
        raise ValueError
    axes = np.column_stack([x, np.cross(z, x), z])
    return placed(axes / np.linalg.norm(axes, axis=0), place[:3, 3])


def aligned(place: Array) -> Array:
    """Return a place turned so that its z points along the nearest axis of the world."""
    z = place[:3, 2]
    nearest = np.sign(z) * np.eye(3)[np.argmax(np.abs(z))]
    normal = np.cross(z, nearest)
    sine = float(np.linalg.norm(normal))
    if sine < _SMALLEST:
        return place
    turn = axis_rotation(normal / sine, math.asin(min(sine, 1.0)))
    return placed(turn @ place[:3, :3], place[:3, 3])
