"""The rigid arm in compiled code: base parameters, and from them mass matrix and bias torques of a serial chain.

The joints are revolute. It is in rx90_common because plant and controller share it.

**Base parameters** are the inertial parameters that the motion depends on (Gautier and Khalil 1990).
Mass on a joint axis moves in the same way whether it belongs to the link before or after the joint. From the tip to
the base, the mass, the first moment and the second moment along the axis of each link are therefore regrouped into the
link before it. Two first moments remain and, with the link's x axis turned such that the product of inertia about the
axis vanishes, four second moments: 6 numbers in place of 10, and neither M(q) nor h(q, v) changes.

**Mass matrix and bias torques.** All links are computed at once, one lane each (rx90_common.kernels.lanes); only the
product of the rotations runs from link to link. Every quantity is expressed in the base frame about the base origin,
where inertias and forces of several links simply add up: the composite-rigid-body algorithm (Featherstone 2008, table
6.2) becomes a sum over lanes. Mass distributions are first and second moments, integrals of r and r r^T, of the
base parameters, which contain no mass; Pinocchio is the oracle in the tests. The inverse dynamics need no mass matrix.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from rx90_common.base.arrays import Array, Record, RecordType, record_type
from rx90_common.description import rotations
from rx90_common.description.chain import RigidChain
from rx90_common.description.drives import DriveParameters
from rx90_common.kernels.compiled import inlined, kernel
from rx90_common.kernels.elementary import angles_of, sine_cosine, sines_cosines
from rx90_common.kernels.lanes import (
    Lanes,
    delay,
    first,
    fma,
    lane,
    load,
    prefix_sum,
    size,
    store,
    suffix_sum,
)


@cache
def manipulator_dtype(joints: int) -> RecordType:
    """Return the type of the constants, the link last: base parameters, gravity, the rotors' inertia, the spring."""
    return record_type(
        frame=(3, 3, joints),  # column, component, link: in the frame before, at q = 0
        next_origin=(3, joints),
        first_origin=3,
        first_moment=(2, joints),  # x, y
        second_moment=(4, joints),  # xx, yy, xz, yz
        base_acceleration=3,  # upwards: represents gravity
        rotor=(joints, joints),
        spring_torque=joints,  # amplitude of the torque -k sin(q)
    )


@cache
def body_dtype(joints: int) -> RecordType:
    """Return the type of the workspace of one evaluation: column, component, link of the rotations."""
    return record_type(orientation=(3, 3, joints))


Vector: TypeAlias = tuple[Lanes, Lanes, Lanes]
Symmetric = tuple[Vector, Vector, Vector]
"""A symmetric matrix per link, by its rows."""


@inlined
def load_vectors(rows: Array, links: int) -> Vector:
    """Return the vectors of the links, a literal, from an array of shape (3, links)."""
    return load(rows[0], links), load(rows[1], links), load(rows[2], links)


@inlined
def first_links(a: Vector) -> Vector:
    """Return the vectors of the first four links, or of all where there are fewer."""
    return first(a[0], 4), first(a[1], 4), first(a[2], 4)


