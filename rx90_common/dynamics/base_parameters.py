"""Base parameters of a serial arm: the inertial parameters that its motion depends on (Gautier and Khalil 1990).

Mass on a joint axis moves in the same way whether it belongs to the link before or after the joint. From the tip to
the base, the mass, the first moment and the second moment along the axis of each link are therefore regrouped into the
link before it. Two first moments remain and, with the link's x axis turned such that the product of inertia about the
axis vanishes, four second moments: 6 numbers in place of 10, and neither M(q) nor h(q, v) changes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.chain import RigidChain
from rx90_common.description.drives import DriveParameters
from rx90_common.description.rotations import dot, length, outer, product, rotated, transposed
from rx90_common.dynamics.manipulator import manipulator_dtype
from rx90_common.kernels.elementary import angles_of, sines_cosines

_SHAPES = (-1, 3), (-1, 3), (-1,), (-1, 3), (-1, 6), (3,), (3,), (3, 3)  # of a RigidChain's arrays


class BaseParameters(NamedTuple):
    """The arm in link frames whose z axes are the joint axes and whose origins lie on them.

    Attributes:
        frame: (n, 3, 3) orientation of each link's frame in the frame before it, at q = 0.
        next_origin: (n, 3) origin of the next link in the link's own frame, m; zero for the last.
        first_origin: (3,) origin of the first link in the base, m.
        first_moment: (n, 2) integrals of x and y over the mass, kg m.
        second_moment: (n, 4) integrals of xx, yy, xz and yz over the mass, kg m^2.
    """

    frame: Array
    next_origin: Array
    first_origin: Array
    first_moment: Array
    second_moment: Array


def base_parameters(chain: RigidChain) -> BaseParameters:
    """Return the base parameters of the arm; the axes are unit vectors."""
    return _base_parameters(*(one.tobytes() for one in chain))


@lru_cache(maxsize=32)
def _base_parameters(*content: bytes) -> BaseParameters:
    """Return those of a chain by its content; runs of a sweep mostly have one arm."""
    chain = RigidChain(*(np.frombuffer(one).reshape(shape) for one, shape in zip(content, _SHAPES, strict=True)))
    mass = chain.mass.copy()
    first = mass[:, None] * chain.com
    second = _second_moments(chain)
    for i in range(len(mass) - 1, 0, -1):
        z, origin = chain.axis[i], chain.origin[i]
        along = dot(z, first[i])
        first[i - 1] += mass[i] * origin + along * z
        second[i - 1] += mass[i] * outer(origin, origin) + dot(z, rotated(second[i], z)) * outer(z, z)
        second[i - 1] += along * (outer(origin, z) + outer(z, origin))
        mass[i - 1] += mass[i]
    # What lies along the axis has been regrouped; the entries that still hold it are not used.
    at_zero = _link_frames(chain.axis, second)
    before = np.concatenate([np.eye(3)[None], at_zero[:-1]])
    following = np.concatenate([chain.origin[1:], np.zeros((1, 3))])
    local = product(product(transposed(at_zero), second), at_zero)
    return BaseParameters(
        frame=product(transposed(before), at_zero),
        next_origin=rotated(transposed(at_zero), following),
        first_origin=chain.origin[0],
        first_moment=rotated(transposed(at_zero), first)[:, :2],
        second_moment=local[:, [0, 1, 0, 1], [0, 1, 2, 2]],
    )


def _second_moments(chain: RigidChain) -> Array:
    """Return the integrals of r r^T over the mass about the link origins, shape (n, 3, 3), kg m^2."""
    xx, yy, zz, xy, xz, yz = chain.inertia.T
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
    central = 0.5 * (xx + yy + zz)[:, None, None] * np.eye(3) - inertia
    return np.asarray(central + chain.mass[:, None, None] * outer(chain.com, chain.com))


def _link_frames(z: Array, moment: Array) -> Array:
    """Return axes (columns) with the given z, turned such that x and y are principal directions, (n, 3, 3)."""
    side = np.cross(np.eye(3)[np.argmin(np.abs(z), axis=1)], z)
    x = side / length(side)[:, None]
    y = np.cross(z, x)
    xx, yy, xy = (dot(a, rotated(moment, b)) for a, b in ((x, x), (y, y), (x, y)))
    s, c = sines_cosines(0.5 * angles_of(2.0 * xy, xx - yy)[:, None])
    return np.stack([c * x + s * y, c * y - s * x, z], axis=2)


def manipulator_record(chain: RigidChain, drives: DriveParameters) -> np.ndarray[Any, Any]:
    """Return the constants of an arm with its rotors and springs, shape (1,), of `manipulator_dtype(n)`."""
    record = np.zeros(1, manipulator_dtype(len(chain.mass)))
    arm = record[0]
    parameters = base_parameters(chain)
    arm["frame"] = parameters.frame.transpose(2, 1, 0)
    for name in ("next_origin", "first_moment", "second_moment"):
        arm[name] = getattr(parameters, name).T
    arm["first_origin"] = parameters.first_origin
    arm["base_acceleration"] = -chain.gravity
    arm["rotor"] = drives.rotor_matrix
    arm["spring_torque"] = drives.spring_torque
    return record
