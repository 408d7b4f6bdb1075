"""Whether an arm touches itself: the shapes of `<collision>`, tool and base included, by Pinocchio's collision checker.

Links that a joint connects touch anyway, and meshes do not count, as for the walls.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Index
from rx90_common.description.robot import RobotModel

GAP = 0.005
"""m, that shapes of the arm keep from each other."""
_DIFFERENCE = 1e-4  # rad: the checker is right to about 1e-6 m


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
        pairs = [(a, b) for a, b in combinations(range(len(objects)), 2)
                 if abs(_joint(model, objects[a]) - _joint(model, objects[b])) > 1]  # fmt: skip
        every = cls._with(model, shapes, pairs, ())
        near = every.distances(np.asarray(home, dtype=np.float64)[None, :])[0] < GAP
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

    def near(self, position: Array, gap: float = GAP) -> Index:
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
                moved[joint] += _DIFFERENCE
                pin.updateGeometryPlacements(self.model, arm, self.shapes, pairs, moved)
                for k in close:
                    there = pin.computeDistance(self.shapes, pairs, k).min_distance
                    found[row, k, joint] = (there - distance[row, k]) / _DIFFERENCE
        return found


def _joint(model: Any, shape: Any) -> int:
    """Return the number of the joint that moves a shape, 0 for the base."""
    frame = model.frames[shape.parentFrame]
    # Pinocchio 2 calls it `parent`.
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)


def _without_meshes(robot: RobotModel) -> str:
    root = ET.fromstring(robot.urdf)
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            if collision.find("geometry/mesh") is not None:
                link.remove(collision)
    return ET.tostring(root, encoding="unicode")
