"""Transformations: 4 x 4 arrays of mm, and their yaw, pitch and roll in degrees (Z, new Y, new Z)."""

from __future__ import annotations

import math

import numpy as np

from rx90_common.base.arrays import Array

_ALIGNED = 1e-9
"""Sine of the pitch below which yaw and roll are about one axis: the yaw is 0 then, and the roll has all."""


def turn_z(degrees: float) -> Array:
    """Return the rotation about z, shape (3, 3)."""
    sine = math.sin(math.radians(degrees))
    cosine = math.cos(math.radians(degrees))
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def turn_y(degrees: float) -> Array:
    """Return the rotation about y, shape (3, 3)."""
    sine = math.sin(math.radians(degrees))
    cosine = math.cos(math.radians(degrees))
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def turn_x(degrees: float) -> Array:
    """Return the rotation about x, shape (3, 3)."""
    sine = math.sin(math.radians(degrees))
    cosine = math.cos(math.radians(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])


def placed(rotation: Array, position: Array) -> Array:
    """Return the transformation of a rotation and a position."""
    whole = np.eye(4)
    whole[:3, :3] = rotation
    whole[:3, 3] = position
    return whole


def trans(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0
) -> Array:
    """Return the transformation of six numbers."""
    return placed(turn_z(yaw) @ turn_y(pitch) @ turn_z(roll), np.array([x, y, z]))


def six_numbers(transformation: Array) -> tuple[float, ...]:
    """Return x, y, z, yaw, pitch in 0 to 180, roll."""
    r = transformation[:3, :3]
    sine = math.hypot(r[0, 2], r[1, 2])
    pitch = math.atan2(sine, r[2, 2])
    if sine > _ALIGNED:
        yaw = math.atan2(r[1, 2], r[0, 2])
        roll = math.atan2(r[2, 1], -r[2, 0])
    else:
        yaw = 0.0
        roll = math.atan2(r[1, 0], r[1, 1])
    x, y, z = transformation[:3, 3].tolist()
    return (x, y, z, math.degrees(yaw), math.degrees(pitch), math.degrees(roll))


def inverse(transformation: Array) -> Array:
    """Return the inverse."""
    back = transformation[:3, :3].T
    return placed(back, -back @ transformation[:3, 3])


def frame(origin: Array, on_x: Array, beside: Array, place: Array) -> Array | None:
    """Return the frame with X from the first location to the second, the third on the side of +Y, at the fourth.

    None where the three lie on one line.
    """
    x = on_x[:3, 3] - origin[:3, 3]
    z = np.cross(x, beside[:3, 3] - origin[:3, 3])
    if not np.linalg.norm(x) > _ALIGNED or not np.linalg.norm(z) > _ALIGNED:
        return None
    x = x / np.linalg.norm(x)
    z = z / np.linalg.norm(z)
    return placed(np.column_stack([x, np.cross(z, x), z]), place[:3, 3])


def aligned(transformation: Array) -> Array:
    """Return the transformation turned so that its z points along the nearest axis of the world."""
    z = transformation[:3, 2]
    axis = int(np.argmax(np.abs(z)))
    wanted = np.zeros(3)
    wanted[axis] = math.copysign(1.0, z[axis])
    normal = np.cross(z, wanted)
    sine = float(np.linalg.norm(normal))
    if sine < _ALIGNED:
        return transformation
    turn = rotation_about(normal / sine, math.atan2(sine, float(z @ wanted)))
    return placed(turn @ transformation[:3, :3], transformation[:3, 3])


def rotation_about(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit vector by an angle, rad."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn: Array = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return turn


def axis_and_angle(rotation: Array) -> tuple[Array, float]:
    """Return the axis of a rotation, a unit vector, and its angle in 0 to pi, rad."""
    from scipy.spatial.transform import Rotation  # takes a while

    vector = Rotation.from_matrix(rotation).as_rotvec()
    angle = float(np.linalg.norm(vector))
    return (vector / angle if angle > 0.0 else np.array([0.0, 0.0, 1.0])), angle
