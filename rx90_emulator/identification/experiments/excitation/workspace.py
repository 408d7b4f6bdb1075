"""How far an arm's shapes stay from planes, a table or walls, and from each other.

The shapes are those of `<collision>` in the URDF, tool included: boxes, cylinders and spheres, whose point nearest to a
plane is exact. Beside them count the centres of the joints and the tool centre point. Meshes do not; who plans is told.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Index
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import axis_rotation
from rx90_emulator.identification.experiments.excitation.options import Wall
from rx90_emulator.identification.experiments.excitation.self_collision import SelfCollision

_MOVES = 1e-6  # m: a shape whose distance to a plane changes less over the joints' ranges is not moved towards it


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
        kept, meshes = _shapes(robot)
        return cls(
            robot,
            tuple(shape.name for shape in kept),
            np.array([shape.link for shape in kept]),
            np.array([shape.center for shape in kept]),
            np.array([shape.axes for shape in kept]),
            np.array([shape.half for shape in kept]),
            np.array([shape.disk for shape in kept]),
            np.array([shape.ball for shape in kept]),
            meshes,
        )

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
        movable = tuple(np.flatnonzero(width > _MOVES) for width in spread)
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


class _Shape(NamedTuple):
    name: str
    link: int
    center: Array
    axes: Array
    half: Array
    disk: float
    ball: float


def _shapes(robot: RobotModel) -> tuple[list[_Shape], tuple[str, ...]]:
    """Return the shapes of the links that move, and the links whose shapes are of other kinds."""
    model, chain = robot.model, robot.chain
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    joints = np.cumsum(chain.origin, axis=0)
    points = [*((name, k, np.zeros(3)) for k, name in enumerate(robot.joint_names)),
              (robot.tcp_frame, len(joints) - 1, chain.tcp_position)]  # fmt: skip
    found = [_Shape(name, joint, center, np.eye(3), np.zeros(3), 0.0, 0.0) for name, joint, center in points]
    meshes = []
    for link in ET.fromstring(robot.urdf).findall("link"):
        name = str(link.get("name"))
        frame = model.getFrameId(name, pin.BODY)
        known = model.frames[frame]
        # Pinocchio 2 calls it `parent`.
        joint = (known.parentJoint if hasattr(known, "parentJoint") else known.parent) - 1
        for collision in [] if joint < 0 else link.findall("collision"):
            here = data.oMf[frame] * _placement(collision.find("origin"))
            size = _size(collision.find("geometry"))
            if size is None:
                meshes.append(name)
            else:
                found.append(_Shape(name, joint, here.translation - joints[joint], here.rotation.copy(), *size))
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
