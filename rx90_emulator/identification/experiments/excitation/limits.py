"""The limits of an arm and of the room around it, as shares that a motion reaches and as what exceeding them costs.

The shapes are those of `<collision>` in the URDF, tool included: boxes, cylinders and spheres. How far they stay from
planes, a table or walls, is exact: each shape's nearest point counts, and so do the centres of the joints and the tool
centre point. Whether the arm touches itself is left to Pinocchio's collision checker; links that a joint connects touch
anyway. Meshes do not count, and the plan's table says so.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Index
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import axis_rotation
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_emulator.identification.experiments.excitation.information import SMOOTH, Motion
from rx90_emulator.identification.experiments.excitation.options import Wall
from rx90_emulator.identification.experiments.load import Motors, friction_torque
from rx90_emulator.loop.setup import Setup

SELF_CLEARANCE = 0.005
"""m, that shapes of the arm keep from each other."""
_ANGLE_STEP = 1e-4  # rad: the checker is right to about 1e-6 m


@dataclass(frozen=True, eq=False)
class SelfCollision:
    """Pairs of shapes that an arm's motion must keep apart.

    Attributes:
        model: Pinocchio's of the arm.
        shapes: with the pairs.
        data: of both, to be written over.
        uncounted: pairs of links that come too near to each other at home already: shapes are rough.
    """

    model: Any
    shapes: Any
    data: tuple[Any, Any]
    uncounted: tuple[str, ...]

    @classmethod
    def of(cls, robot: RobotModel, home: ArrayLike) -> SelfCollision:
        """Return the pairs of an arm whose runs begin at home, rad, shape (n,)."""
        model, shapes = robot.model, pin.buildGeomFromUrdfString(robot.model, _without_meshes(robot), pin.COLLISION)
        objects = shapes.geometryObjects
        joint = [_parent_joint(model.frames[one.parentFrame]) for one in objects]
        pairs = [(a, b) for a, b in combinations(range(len(objects)), 2) if abs(joint[a] - joint[b]) > 1]
        every = cls._with(model, shapes, pairs, ())
        near = every.distances(np.asarray(home, dtype=np.float64)[None, :])[0] < SELF_CLEARANCE
        names = [" and ".join(objects[k].name.rpartition("_")[0] for k in pair) for pair in pairs]
        kept = [pair for pair, one in zip(pairs, near, strict=True) if not one]
        uncounted = (name for name, one in zip(names, near, strict=True) if one)
        return cls._with(model, shapes, kept, tuple(dict.fromkeys(uncounted)))

    @classmethod
    def _with(
        cls, model: Any, shapes: Any, pairs: Sequence[tuple[int, int]], uncounted: tuple[str, ...]
    ) -> SelfCollision:
        shapes = shapes.copy()
        for pair in pairs:
            shapes.addCollisionPair(pin.CollisionPair(*pair))
        return cls(model, shapes, (model.createData(), shapes.createData()), uncounted)

    def near(self, position: Array, gap: float = SELF_CLEARANCE) -> Index:
        """Return the rows of positions, rad, shape (m, n), where shapes are nearer to each other than a gap, m."""
        arm, pairs = self.data
        for request in pairs.collisionRequests:
            request.security_margin = gap
        touching = [pin.computeCollisions(self.model, arm, self.shapes, pairs, q, True) for q in position]
        return np.flatnonzero(np.array(touching, dtype=bool))

    def distances(self, position: Array) -> Array:
        """Return the distance of each pair, m, negative where they overlap, shape (m, p)."""
        arm, pairs = self.data
        found = np.empty((len(position), len(self.shapes.collisionPairs)))
        for row, q in enumerate(position):
            pin.computeDistances(self.model, arm, self.shapes, pairs, q)
            found[row] = [one.min_distance for one in pairs.distanceResults]
        return found

    def slopes(self, position: Array, distance: Array, gap: float) -> Array:
        """Return the derivatives by the joints' positions of distances, m/rad, shape (m, p, n); 0 of those above a gap.

        Args:
            position: rad, shape (m, n).
            distance: there, m, shape (m, p).
            gap: m.
        """
        arm, pairs = self.data
        found = np.zeros((*distance.shape, position.shape[1]))
        for row, q in enumerate(position):
            close = np.flatnonzero(distance[row] < gap).tolist()
            for joint in range(len(q)) if close else ():
                moved = q.copy()
                moved[joint] += _ANGLE_STEP
                pin.updateGeometryPlacements(self.model, arm, self.shapes, pairs, moved)
                for k in close:
                    there = pin.computeDistance(self.shapes, pairs, k).min_distance
                    found[row, k, joint] = (there - distance[row, k]) / _ANGLE_STEP
        return found


def _parent_joint(frame: Any) -> int:
    """Return the number of the joint that moves a frame, 0 for the base; Pinocchio 2 calls it `parent`."""
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)


def _without_meshes(robot: RobotModel) -> str:
    root = ET.fromstring(robot.urdf)
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            if collision.find("geometry/mesh") is not None:
                link.remove(collision)
    return ET.tostring(root, encoding="unicode")


_MIN_APPROACH = (
    1e-6  # m: a shape whose distance to a plane changes less over the joints' ranges is not moved towards it
)


@dataclass(frozen=True, eq=False)
class ArmShapes:
    """s shapes of an arm, each of them fixed to a link, in link frames that are parallel to the base's at 0.

    A shape is a box with the half-lengths `half`, rounded by `ball`, and a disk of radius `disk` around its z axis: a
    cylinder is a disk with a height, a sphere a ball alone.

    Attributes:
        robot: the arm.
        names: of the shapes' links.
        link: number of its joint, from 0, shape (s,).
        center: in the link's frame, m, shape (s, 3).
        axes: rotation of the shape in the link's frame, shape (s, 3, 3).
        half: half-lengths along its axes, m, shape (s, 3).
        disk: m, shape (s,).
        ball: m, shape (s,).
        meshes: links with shapes of other kinds, which do not count.
    """

    robot: RobotModel
    names: tuple[str, ...]
    link: Index
    center: Array
    axes: Array
    half: Array
    disk: Array
    ball: Array
    meshes: tuple[str, ...]

    @classmethod
    def of(cls, robot: RobotModel) -> ArmShapes:
        """Return the shapes of an arm with its tool."""
        shapes, meshes = _shapes(robot)
        names, *columns = zip(*shapes, strict=True)
        link, center, axes, half, disk, ball = (np.array(column) for column in columns)
        return cls(robot, tuple(map(str, names)), link, center, axes, half, disk, ball, meshes)

    def frames(self, position: Array) -> tuple[Array, Array, Array]:
        """Return rotations (m, n, 3, 3), centres (m, n, 3) and axes (m, n, 3) of joints at positions, shape (m, n)."""
        chain = self.robot.chain
        rotation, center = np.broadcast_to(np.eye(3), (len(position), 3, 3)), np.zeros((len(position), 3))
        rotations, centers, axes = [], [], []
        for joint, (origin, axis) in enumerate(zip(chain.origin, chain.axis, strict=True)):
            center = center + rotation @ origin
            axes.append(rotation @ axis)
            rotation = rotation @ axis_rotation(axis, position[:, joint])
            rotations.append(rotation)
            centers.append(center)
        return np.stack(rotations, axis=1), np.stack(centers, axis=1), np.stack(axes, axis=1)

    def nearest(self, position: Array, wall: Wall) -> tuple[Array, Array]:
        """Return for each shape its distance to a plane and the derivative by the joints' positions.

        Args:
            position: rad, shape (m, n).
            wall: the plane.

        Returns:
            Distance, m, negative beyond it, shape (m, s); derivative, m/rad, shape (m, s, n). A convex body's nearest
            point gives the derivative, whichever it is (envelope theorem).
        """
        rotation, center, axis = self.frames(position)
        normal = np.array(wall.normal)
        turned = rotation[:, self.link] @ self.axes
        along = np.einsum("i,msij->msj", normal, turned)
        across = np.linalg.norm(along[..., :2], axis=-1)
        flat = along[..., :2] / np.maximum(across, 1e-12)[..., None] * self.disk[:, None]
        local = -np.sign(along) * self.half
        local[..., :2] -= flat
        point = np.einsum("msij,msj->msi", turned, local) - self.ball[:, None] * normal
        point += center[:, self.link] + np.einsum("msij,sj->msi", rotation[:, self.link], self.center)
        lever = point[:, :, None, :] - center[:, None, :, :]
        swept = np.cross(np.broadcast_to(axis[:, None], lever.shape), lever) @ normal
        moves = np.arange(len(self.robot.joint_names)) <= self.link[:, None]
        return point @ normal - wall.distance, np.where(moves, swept, 0.0)


@dataclass(frozen=True, eq=False)
class Workspace:
    """Planes that an arm keeps away from, and which shapes its motion can bring to each.

    Attributes:
        shapes: of the arm.
        walls: the planes.
        movable: shapes that count for each plane: not what only turns in place, such as a shoulder over a table.
        arm: pairs of shapes that are to stay apart.
    """

    shapes: ArmShapes
    walls: tuple[Wall, ...]
    movable: tuple[Index, ...]
    arm: SelfCollision

    @classmethod
    def of(cls, robot: RobotModel, walls: Sequence[Wall], home: ArrayLike) -> Workspace:
        """Return the workspace of an arm whose runs begin at home, rad, shape (n,)."""
        shapes = ArmShapes.of(robot)
        poses = np.random.default_rng(0).uniform(robot.lower, robot.upper, (50, len(robot.joint_names)))
        spread = [np.ptp(shapes.nearest(poses, wall)[0], axis=0) for wall in walls]
        movable = tuple(np.flatnonzero(width > _MIN_APPROACH) for width in spread)
        return cls(shapes, tuple(walls), movable, SelfCollision.of(robot, home))

    def distances(self, position: Array) -> list[tuple[Array, Array]]:
        """Return distances and derivatives as `ArmShapes.nearest`, of the shapes that count, for each plane."""
        found = []
        for wall, counts in zip(self.walls, self.movable, strict=True):
            distance, slope = self.shapes.nearest(position, wall)
            found.append((distance[:, counts], slope[:, counts]))
        return found

    def lowest(self, position: Array) -> list[tuple[float, str]]:
        """Return the least distance to each plane along a motion, m, and what comes so near; inf where nothing can."""
        found = []
        for (distance, _), counts in zip(self.distances(position), self.movable, strict=True):
            if not len(counts):
                found.append((math.inf, "nothing"))
                continue
            near = int(np.argmin(distance.min(axis=0)))
            found.append((float(distance[:, near].min()), self.shapes.names[counts[near]]))
        return found


_Shape = tuple[str, int, Array, Array, Array, float, float]
"""What `ArmShapes` has of one shape: name, link, center, axes, half, disk, ball."""


def _shapes(robot: RobotModel) -> tuple[list[_Shape], tuple[str, ...]]:
    """Return the shapes of the links that move, and the links whose shapes are of other kinds."""
    model, chain = robot.model, robot.chain
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    joints = np.cumsum(chain.origin, axis=0)
    points = [*((name, k, np.zeros(3)) for k, name in enumerate(robot.joint_names)),
              (robot.tcp_frame, len(joints) - 1, chain.tcp_position)]  # fmt: skip
    found: list[_Shape] = [(name, joint, at, np.eye(3), np.zeros(3), 0.0, 0.0) for name, joint, at in points]
    meshes = []
    for link in ET.fromstring(robot.urdf).findall("link"):
        name = str(link.get("name"))
        frame = model.getFrameId(name, pin.BODY)
        joint = _parent_joint(model.frames[frame]) - 1
        for collision in [] if joint < 0 else link.findall("collision"):
            here = data.oMf[frame] * _placement(collision.find("origin"))
            size = _size(collision.find("geometry"))
            if size is None:
                meshes.append(name)
            else:
                found.append((name, joint, here.translation - joints[joint], here.rotation.copy(), *size))
    return found, tuple(dict.fromkeys(meshes))


def _placement(origin: ET.Element | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    xyz, rpy = (np.array((origin.get(key) or "0 0 0").split(), dtype=np.float64) for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _size(geometry: ET.Element | None) -> tuple[Array, float, float] | None:
    """Return half-lengths, radius of the disk and of the ball, m; None for a mesh."""
    for shape in [] if geometry is None else list(geometry):
        if shape.tag == "box":
            return 0.5 * np.array(str(shape.get("size")).split(), dtype=np.float64), 0.0, 0.0
        if shape.tag == "cylinder":
            length, radius = float(str(shape.get("length"))), float(str(shape.get("radius")))
            return np.array([0.0, 0.0, 0.5 * length]), radius, 0.0
        if shape.tag == "sphere":
            return np.zeros(3), 0.0, float(str(shape.get("radius")))
    return None


_RANGE_MARGIN = 0.02  # rad, to the joints' ranges, as the sweeps keep
_WALL_SCALE = 0.1  # m too near to a wall that cost as much as a limit exceeded by its whole size
_SHARE_MARGIN, _DISTANCE_MARGIN = (
    0.02,
    0.01,
)  # of a limit, and m to a wall, that a search leaves for what lies between its samples


@dataclass(frozen=True, eq=False)
class MotionSlope:
    """Derivatives by a motion and its rigid torque, each of shape (m, n)."""

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """What a run must keep.

    Attributes:
        setup: ranges, speeds, efforts of the joints, accelerations of the controller, peak torques of the drives.
        workspace: planes.
        clearance: least distance to them, m.
        share: of accelerations and torques.
        speed: share of the speeds.
    """

    setup: Setup
    workspace: Workspace
    clearance: float
    share: float
    speed: float

    @property
    def middle(self) -> Array:
        """Return the middle of each joint's range, rad, shape (n,)."""
        return 0.5 * (self.setup.robot.lower + self.setup.robot.upper)

    @property
    def reach(self) -> Array:
        """Return how far each joint may go from there, rad, shape (n,)."""
        return 0.5 * (self.setup.robot.upper - self.setup.robot.lower) - _RANGE_MARGIN

    @cached_property
    def motors(self) -> Motors:
        """Return what the motors turn and carry, and their limits."""
        return Motors.of(self.setup.robot, self.setup.drives)

    def shares(self, motion: Motion, torque: Array) -> dict[str, Array]:
        """Return signed shares of what is allowed, by name, each of shape (m, n).

        Args:
            motion: m samples of n joints.
            torque: with friction, Nm, shape (m, n).
        """
        position, velocity, acceleration = motion
        robot, controller, motors = self.setup.robot, self.setup.controller, self.motors
        return {
            "position": (position - self.middle) / self.reach,
            "speed": velocity / (self.speed * robot.max_velocity),
            "motor_speed": velocity @ motors.turns.T / (self.speed * motors.speed),
            "acceleration": acceleration / (self.share * controller.max_acceleration),
            "torque": torque / (self.share * robot.max_effort),
            "motor_torque": torque @ motors.carries.T / (self.share * motors.torque),
        }

    def penalty(self, motion: Motion, rigid: Array) -> tuple[float, MotionSlope]:
        """Return the sum of squares of what comes too near to the limits, and its derivatives.

        Args:
            motion: m samples of n joints.
            rigid: torque without friction, Nm, shape (m, n); friction is smoothed.
        """
        robot, controller, motors = self.setup.robot, self.setup.controller, self.motors
        friction, by_speed = friction_torque(motion[1], controller, SMOOTH)
        over = {name: _over(share) for name, share in self.shares(motion, rigid + friction).items()}
        value = sum(float(np.sum(one**2)) for one in over.values())
        near, slope = self.nearness(motion[0])
        by_velocity = over["speed"] / robot.max_velocity + over["motor_speed"] / motors.speed @ motors.turns
        carried = over["motor_torque"] / motors.torque @ motors.carries
        by_torque = 2.0 * (over["torque"] / robot.max_effort + carried) / self.share
        by_friction = by_torque @ motors.turns.T * by_speed @ motors.turns
        return value + near, MotionSlope(
            2.0 * over["position"] / self.reach + slope,
            2.0 * by_velocity / self.speed + by_friction,
            2.0 * over["acceleration"] / (self.share * controller.max_acceleration),
            by_torque,
        )

    def nearness(self, position: Array) -> tuple[float, Array]:
        """Return what it costs to be too near to walls or itself, and its derivative by the position, shape (m, n)."""
        value, slope = 0.0, np.zeros_like(position)
        for distance, by_position in self.workspace.distances(position):
            missing = np.maximum((self.clearance + _DISTANCE_MARGIN - distance) / _WALL_SCALE, 0.0)
            value += float(np.sum(missing**2))
            slope -= 2.0 / _WALL_SCALE * np.einsum("ms,msn->mn", missing, by_position)
        arm, gap = self.workspace.arm, SELF_CLEARANCE + _DISTANCE_MARGIN
        near = arm.near(position, gap)
        distance = arm.distances(position[near])
        missing = np.maximum((gap - distance) / _WALL_SCALE, 0.0)
        value += float(np.sum(missing**2))
        slope[near] -= 2.0 / _WALL_SCALE * np.einsum("ms,msn->mn", missing, arm.slopes(position[near], distance, gap))
        return value, slope

    def kept(self, motion: Motion, rigid: Array) -> bool:
        """Return whether a motion keeps all limits at its samples."""
        torque = rigid + friction_torque(motion[1], self.setup.controller)[0]
        within = all(float(np.abs(share).max()) <= 1.0 for share in self.shares(motion, torque).values())
        return within and self.clear(motion[0])

    def clear(self, position: Array) -> bool:
        """Return whether the arm is far enough from the walls and from itself at positions, rad, shape (m, n)."""
        free = all(distance >= self.clearance for distance, _ in self.workspace.lowest(position))
        return free and not len(self.workspace.arm.near(position))

    def worst(self, motion: Motion, rigid: Array) -> str:
        """Return in words which limit a motion exceeds most at its samples."""
        torque = rigid + friction_torque(motion[1], self.setup.controller)[0]
        for wall, (distance, name) in zip(self.workspace.walls, self.workspace.lowest(motion[0]), strict=True):
            if distance < self.clearance:
                return f"{name} comes as near to {wall.name} as {distance:.3g} m"
        if len(self.workspace.arm.near(motion[0])):
            return "the arm touches itself"
        shares = {name: np.abs(share).max(axis=0) for name, share in self.shares(motion, torque).items()}
        name = max(shares, key=lambda one: float(shares[one].max()))
        joint = int(np.argmax(shares[name]))
        whose = (MOTOR_NAMES if name.startswith("motor") else self.setup.robot.joint_names)[joint]
        return f"the {name.removeprefix('motor_')} of {whose} is {shares[name][joint]:.0%} of what is allowed"


def _over(share: Array) -> Array:
    """Return by how much a signed share exceeds 1, less a margin, with its sign."""
    return np.asarray(np.sign(share) * np.maximum(np.abs(share) - 1.0 + _SHARE_MARGIN, 0.0))
