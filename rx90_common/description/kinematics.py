"""Kinematics of the tool centre point, for one pose or many at once, path errors, and transforms from link to link.

Every function takes joint angles of shape (..., n) and broadcasts over the leading axes. `tip_position`, for
evaluations, is fast, and does not give the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array, Index
from rx90_common.description.chain import RigidChain
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import (
    axis_rotation_by_component,
    cross_matrix,
    dot,
    length,
    product,
    rotated,
)
from rx90_common.kernels.elementary import sines_cosines


class Pose(NamedTuple):
    """Tool centre point in the base frame: position (..., 3) in m, rotation (..., 3, 3)."""

    position: Array
    rotation: Array


class _Frames(NamedTuple):
    center: Array  # (..., n, 3) joint centres in the base frame, m
    axis: Array  # (..., n, 3) joint axes in the base frame
    tcp: Pose


def _poses(chain: RigidChain, q: Array) -> Iterator[Pose]:
    """Yield for each joint where it is, and the orientation of the link before it; then the tool centre point."""
    q = np.asarray(q, dtype=np.float64)
    rotation = np.broadcast_to(np.eye(3), (*q.shape[:-1], 3, 3))
    position = np.moveaxis(np.zeros((3, *q.shape[:-1])), 0, -1)  # by component, as the rotations
    for i, (origin, axis) in enumerate(zip(chain.origin, chain.axis, strict=True)):
        position = position + rotated(rotation, origin)
        yield Pose(position, rotation)
        rotation = product(rotation, axis_rotation_by_component(axis, q[..., i]))
    yield Pose(
        position + rotated(rotation, chain.tcp_position), product(rotation, chain.tcp_rotation)
    )


def _frames(chain: RigidChain, q: Array) -> _Frames:
    *joints, tcp = _poses(chain, q)
    axes = [rotated(joint.rotation, axis) for joint, axis in zip(joints, chain.axis, strict=True)]
    return _Frames(
        np.stack([joint.position for joint in joints], axis=-2), np.stack(axes, axis=-2), tcp
    )


def forward(chain: RigidChain, q: Array) -> Pose:
    """Return the pose of the tool centre point at `q` (..., n) rad."""
    *_, tcp = _poses(chain, q)
    return Pose(np.ascontiguousarray(tcp.position), np.ascontiguousarray(tcp.rotation))


def jacobian(chain: RigidChain, q: Array) -> Array:
    """Return the geometric Jacobian (..., 6, n) of the tool centre point in base axes.

    Rows 0-2 give its velocity in m/s, rows 3-5 the angular velocity in rad/s, per rad/s of each joint.
    """
    frames = _frames(chain, q)
    arm = frames.tcp.position[..., None, :] - frames.center
    columns = np.concatenate([np.cross(frames.axis, arm), frames.axis], axis=-1)
    return np.ascontiguousarray(np.swapaxes(columns, -1, -2))


def bias_acceleration(chain: RigidChain, q: Array, velocity: Array) -> Array:
    """Return dJ/dt·q̇ (..., 6): the acceleration (m/s², rad/s²) of the tool centre point where q̈ = 0."""
    frames = _frames(chain, q)
    spin = frames.axis * np.asarray(velocity)[..., None]
    omega = np.cumsum(spin, axis=-2)  # of each link
    # An axis turns with the link before it; that link's own spin about the axis does not matter.
    alpha = np.cumsum(np.cross(omega - spin, spin), axis=-2)
    ends = np.concatenate([frames.center[..., 1:, :], frames.tcp.position[..., None, :]], axis=-2)
    lever = ends - frames.center
    linear = np.cross(alpha, lever) + np.cross(omega, np.cross(omega, lever))
    return np.concatenate([np.cumsum(linear, axis=-2)[..., -1, :], alpha[..., -1, :]], axis=-1)


class PathError(NamedTuple):
    """Deviation of points from a path, such as the straight line between two points.

    Attributes:
        along: (n,) distance from the start, measured along the path, m; below 0 or above its length beyond an end.
        perpendicular: (n,) distance from the path, extended by straight lines beyond its ends, m; this is the path
            error.
    """

    along: Array
    perpendicular: Array


def decompose(vectors: Array, direction: Array) -> tuple[Array, Array]:
    """Split vectors (n, 3) into the part along `direction` (n,) and the part across it (n, 3)."""
    unit = np.asarray(direction) / length(np.asarray(direction))
    along = dot(np.asarray(vectors), unit)
    return along, vectors - along[..., None] * unit


def path_error(positions: Array, start: Array, end: Array) -> PathError:
    """Compare the tip's positions (n, 3) in m with the straight line from `start` (3,) to `end` (3,).

    Raises:
        ValueError: if start and end are the same point.
    """
    direction = np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64)
    if not direction.any():
        raise ValueError("a line needs two different points")
    along, across = decompose(positions - np.asarray(start), direction)
    return PathError(along, length(across))


def nearest_corner(points: Array, corners: Array, near: Index | None = None) -> Index:
    """Return which of `corners`, (m, 3) m, is nearest to each of `points`, (n, 3) m; shape (n,).

    Args:
        points: m.
        corners: m.
        near: where to start the search, (n,): the next local minimum from there; None for everywhere. A path that
            crosses itself has more than one.
    """
    if near is None:
        from scipy.spatial import cKDTree  # here, because it takes its time to import

        return np.asarray(cKDTree(corners).query(points)[1])
    found = np.array(near)
    rows = np.arange(len(points))
    around = np.array([0, -1, 1])
    while len(rows):
        neighbours = np.clip(found[rows, None] + around, 0, len(corners) - 1)
        off = np.sum((corners[neighbours] - points[rows, None]) ** 2, axis=2)
        closest = neighbours[np.arange(len(rows)), np.argmin(off, axis=1)]
        moved = closest != found[rows]
        found[rows] = closest
        rows = rows[moved]
    return found


def polyline_error(points: Array, corners: Array, near: Index | None = None) -> PathError:
    """Compare points (n, 3) in m with the straight lines through `corners`, (m, 3) m, m >= 2, all different neighbours.

    Of the lines those count that meet in the nearest corner: corners lie closer than a path bends or comes back. Beyond
    both ends the first and the last line go on. `near` is that of `nearest_corner`.
    """
    lines = np.diff(corners, axis=0)
    last = len(corners) - 2
    ways = length(lines)
    distance = np.concatenate([[0.0], np.cumsum(ways)])
    nearest = nearest_corner(points, corners, near)
    along = np.empty(len(points))
    across = np.full(len(points), np.inf)
    for line in (np.clip(nearest - 1, 0, last), np.clip(nearest, 0, last)):
        off = points - corners[line]
        at = np.sum(off * lines[line], axis=1) / ways[line]
        at = np.clip(
            at, np.where(line == 0, -np.inf, 0.0), np.where(line == last, np.inf, ways[line])
        )
        gap = length(off - (at / ways[line])[:, None] * lines[line])
        closer = gap < across
        along[closer] = (distance[line] + at)[closer]
        across[closer] = gap[closer]
    return PathError(along, across)


def tip_position(chain: RigidChain, q: Array) -> Array:
    """Return the tool centre points (n, 3) in m at `q` (n, joints) rad.

    `kinematics.forward` without the rotations: the point is carried from the tip to the base, which costs an eighth of
    the time.
    """
    # in columns a row for each coordinate: half the time of rows
    angles = np.ascontiguousarray(q.T)
    sine, cosine = sines_cosines(angles)  # compiled: a twentieth of NumPy's time
    point = np.broadcast_to(chain.tcp_position[:, None], (3, len(q)))
    for i in range(len(chain.axis) - 1, -1, -1):
        cross = cross_matrix(chain.axis[i])
        turned = cross @ point
        twice = cross @ cross @ point
        turned *= sine[i]
        twice *= 1.0 - cosine[i]
        point = point + turned
        point += twice
        point += chain.origin[i][:, None]
    return point.T


class LinkTransforms:
    """Transforms from parent to child links, one for each joint that turns, or for each that is fixed.

    Args:
        robot: with its tool.
        fixed: which joints.

    Attributes:
        links: names of parent and child.
        translation: (n, 3) m, in the axes of the parent.
    """

    def __init__(self, robot: RobotModel, *, fixed: bool) -> None:
        places = [place for place in robot.placements if (place.name in robot.joint_names) != fixed]
        self.links = tuple((place.parent, place.child) for place in places)
        self.translation = np.array([place.xyz for place in places]).reshape(-1, 3)
        self._model = robot.model
        self._data = robot.model.createData()

    def rotation(self, position: Array) -> Array:
        """Return the quaternions (n, 4), scalar last, with the arm's joints at `position`, rad."""
        pin.framesForwardKinematics(self._model, self._data, position)
        turns = []
        for parent, child in self.links:
            before = self._data.oMf[self._model.getBodyId(parent)].rotation
            after = self._data.oMf[self._model.getBodyId(child)].rotation
            turns.append(pin.Quaternion(before.T @ after).coeffs())
        return np.array(turns).reshape(-1, 4)
