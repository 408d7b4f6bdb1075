"""Distances between an arm and planes around it, a table or walls, and between its own links.

The shapes are those of `<collision>` in the URDF, tool included: boxes, cylinders and spheres, as Pinocchio reads them.
Distances to planes are exact: those of each shape's nearest point, and of the centres of the joints and the tool centre
point. Self-collision is checked by Pinocchio's collision checker; links that a joint connects are excluded, because
they touch anyway. Meshes are ignored, and the plan's table says so.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Index
from rx90_common.description.robot import RobotModel, joint_of
from rx90_common.description.rotations import axis_rotation
from rx90_emulator.identification.options import Wall

SELF_CLEARANCE = 0.005
"""Least distance between shapes of the arm, m."""
_ANGLE_STEP = 1e-4  # rad: the checker is right to about 1e-6 m
_MIN_APPROACH = 1e-6  # m: a plane is ignored for shapes whose distance to it changes less over the joints' ranges
_WALL_SCALE = 0.1  # m too near to a wall that cost as much as a limit exceeded by its whole size
_DISTANCE_MARGIN = 0.01  # m, that a search keeps for the motion between its samples


class Workspace:
    """Planes and pairs of an arm's shapes that must keep a distance.

    Args:
        robot: an arm of n joints, with its tool.
        walls: the planes.
        home: where its runs begin, rad, shape (n,).

    Attributes:
        walls: the planes.
        meshes: links with shapes that are ignored.
        uncounted: pairs of links that are too near to each other at home already, because shapes are rough.
    """

    def __init__(self, robot: RobotModel, walls: Sequence[Wall], home: ArrayLike) -> None:
        self.walls = tuple(walls)
        self._robot = robot
        self._model = robot.model
        frames = robot.model.frames
        root = ET.fromstring(robot.urdf)
        meshes = []
        for link in root.findall("link"):
            for collision in link.findall("collision"):
                if collision.find("geometry/mesh") is not None:
                    link.remove(collision)
                    meshes.append(str(link.get("name")))
        moved = (name for name in meshes if joint_of(frames[self._model.getFrameId(name, pin.BODY)]) > 0)
        self.meshes = tuple(dict.fromkeys(moved))
        self._shapes = pin.buildGeomFromUrdfString(self._model, ET.tostring(root, encoding="unicode"), pin.COLLISION)
        self._outline()
        poses = np.random.default_rng(0).uniform(robot.lower, robot.upper, (50, len(robot.joint_names)))
        spread = [np.ptp(self._to_wall(poses, wall)[0], axis=0) for wall in walls]
        # Shapes that only turn in place, such as a shoulder over a table, are excluded.
        self._movable = [np.flatnonzero(width > _MIN_APPROACH) for width in spread]
        objects = self._shapes.geometryObjects
        joint = [joint_of(frames[one.parentFrame]) for one in objects]
        pairs = [(a, b) for a, b in combinations(range(len(objects)), 2) if abs(joint[a] - joint[b]) > 1]
        self._set_pairs(pairs)
        near = self._self_distances(np.asarray(home, dtype=np.float64)[None, :])[0] < SELF_CLEARANCE
        names = [" and ".join(objects[k].name.rpartition("_")[0] for k in pair) for pair in pairs]
        self.uncounted = tuple(dict.fromkeys(name for name, one in zip(names, near, strict=True) if one))
        self._set_pairs([pair for pair, one in zip(pairs, near, strict=True) if not one])

    def _outline(self) -> None:
        """Store the shapes that keep a distance from planes, in frames parallel to the base's at joint angles 0.

        A shape is a box with half-lengths, rounded by a ball, and a disk around its z axis: a cylinder is a disk with a
        height, a sphere only a ball; joints and tool centre point are points.
        """
        chain = self._robot.chain
        model = self._model
        data = self._shapes.createData()
        pin.updateGeometryPlacements(model, model.createData(), self._shapes, data, pin.neutral(model))
        centers = np.cumsum(chain.origin, axis=0)
        point = (np.eye(3), np.zeros(3), 0.0, 0.0)
        rows = [(name, joint, np.zeros(3), *point) for joint, name in enumerate(self._robot.joint_names)]
        rows.append((self._robot.tcp_frame, len(centers) - 1, chain.tcp_position, *point))
        for one, placed in zip(self._shapes.geometryObjects, data.oMg, strict=True):
            frame = model.frames[one.parentFrame]
            shape = one.geometry
            kind = type(one.geometry).__name__
            if (joint := joint_of(frame) - 1) >= 0:
                half = np.array(shape.halfSide) if kind == "Box" else np.zeros(3)
                disk = shape.radius if kind == "Cylinder" else 0.0
                ball = shape.radius if kind == "Sphere" else 0.0
                if kind == "Cylinder":
                    half[2] = shape.halfLength
                rotation = placed.rotation.copy()
                rows.append((frame.name, joint, placed.translation - centers[joint], rotation, half, disk, ball))
        self._names, *columns = zip(*rows, strict=True)
        self._link, self._center, self._axes, self._half, self._disk, self._ball = map(np.array, columns)

    def _to_wall(self, position: Array, wall: Wall) -> tuple[Array, Array]:
        """Return each shape's distance to a plane, m, shape (m, s), and its derivative by positions, shape (m, s, n).

        A convex body's nearest point gives the derivative, whichever point it is (envelope theorem).
        """
        chain = self._robot.chain
        normal = np.array(wall.normal)
        rotation = np.broadcast_to(np.eye(3), (len(position), 3, 3))
        center = np.zeros((len(position), 3))
        frames: list[tuple[Array, Array, Array]] = []
        for joint, (origin, turn) in enumerate(zip(chain.origin, chain.axis, strict=True)):
            center = center + rotation @ origin
            axis = rotation @ turn
            rotation = rotation @ axis_rotation(turn, position[:, joint])
            frames.append((rotation, center, axis))
        rotations, centers, axes = (np.stack(each, axis=1) for each in zip(*frames, strict=True))
        rotated = rotations[:, self._link] @ self._axes
        along = np.einsum("i,msij->msj", normal, rotated)
        across = np.linalg.norm(along[..., :2], axis=-1)
        local = -np.sign(along) * self._half
        local[..., :2] -= along[..., :2] / np.maximum(across, 1e-12)[..., None] * self._disk[:, None]
        point = np.einsum("msij,msj->msi", rotated, local) - self._ball[:, None] * normal
        point += centers[:, self._link] + np.einsum("msij,sj->msi", rotations[:, self._link], self._center)
        lever = point[:, :, None, :] - centers[:, None, :, :]
        swept = np.cross(np.broadcast_to(axes[:, None], lever.shape), lever) @ normal
        moves = np.arange(len(self._robot.joint_names)) <= self._link[:, None]
        return point @ normal - wall.distance, np.where(moves, swept, 0.0)

    def lowest(self, position: Array) -> list[tuple[float, str]]:
        """Return the least distance to each plane along a motion, m, and the nearest part; inf if there is none."""
        found = []
        for wall, counts in zip(self.walls, self._movable, strict=True):
            distance = self._to_wall(position, wall)[0][:, counts]
            near = int(np.argmin(distance.min(axis=0))) if len(counts) else 0
            found.append(
                (float(distance[:, near].min()), self._names[counts[near]]) if len(counts) else (math.inf, "nothing")
            )
        return found

    def nearness(self, position: Array, clearance: float) -> tuple[float, Array]:
        """Return the cost of being too near to walls or to itself, and its derivative by position, shape (m, n)."""
        value = 0.0
        slope = np.zeros_like(position)
        for wall, counts in zip(self.walls, self._movable, strict=True):
            distance, by_position = (each[:, counts] for each in self._to_wall(position, wall))
            missing = np.maximum((clearance + _DISTANCE_MARGIN - distance) / _WALL_SCALE, 0.0)
            value += float(np.sum(missing**2))
            slope -= 2.0 / _WALL_SCALE * np.einsum("ms,msn->mn", missing, by_position)
        gap = SELF_CLEARANCE + _DISTANCE_MARGIN
        near = self.near_itself(position, gap)
        distance = self._self_distances(position[near])
        missing = np.maximum((gap - distance) / _WALL_SCALE, 0.0)
        value += float(np.sum(missing**2))
        slopes = self._self_slopes(position[near], distance, gap)
        slope[near] -= 2.0 / _WALL_SCALE * np.einsum("ms,msn->mn", missing, slopes)
        return value, slope

    def _set_pairs(self, pairs: Sequence[tuple[int, int]]) -> None:
        self._shapes.removeAllCollisionPairs()
        for pair in pairs:
            self._shapes.addCollisionPair(pin.CollisionPair(*pair))
        self._data = self._model.createData(), self._shapes.createData()

    def near_itself(self, position: Array, gap: float = SELF_CLEARANCE) -> Index:
        """Return the rows of positions, rad, shape (m, n), where shapes are nearer to each other than a gap, m."""
        arm, pairs = self._data
        for request in pairs.collisionRequests:
            request.security_margin = gap
        touching = [pin.computeCollisions(self._model, arm, self._shapes, pairs, q, True) for q in position]
        return np.flatnonzero(np.array(touching, dtype=bool))

    def _self_distances(self, position: Array) -> Array:
        """Return the distance of each pair, m, negative where they overlap, shape (m, p)."""
        arm, pairs = self._data
        found = np.empty((len(position), len(self._shapes.collisionPairs)))
        for row, q in enumerate(position):
            pin.computeDistances(self._model, arm, self._shapes, pairs, q)
            found[row] = [one.min_distance for one in pairs.distanceResults]
        return found

    def _self_slopes(self, position: Array, distance: Array, gap: float) -> Array:
        """Return the derivatives by positions of distances, m/rad, shape (m, p, n); 0 for those above a gap, m."""
        arm, pairs = self._data
        found = np.zeros((*distance.shape, position.shape[1]))
        for row, q in enumerate(position):
            close = np.flatnonzero(distance[row] < gap).tolist()
            for joint in range(len(q)) if close else ():
                moved = q.copy()
                moved[joint] += _ANGLE_STEP
                pin.updateGeometryPlacements(self._model, arm, self._shapes, pairs, moved)
                for k in close:
                    there = pin.computeDistance(self._shapes, pairs, k).min_distance
                    found[row, k, joint] = (there - distance[row, k]) / _ANGLE_STEP
        return found