@inlined
def scale(factor: Lanes, a: Vector) -> Vector:
    """Return factor a."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def add_scaled(a: Vector, factor: Lanes, b: Vector) -> Vector:
    """Return a + factor b."""
    return fma(factor, b[0], a[0]), fma(factor, b[1], a[1]), fma(factor, b[2], a[2])


@inlined
def dot(a: Vector, b: Vector) -> Lanes:
    """Return a . b."""
    return fma(a[2], b[2], fma(a[1], b[1], a[0] * b[0]))


@inlined
def add_dot(c: Lanes, a: Vector, b: Vector) -> Lanes:
    """Return c + a . b."""
    return fma(a[2], b[2], fma(a[1], b[1], fma(a[0], b[0], c)))


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return (
        fma(a[1], b[2], -(a[2] * b[1])),
        fma(a[2], b[0], -(a[0] * b[2])),
        fma(a[0], b[1], -(a[1] * b[0])),
    )


@inlined
def add_cross(c: Vector, a: Vector, b: Vector) -> Vector:
    """Return c + a x b."""
    return (
        fma(-a[2], b[1], fma(a[1], b[2], c[0])),
        fma(-a[0], b[2], fma(a[2], b[0], c[1])),
        fma(-a[1], b[0], fma(a[0], b[1], c[2])),
    )


@inlined
def product(rows: tuple[Vector, Vector, Vector], a: Vector) -> Vector:
    """Return the product of a matrix, given by its rows, and a."""
    return dot(rows[0], a), dot(rows[1], a), dot(rows[2], a)


@inlined
def sum_from_base(a: Vector) -> Vector:
    """Return for each link the sum over the links from the first one up to it."""
    return prefix_sum(a[0]), prefix_sum(a[1]), prefix_sum(a[2])


@inlined
def sum_before(start: Array, a: Vector) -> Vector:
    """Return for each link `start`, of shape (3,), plus the sum over the links before it."""
    return (
        delay(prefix_sum(a[0]) + start[0], start[0]),
        delay(prefix_sum(a[1]) + start[1], start[1]),
        delay(prefix_sum(a[2]) + start[2], start[2]),
    )


@inlined
def sum_to_tip(a: Vector) -> Vector:
    """Return for each link the sum over it and the links after it."""
    return suffix_sum(a[0]), suffix_sum(a[1]), suffix_sum(a[2])


@inlined
def of_link(a: Vector, link: int) -> Vector:
    """Return the vector of one link as three floats."""
    return lane(a[0], link), lane(a[1], link), lane(a[2], link)


@kernel
def mass_and_bias(
    arm: Any,
    body: Any,
    q: Array,
    v: Array,
    mass_matrix: Array,
    bias: Array,
) -> None:
    """Write M(q), shape (n, n), and h(q, v), shape (n,): M a + h = drive torque - friction torque.

    M includes the rotors with the coupling; h holds Coriolis, centrifugal and gravity torques and the
    gravity-compensation spring.

    Args:
        arm: record of `manipulator_dtype(n)`.
        body: record of `body_dtype(n)`, overwritten.
        q: joint positions, rad, shape (n,).
        v: joint velocities, rad/s, shape (n,).
        mass_matrix: overwritten, kg m^2.
        bias: overwritten, Nm.
    """
    pose = _pose(arm, body, q)
    z = pose.z
    moment = pose.moment
    origin = pose.origin
    turn = scale(load(v, size(arm.rotor)), z)
    w = sum_from_base(turn)
    # The link's own turn adds nothing to w x turn, so w may include it.
    field = _acceleration_field(w, sum_from_base(cross(w, turn)))
    store(bias, _torques(arm, pose, field))

    # The joint axes as spatial vectors (z, lever): angular, and linear at the base origin.
    lever = cross(origin, z)
    spread = _about_base(pose.spread, moment, origin)
    moment = sum_to_tip(moment)
    _project(
        arm.rotor,
        z,
        lever,
        _angular_momentum(spread, moment, z, lever),
        cross(z, moment),
        mass_matrix,
    )


@kernel
def inverse_dynamics(
    arm: Any,
    body: Any,
    q: Array,
    v: Array,
    a: Array,
    torque: Array,
) -> None:
    """Write M(q) a + h(q, v), shape (n,), without the mass matrix (recursive Newton-Euler: Featherstone 2008, 5.3).

    Args:
        arm: constants, a record of `manipulator_dtype(n)`.
        body: workspace, a record of `body_dtype(n)`.
        q: joint positions, rad, shape (n,).
        v: joint velocities, rad/s, shape (n,).
        a: joint accelerations, rad/s^2, shape (n,).
        torque: overwritten, Nm.
    """
    pose = _pose(arm, body, q)
    z = pose.z
    acceleration = load(a, size(arm.rotor))
    turn = scale(load(v, size(arm.rotor)), z)
    w = sum_from_base(turn)
    field = _acceleration_field(w, sum_from_base(add_scaled(cross(w, turn), acceleration, z)))
    total = _torques(arm, pose, field)
    for i in range(size(arm.rotor)):
        total = fma(a[i], load(arm.rotor[i], size(arm.rotor)), total)
    store(torque, total)


class _Pose(NamedTuple):
    """The links at joint positions, in the base frame.

    Attributes:
        z: the joint axes.
        sine: of the joint positions.
        step: from each link's origin to the next one's, m.
        origin: m, from the base.
        moment: first moments about the origins, kg m.
        spread: second moments about the origins, kg m^2.
    """

    z: Vector
    sine: Lanes
    step: Vector
    origin: Vector
    moment: Vector
    spread: Symmetric


@inlined
def _pose(arm: Any, body: Any, q: Array) -> _Pose:
    n = size(arm.rotor)
    sine, cosine = sine_cosine(load(q, n))
    _turn_joints(arm.frame, body.orientation, sine, cosine)
    _chain_rotations(body.orientation)
    x = load_vectors(body.orientation[0], n)
    y = load_vectors(body.orientation[1], n)
    z = load_vectors(body.orientation[2], n)
    step = _combine(x, y, z, load_vectors(arm.next_origin, n))
    origin = sum_before(arm.first_origin, step)
    moment = add_scaled(scale(load(arm.first_moment[0], n), x), load(arm.first_moment[1], n), y)
    return _Pose(z, sine, step, origin, moment, _second_moment(arm.second_moment, x, y, z))


@inlined
def _torques(arm: Any, pose: Any, field: tuple[Vector, Vector, Vector]) -> Lanes:
    """Return the joint torques for accelerations `field` of the links' points, springs included, Nm."""
    acceleration = sum_before(arm.base_acceleration, product(field, pose.step))
    force = product(field, pose.moment)
    torque = add_cross(_torque(field, pose.spread), pose.moment, acceleration)
    torque = sum_to_tip(add_cross(torque, pose.origin, force))
    force = sum_to_tip(force)
    spring = load(arm.spring_torque, size(arm.spring_torque)) * pose.sine
    return add_dot(add_dot(spring, pose.z, torque), cross(pose.origin, pose.z), force)


