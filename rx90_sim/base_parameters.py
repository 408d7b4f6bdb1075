"""Base parameters of a serial arm: the inertial parameters that its motion depends on (Gautier and Khalil 1990).

Mass on a joint axis moves in the same way whether it belongs to the link before or after the joint. From the tip to
the base, the mass, the first moment and the second moment along the axis of each link are therefore regrouped into the
link before it. Two first moments remain and, with the link's x axis turned such that the product of inertia about the
axis vanishes, four second moments: 6 numbers in place of 10, and neither M(q) nor h(q, v) changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.robot import RigidChain


class BaseParameters(NamedTuple):
    """The arm in link frames whose z axes are the joint axes and whose origins lie on them.

    Attributes:
        frame: (6, 3, 3) orientation of each link's frame in the frame before it, at q = 0.
        next_origin: (6, 3) origin of the next link in the link's own frame, m; zero for the last.
        first_origin: (3,) origin of the first link in the base, m.
        first_moment: (6, 2) integrals of x and y over the mass, kg m.
        second_moment: (6, 4) integrals of xx, yy, xz and yz over the mass, kg m^2.
    """

    frame: Array
    next_origin: Array
    first_origin: Array
    first_moment: Array
    second_moment: Array


def base_parameters(chain: RigidChain) -> BaseParameters:
    """Return the base parameters of the arm; the axes are unit vectors."""
    mass = chain.mass.copy()
    first = mass[:, None] * chain.com
    second = _second_moments(chain)
    for i in range(len(mass) - 1, 0, -1):
        z, origin = chain.axis[i], chain.origin[i]
        along = z @ first[i]
        first[i - 1] += mass[i] * origin + along * z
        second[i - 1] += mass[i] * np.outer(origin, origin) + (z @ second[i] @ z) * np.outer(z, z)
        second[i - 1] += along * (np.outer(origin, z) + np.outer(z, origin))
        mass[i - 1] += mass[i]
    # What lies along the axis has been regrouped; the entries that still hold it are not used.
    at_zero = _link_frames(chain.axis, second)
    before = np.concatenate([np.eye(3)[None], at_zero[:-1]])
    following = np.concatenate([chain.origin[1:], np.zeros((1, 3))])
    local = np.transpose(at_zero, (0, 2, 1)) @ second @ at_zero
    return BaseParameters(
        frame=np.transpose(before, (0, 2, 1)) @ at_zero,
        next_origin=np.einsum("ikc,ik->ic", at_zero, following),
        first_origin=chain.origin[0],
        first_moment=np.einsum("ikc,ik->ic", at_zero, first)[:, :2],
        second_moment=local[:, [0, 1, 0, 1], [0, 1, 2, 2]],
    )


def _second_moments(chain: RigidChain) -> Array:
    """Return the integrals of r r^T over the mass about the link origins, shape (6, 3, 3), kg m^2."""
    xx, yy, zz, xy, xz, yz = chain.inertia.T
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
    central = 0.5 * np.trace(inertia, axis1=1, axis2=2)[:, None, None] * np.eye(3) - inertia
    return np.asarray(central + chain.mass[:, None, None] * chain.com[:, :, None] * chain.com[:, None, :])


def _link_frames(z: Array, moment: Array) -> Array:
    """Return axes (columns) with the given z, turned such that x and y are principal directions, (6, 3, 3)."""
    side = np.cross(np.eye(3)[np.argmin(np.abs(z), axis=1)], z)
    x = side / np.linalg.norm(side, axis=1, keepdims=True)
    y = np.cross(z, x)
    xx, yy, xy = (np.einsum("ik,ikl,il->i", a, moment, b) for a, b in ((x, x), (y, y), (x, y)))
    turn = 0.5 * np.arctan2(2.0 * xy, xx - yy)[:, None]
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([c * x + s * y, c * y - s * x, z], axis=2)
