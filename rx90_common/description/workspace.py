"""Distances between an arm and planes around it, a table or walls, and between its own links, by Pinocchio.

The shapes are those of `<collision>` in the URDF, tool included: boxes, cylinders and spheres. The origin of each link,
which is a joint's centre or the tool centre point, keeps its distance to the planes, too. Meshes are ignored.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from itertools import combinations, compress, product
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.description.robot import RobotModel, joint_of
from rx90_common.description.wall import Wall

SELF_CLEARANCE = 0.005
"""Least distance between shapes of the arm, m."""
_THICKNESS = 20.0  # m, of the box that stands for a plane
_BOX = (
    '<collision><origin xyz="{place}" rpy="{turn}"/>'
    '<geometry><box size="{size} {size} {size}"/></geometry></collision>'
)
_POINT = '<collision><geometry><sphere radius="1e-6"/></geometry></collision>'
_LEAST_CHANGE = 1e-5  # m over the joints' ranges: a shape that only turns in place, such as a shoulder, does not count
_RANDOM_POSES = 50
_TOO_NEAR = 0.1  # m, which costs as much as a limit exceeded by its whole size
_MARGIN = 0.01  # m, that a search keeps for the motion between its samples


class Workspace:
    """Pairs of shapes and planes that must keep a distance.

    Args:
        robot: an arm of n joints, with its tool.
        walls: the planes.
        home: where its runs begin, rad, shape (n,).
        clearance: least distance to the planes, m.

    Attributes:
        meshes: links with shapes that are ignored.
        uncounted: pairs of links that are too near to each other at home already, because shapes are rough.
        pairs: names of the p pairs that count.
        least: their least distances, m, shape (p,).
    """

    def __init__(
        self, robot: RobotModel, walls: Sequence[Wall], home: ArrayLike, clearance: float
    ) -> None:
        root = ET.fromstring(robot.urdf)
        self.meshes = _take_meshes(root)
        self._model = robot.model
        self._shapes = pin.buildGeomFromUrdfString(
            robot.model, ET.tostring(root, encoding="unicode"), pin.COLLISION
        )
        bodies = range(len(self._shapes.geometryObjects))
        *planes, point = _planes_and_point(walls)
        points = [self._add(point, frame) for frame in (*robot.joint_names, robot.tcp_frame)]
        behind = [self._shapes.addGeometryObject(plane) for plane in planes]
        joints = [shape.parentJoint for shape in self._shapes.geometryObjects]
        names = [shape.name.rpartition("_")[0] for shape in self._shapes.geometryObjects]
        near_planes = [pair for pair in product((*bodies, *points), behind) if joints[pair[0]] > 0]
        poses = np.random.default_rng(0).uniform(
            robot.lower, robot.upper, (_RANDOM_POSES, len(robot.lower))
        )
        self._count(near_planes)
        turns_in_place = np.ptp(self.distances(poses), axis=0) < _LEAST_CHANGE
        near_planes = list(compress(near_planes, ~turns_in_place))
        near_itself = [
            pair for pair in combinations(bodies, 2) if abs(joints[pair[0]] - joints[pair[1]]) > 1
        ]
        self._count(near_itself)
        touches = self.distances(np.asarray(home, dtype=np.float64)[None])[0] < SELF_CLEARANCE
        rough = [f"{names[a]} and {names[b]}" for a, b in compress(near_itself, touches)]
        self.uncounted = tuple(dict.fromkeys(rough))
        near_itself = list(compress(near_itself, ~touches))
        self._count([*near_planes, *near_itself])
        self.least = np.repeat([clearance, SELF_CLEARANCE], [len(near_planes), len(near_itself)])
        self.pairs = [f"{names[a]} to {names[b]}" for a, b in (*near_planes, *near_itself)]

    def _add(self, point: Any, frame_name: str) -> int:
        number = self._model.getFrameId(frame_name)
        frame = self._model.frames[number]
        shape = pin.GeometryObject(point)
        shape.name = f"{frame_name}_0"
        shape.parentJoint = joint_of(frame)
        shape.parentFrame = number
        shape.placement = frame.placement
        return int(self._shapes.addGeometryObject(shape))

    def _count(self, pairs: Iterable[tuple[int, int]]) -> None:
        self._shapes.removeAllCollisionPairs()
        for pair in pairs:
            self._shapes.addCollisionPair(pin.CollisionPair(*pair))

    def distances(self, position: Array) -> Array:
        """Return the distance of each pair, m, negative where they overlap, shape (m, p), at positions (m, n), rad."""
        arm = self._model.createData()
        shapes = self._shapes.createData()
        distances = np.empty((len(position), len(self._shapes.collisionPairs)))
        for row, configuration in enumerate(position):
            pin.computeDistances(self._model, arm, self._shapes, shapes, configuration)
            distances[row] = [result.min_distance for result in shapes.distanceResults]
        return distances

    def nearness(self, position: Array) -> Array:
        """Return the cost of being too near, shape (m,), at positions, rad, shape (m, n)."""
        missing = np.maximum(self.least + _MARGIN - self.distances(position), 0.0)
        return np.asarray(np.sum((missing / _TOO_NEAR) ** 2, axis=1))


def _take_meshes(root: ET.Element) -> tuple[str, ...]:
    """Remove meshes, which need not be there, and return the links that had some."""
    links = []
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            if collision.find("geometry/mesh") is not None:
                link.remove(collision)
                links.append(link.get("name", ""))
    return tuple(dict.fromkeys(links))


def _planes_and_point(walls: Sequence[Wall]) -> list[Any]:
    """Return Pinocchio's shapes of thick boxes behind the planes, and of a point."""
    shapes = []
    for wall in walls:
        centre = np.array(wall.normal) * (wall.distance - 0.5 * _THICKNESS)
        place = " ".join(map(repr, centre.tolist()))
        pitch = math.acos(wall.normal[2])
        yaw = math.atan2(wall.normal[1], wall.normal[0])
        shapes.append(_BOX.format(place=place, turn=f"0 {pitch!r} {yaw!r}", size=_THICKNESS))
    text = f'<robot name="around"><link name="around">{"".join(shapes)}{_POINT}</link></robot>'
    around = list(
        pin.buildGeomFromUrdfString(
            pin.buildModelFromXML(text), text, pin.COLLISION
        ).geometryObjects
    )
    for wall, shape in zip(walls, around, strict=False):
        shape.name = f"{wall.name}_0"
    return around