@inlined
def _turn_joints(frame: Any, orientation: Any, sine: Lanes, cosine: Lanes) -> None:
    """Write each link's orientation in the link before it: its frame at q = 0 turned about z by q."""
    for k in range(3):
        x = load(frame[0, k], size(frame))
        y = load(frame[1, k], size(frame))
        store(orientation[0, k], fma(sine, y, cosine * x))
        store(orientation[1, k], fma(-sine, x, cosine * y))
        store(orientation[2, k], load(frame[2, k], size(frame)))


@inlined
def _chain_rotations(orientation: Any) -> None:
    """Turn orientations in the link before into orientations in the base, from the first link on."""
    x = _column(orientation[0], 0)
    y = _column(orientation[1], 0)
    z = _column(orientation[2], 0)
    for i in range(1, size(orientation)):
        a = _column(orientation[0], i)
        b = _column(orientation[1], i)
        c = _column(orientation[2], i)
        x, y, z = _combine(x, y, z, a), _combine(x, y, z, b), _combine(x, y, z, c)
        for k in range(3):
            orientation[0, k, i] = x[k]
            orientation[1, k, i] = y[k]
            orientation[2, k, i] = z[k]


@inlined
def _column(rows: Any, link: int) -> Vector:
    return rows[0, link], rows[1, link], rows[2, link]


@inlined
def _combine(x: Vector, y: Vector, z: Vector, a: Vector) -> Vector:
    """Return a, given along the axes x, y, z, in the base frame."""
    return add_scaled(add_scaled(scale(a[0], x), a[1], y), a[2], z)


