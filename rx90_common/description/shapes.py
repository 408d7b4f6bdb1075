"""The visual geometry of an arm: boxes, cylinders and spheres, each fixed to a joint."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.robot import RobotModel

_SOLIDS = ("Box", "Cylinder", "Sphere")


class Shape(NamedTuple):
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


def visual_shapes(robot: RobotModel) -> list[Shape]:
    """Return the visual geometry of an arm with its tool.

    Raises:
        ConfigError: where it has other shapes than boxes, cylinders and spheres.
    """
    found = []
    for shape in pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.VISUAL).geometryObjects:
        kind, half = _extent(shape.geometry)
        joint = int(shape.parentJoint) - 1  # Pinocchio's joint 0 is the world
        place = shape.placement
        color = np.array(shape.meshColor[:3])
        found.append(Shape(kind, half, joint, np.array(place.translation), np.array(place.rotation), color))
    return found


def _extent(geometry: Any) -> tuple[str, Array]:
    kind = type(geometry).__name__
    if kind not in _SOLIDS:
        raise ConfigError(f"a visual shape is a {kind}; accepted: boxes, cylinders and spheres")
    if kind == "Box":
        return kind, np.array(geometry.halfSide)
    radius = geometry.radius
    return kind, np.array([radius, radius, geometry.halfLength if kind == "Cylinder" else radius])
