"""The transforms from each link to the next that tf wants: fixed ones, and those that turn with the joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import length, quaternion_product, rpy_quaternion
from rx90_common.description.urdf import Placement
from rx90_common.kernels.elementary_arrays import sines_cosines


class LinkTransforms:
    """Transforms from parent to child links, one for each joint of a list.

    Attributes:
        links: names of parent and child.
        translation: (n, 3) m, in the axes of the parent.
    """

    def __init__(self, placements: Sequence[Placement]) -> None:
        self.links = tuple((place.parent, place.child) for place in placements)
        self.translation = np.array([place.xyz for place in placements], dtype=np.float64).reshape(-1, 3)
        self._still = np.array([rpy_quaternion(place.rpy) for place in placements]).reshape(-1, 4)
        axes = np.array([place.axis for place in placements], dtype=np.float64).reshape(-1, 3)
        half_turn = np.column_stack([axes / length(axes)[:, None], np.zeros(len(axes))])
        self._turned = quaternion_product(self._still, half_turn)

    def rotation(self, angle: Array) -> Array:
        """Return the quaternions (n, 4), scalar last, with these joints at `angle`, (n,) rad; 0 for a fixed joint."""
        sine, cosine = sines_cosines(0.5 * angle)
        # A turn by an angle about an axis is that share of none and that share of half a turn.
        return np.asarray(cosine[:, None] * self._still + sine[:, None] * self._turned)


def link_transforms(robot: RobotModel) -> tuple[LinkTransforms, LinkTransforms]:
    """Return the transforms of the moving joints, in the order of `joint_names`, and of the fixed ones."""
    places = {place.name: place for place in robot.placements}
    moving = [places.pop(name) for name in robot.joint_names]
    # What is fixed turns about nothing, whatever its axis.
    fixed = [place._replace(axis=(1.0, 0.0, 0.0)) for place in places.values()]
    return LinkTransforms(moving), LinkTransforms(fixed)