@inlined
def _second_moment(constants: Any, x: Vector, y: Vector, z: Vector) -> Symmetric:
    """Return the second moments about the link origins: xx x x^T + yy y y^T + c z^T + z c^T, c = xz x + yz y."""
    n = size(constants)
    a = scale(load(constants[0], n), x)
    b = scale(load(constants[1], n), y)
    c = add_scaled(scale(load(constants[2], n), x), load(constants[3], n), y)
    xx = fma(a[0], x[0], fma(b[0], y[0], 2.0 * (c[0] * z[0])))
    yy = fma(a[1], x[1], fma(b[1], y[1], 2.0 * (c[1] * z[1])))
    zz = fma(a[2], x[2], fma(b[2], y[2], 2.0 * (c[2] * z[2])))
    xy = fma(a[0], x[1], fma(b[0], y[1], fma(c[0], z[1], c[1] * z[0])))
    xz = fma(a[0], x[2], fma(b[0], y[2], fma(c[0], z[2], c[2] * z[0])))
    yz = fma(a[1], x[2], fma(b[1], y[2], fma(c[1], z[2], c[2] * z[1])))
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


@inlined
def _acceleration_field(w: Vector, a: Vector) -> tuple[Vector, Vector, Vector]:
    """Return B with the acceleration of a link's point at r from its origin: origin's acceleration + B r.

    B r = a x r + w x (w x r) with angular velocity w and angular acceleration a.
    """
    return (
        (-fma(w[1], w[1], w[2] * w[2]), fma(w[0], w[1], -a[2]), fma(w[0], w[2], a[1])),
        (fma(w[0], w[1], a[2]), -fma(w[0], w[0], w[2] * w[2]), fma(w[1], w[2], -a[0])),
        (fma(w[0], w[2], -a[1]), fma(w[1], w[2], a[0]), -fma(w[0], w[0], w[1] * w[1])),
    )


@inlined
def _torque(field: tuple[Vector, Vector, Vector], spread: Symmetric) -> Vector:
    """Return the integral of r x (B r) over the mass: the skew part of B times the second moment."""
    x, y, z = field
    return (
        dot(z, spread[1]) - dot(y, spread[2]),
        dot(x, spread[2]) - dot(z, spread[0]),
        dot(y, spread[0]) - dot(x, spread[1]),
    )


@inlined
def _about_base(spread: Symmetric, moment: Vector, p: Vector) -> Symmetric:
    """Move second moments from the link origins p to the base origin and sum them to the tip; no mass."""
    xx = suffix_sum(fma(2.0 * p[0], moment[0], spread[0][0]))
    yy = suffix_sum(fma(2.0 * p[1], moment[1], spread[1][1]))
    zz = suffix_sum(fma(2.0 * p[2], moment[2], spread[2][2]))
    xy = suffix_sum(fma(p[0], moment[1], fma(p[1], moment[0], spread[0][1])))
    xz = suffix_sum(fma(p[0], moment[2], fma(p[2], moment[0], spread[0][2])))
    yz = suffix_sum(fma(p[1], moment[2], fma(p[2], moment[1], spread[1][2])))
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


