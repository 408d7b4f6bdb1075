"""The visual geometry of an arm: boxes, cylinders and spheres, each fixed to a joint."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.robot import RobotModel

_SOLIDS = ("Box", "Cylinder", "Sphere")
# radius of rods as a share of the arm's length, of the joints' spheres in that of the rods
_ROD = 0.02
_BALL = 1.6
_ROD_COLOR = np.array([0.75, 0.6, 0.2])
_BALL_COLOR = np.array([0.2, 0.3, 0.45])


class VisualShape(NamedTuple):
    """A box, cylinder (along z) or sphere.

    Attributes:
        kind: "Box", "Cylinder" or "Sphere".
        half: (3,) half its extent along its axes, m.
        joint: index of the joint that it moves with, 0 to 5; -1 for the base.
        position: (3,) of its centre, in the frame of that joint, m.
        rotation: (3, 3) of its axes, in that frame.
        color: (3,) red, green and blue, 0 to 1.
    """

    kind: str
    half: Array
    joint: int
    position: Array
    rotation: Array
    color: Array


def visual_shapes(robot: RobotModel) -> list[VisualShape]:
    """Return the visual geometry of an arm with its tool."""
    found = []
    for shape in pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.VISUAL).geometryObjects:
        kind, half = _extent(shape.geometry)
        joint = int(shape.parentJoint) - 1  # Pinocchio's joint 0 is the world
        place = shape.placement
        color = np.array(shape.meshColor[:3])
        found.append(
            VisualShape(
                kind, half, joint, np.array(place.translation), np.array(place.rotation), color
            )
        )
    return found


def drawn_shapes(robot: RobotModel) -> list[VisualShape]:
    """Return the visual geometry of an arm; where its URDF has none that can be drawn, a rod from joint to joint.

    Most robots' URDFs name files of meshes, which seldom are where a bag is.
    """
    try:
        return visual_shapes(robot) or _rods(robot)
    # the latter of Pinocchio, for files of meshes that are not there
    except (ConfigError, ValueError):
        return _rods(robot)


def _rods(robot: RobotModel) -> list[VisualShape]:
    places = [
        robot.model.jointPlacements[number + 1].translation
        for number in range(len(robot.joint_names))
    ]
    places.append(robot.model.frames[robot.model.getFrameId(robot.tcp_frame)].placement.translation)
    radius = _ROD * float(sum(np.linalg.norm(place) for place in places))
    found = []
    for joint, place in enumerate(places, -1):
        length = float(np.linalg.norm(place))
        if joint >= 0:
            ball = np.full(3, _BALL * radius)
            found.append(VisualShape("Sphere", ball, joint, np.zeros(3), np.eye(3), _BALL_COLOR))
        if length > radius:
            turn = np.array(
                pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), place / length).matrix()
            )
            half = np.array([radius, radius, 0.5 * length])
            found.append(
                VisualShape("Cylinder", half, joint, 0.5 * np.array(place), turn, _ROD_COLOR)
            )
    return found


def _extent(geometry: Any) -> tuple[str, Array]:
    kind = type(geometry).__name__
    if kind not in _SOLIDS:
        raise ConfigError(f"a visual shape is a {kind}; accepted: boxes, cylinders and spheres")
    if kind == "Box":
        return kind, np.array(geometry.halfSide)
    radius = geometry.radius
    return kind, np.array([radius, radius, geometry.halfLength if kind == "Cylinder" else radius])