@inlined
def _angular_momentum(spread: Symmetric, moment: Vector, z: Vector, lever: Vector) -> Vector:
    """Return the angular momentum of all that a joint moves, for a unit of its velocity."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = spread
    turning = (
        fma(yy + zz, z[0], -fma(xy, z[1], xz * z[2])),
        fma(xx + zz, z[1], -fma(xy, z[0], yz * z[2])),
        fma(xx + yy, z[2], -fma(xz, z[0], yz * z[1])),
    )
    return add_cross(turning, moment, lever)


@inlined
def _project(
    rotor: Any, z: Vector, lever: Vector, angular: Vector, linear: Vector, mass_matrix: Any
) -> None:
    """Write the mass matrix: the momentum that joint i makes, projected on the axes of the joints before it."""
    # Only joints before i count in row i, so four lanes do for the first four rows.
    near = first_links(z)
    near_lever = first_links(lever)
    for i in range(size(near[0])):
        row = add_dot(load(rotor[i], size(near[0])), near, of_link(angular, i))
        store(mass_matrix[i], add_dot(row, near_lever, of_link(linear, i)))
    for i in range(size(near[0]), size(rotor)):
        row = add_dot(load(rotor[i], size(rotor)), z, of_link(angular, i))
        store(mass_matrix[i], add_dot(row, lever, of_link(linear, i)))
    for i in range(size(rotor)):
        for j in range(i):
            mass_matrix[j, i] = mass_matrix[i, j]


@inlined
def factorise(mass_matrix: Array, factor: Array) -> None:
    """Write the factors L D L^T of a mass matrix, both in records, shape (n, n): L below, 1 / D_ii on the diagonal."""
    n = size(factor)
    for i in range(n):
        for j in range(i + 1):
            factor[i, j] = mass_matrix[i, j]
    for j in range(n):
        inverse = 1.0 / factor[j, j]
        for i in range(j + 1, n):
            entry = factor[i, j] * inverse
            for k in range(j + 1, i + 1):
                factor[i, k] = fma(-entry, factor[k, j], factor[i, k])
        for i in range(j + 1, n):
            factor[i, j] *= inverse
        factor[j, j] = inverse


@inlined
def solve(factor: Array, x: Array) -> None:
    """Solve M x = b in place for the factor written by `factorise`; `x` holds b, shape (n,)."""
    n = size(factor)
    for k in range(n - 1):
        for i in range(k + 1, n):
            x[i] = fma(-factor[i, k], x[k], x[i])
    for i in range(n):
        x[i] *= factor[i, i]
    for k in range(n - 1, 0, -1):
        for i in range(k):
            x[i] = fma(-factor[k, i], x[k], x[i])


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
    chain = RigidChain(
        *(np.frombuffer(one).reshape(shape) for one, shape in zip(content, _SHAPES, strict=True))
    )
    mass = chain.mass.copy()
    first = mass[:, None] * chain.com
    second = _second_moments(chain)
    for i in range(len(mass) - 1, 0, -1):
        z = chain.axis[i]
        origin = chain.origin[i]
        along = rotations.dot(z, first[i])
        first[i - 1] += mass[i] * origin + along * z
        second[i - 1] += mass[i] * rotations.outer(origin, origin) + rotations.dot(
            z, rotations.rotated(second[i], z)
        ) * rotations.outer(z, z)
        second[i - 1] += along * (rotations.outer(origin, z) + rotations.outer(z, origin))
        mass[i - 1] += mass[i]
    # What lies along the axis has been regrouped; the entries that still hold it are not used.
    at_zero = _link_frames(chain.axis, second)
    before = np.concatenate([np.eye(3)[None], at_zero[:-1]])
    following = np.concatenate([chain.origin[1:], np.zeros((1, 3))])
    local = rotations.product(rotations.product(rotations.transposed(at_zero), second), at_zero)
    return BaseParameters(
        frame=rotations.product(rotations.transposed(before), at_zero),
        next_origin=rotations.rotated(rotations.transposed(at_zero), following),
        first_origin=chain.origin[0],
        first_moment=rotations.rotated(rotations.transposed(at_zero), first)[:, :2],
        second_moment=local[:, [0, 1, 0, 1], [0, 1, 2, 2]],
    )


def _second_moments(chain: RigidChain) -> Array:
    """Return the integrals of r r^T over the mass about the link origins, shape (n, 3, 3), kg m^2."""
    xx, yy, zz, *_ = chain.inertia.T
    central = 0.5 * (xx + yy + zz)[:, None, None] * np.eye(3) - rotations.symmetric(chain.inertia)
    return np.asarray(central + chain.mass[:, None, None] * rotations.outer(chain.com, chain.com))


def _link_frames(z: Array, moment: Array) -> Array:
    """Return axes (columns) with the given z, turned such that x and y are principal directions, (n, 3, 3)."""
    side = np.cross(np.eye(3)[np.argmin(np.abs(z), axis=1)], z)
    x = side / rotations.length(side)[:, None]
    y = np.cross(z, x)
    xx = rotations.dot(x, rotations.rotated(moment, x))
    yy = rotations.dot(y, rotations.rotated(moment, y))
    xy = rotations.dot(x, rotations.rotated(moment, y))
    s, c = sines_cosines(0.5 * angles_of(2.0 * xy, xx - yy)[:, None])
    return np.stack([c * x + s * y, c * y - s * x, z], axis=2)


def manipulator_record(chain: RigidChain, drives: DriveParameters) -> Record:
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
