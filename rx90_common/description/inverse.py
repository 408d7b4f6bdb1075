"""Inverse kinematics: in closed form for arms with a spherical wrist, by damped Newton steps for others.

The closed form covers arms whose axis 1 is vertical, whose axes 2 and 3 are parallel and horizontal at
q = 0, and whose axes 4, 5 and 6 meet in one point; the RX90 is one of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.branch import Branch
from rx90_common.description.chain import RigidChain
from rx90_common.description.kinematics import Pose, forward, jacobian
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import (
    axis_rotation,
    dot,
    length,
    product,
    rotated,
    rotation_vector,
    solved,
    transposed,
)
from rx90_common.kernels.elementary import angles_of, sines_cosines

_Y = np.array([0.0, 1.0, 0.0])
_Z = np.array([0.0, 0.0, 1.0])
# Geometry read from a URDF counts as exact within this many metres or sines.
_GEOMETRY_TOLERANCE = 1e-9
_NEWTON_STEPS = 60
_NEWTON_RESIDUAL = 1e-12
_RESTARTS = 100


class SphericalWristArm(NamedTuple):
    """The constants of the closed form, all in the base frame at q = 0, m.

    Attributes:
        axis_1: (2,) x and y of axis 1.
        shoulder: (2,) x from axis 1, and z, of axis 2.
        upper: (2,) x and z from axis 2 to axis 3.
        fore: (2,) x and z from axis 3 to the wrist centre.
        lateral: y of the wrist centre from axis 1.
        wrist: (3,) the wrist centre in the frame of link 6.
        basis: (3, 3) columns: axis 5 × axis 4, axis 5, axis 4.
        signs: (6,) ±1: the sense of each axis against z, y, y, axis 4, axis 5, axis 4.
    """

    axis_1: Array
    shoulder: Array
    upper: Array
    fore: Array
    lateral: float
    wrist: Array
    basis: Array
    signs: Array

    @property
    def reach(self) -> float:
        """Return the largest distance from axis 2 to the wrist centre, m."""
        return float(_plane_length(self.upper) + _plane_length(self.fore))

    @staticmethod
    def from_chain(chain: RigidChain) -> SphericalWristArm | None:
        """Return the closed form's constants, or None where the chain has another geometry."""
        if len(chain.axis) != 6:
            return None
        center = np.cumsum(chain.origin, axis=0)
        axis = chain.axis
        basis = np.column_stack([np.cross(axis[4], axis[3]), axis[4], axis[3]])
        references = np.array([_Z, _Y, _Y, axis[3], axis[4], axis[3]])
        signs = np.sign(dot(axis, references))
        aligned = np.allclose(axis, signs[:, None] * references, rtol=0.0, atol=_GEOMETRY_TOLERANCE)
        if not aligned or abs(dot(axis[3], axis[4])) > _GEOMETRY_TOLERANCE:
            return None
        # The axes 4 and 5 are perpendicular: their nearest points share the coordinate across both.
        wrist = center[3] + axis[3] * dot(axis[3], center[4] - center[3])
        for k in (4, 5):
            offset = wrist - center[k]
            if length(offset - axis[k] * dot(axis[k], offset)) > _GEOMETRY_TOLERANCE:
                return None
        plane = [0, 2]
        arm = SphericalWristArm(
            axis_1=center[0, :2],
            shoulder=np.array([center[1, 0] - center[0, 0], center[1, 2]]),
            upper=(center[2] - center[1])[plane],
            fore=(wrist - center[2])[plane],
            lateral=float(wrist[1] - center[0, 1]),
            wrist=wrist - center[5],
            basis=basis,
            signs=signs,
        )
        return arm if min(_plane_length(arm.upper), _plane_length(arm.fore)) > 0.0 else None

    def solve(self, chain: RigidChain, pose: Pose, branch: Branch) -> Array:
        """Return the joint angles (n, 6) in (-2π, 2π] for poses (n, 3), (n, 3, 3); NaN rows: out of reach."""
        wrist, rotation = self._link_6(chain, pose)
        q = np.empty((len(wrist), 6))
        with np.errstate(invalid="ignore"):
            q[:, :3] = self._arm_angles(wrist, branch)
        before = product(axis_rotation(_Z, q[:, 0]), axis_rotation(_Y, q[:, 1] + q[:, 2]))
        q[:, 3:] = self._wrist_angles(product(transposed(before), rotation), branch)
        return q * self.signs

    def _link_6(self, chain: RigidChain, pose: Pose) -> Pose:
        """Return the wrist centre and the axes of link 6, for poses of the tool centre point."""
        rotation = product(pose.rotation, transposed(chain.tcp_rotation))
        return Pose(pose.position + rotated(rotation, self.wrist - chain.tcp_position), rotation)

    def _arm_angles(self, wrist: Array, branch: Branch) -> Array:
        x, y = (wrist[:, :2] - self.axis_1).T
        facing = 1.0 if branch.shoulder == "front" else -1.0
        forward_reach = facing * np.sqrt(x * x + y * y - self.lateral * self.lateral)
        angle_1 = angles_of(y, x) - angles_of(self.lateral, forward_reach)
        d = np.stack([forward_reach, wrist[:, 2]], axis=-1) - self.shoulder
        upper = _plane_length(self.upper)
        fore = _plane_length(self.fore)
        squared = d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]
        # Half-angle form of the law of cosines: exact to rounding also near the stretched arm.
        far = (upper + fore) * (upper + fore)
        near = (upper - fore) * (upper - fore)
        elbow = 2.0 * angles_of(np.sqrt(far - squared), np.sqrt(squared - near))
        elbow *= 1.0 if branch.elbow == "positive" else -1.0
        sine, cosine = sines_cosines(elbow)
        lag = angles_of(fore * sine, upper + fore * cosine)
        angle_2 = angles_of(d[:, 0], d[:, 1]) - angles_of(*self.upper) - lag
        angle_3 = elbow + angles_of(*self.upper) - angles_of(*self.fore)
        return np.stack([angle_1, angle_2, angle_3], axis=-1)

    def _wrist_angles(self, rotation: Array, branch: Branch) -> Array:
        """Split the wrist's rotation into turns about axis 4, axis 5 and axis 4 (z-y-z in its basis)."""
        w = product(product(transposed(self.basis), rotation), self.basis)
        sign = 1.0 if branch.wrist == "positive" else -1.0
        angle_4 = angles_of(sign * w[:, 1, 2], sign * w[:, 0, 2])
        angle_5 = sign * angles_of(_plane_length(w[:, :2, 2]), w[:, 2, 2])
        angle_6 = angles_of(sign * w[:, 2, 1], -sign * w[:, 2, 0])
        return np.stack([angle_4, angle_5, angle_6], axis=-1)

    def forward_reach(self, chain: RigidChain, q: Array) -> Array:
        """Return the distance (n,) of the wrist centre from axis 1 in the arm plane, signed, m."""
        wrist, _ = self._link_6(chain, forward(chain, q))
        sine, cosine = sines_cosines(self.signs[0] * np.asarray(q)[..., 0])
        x = wrist[..., 0] - self.axis_1[0]
        y = wrist[..., 1] - self.axis_1[1]
        return np.asarray(x * cosine + y * sine)

    def elbow_angle(self, q: Array) -> Array:
        """Return the angle (n,) from the upper arm to the forearm, rad."""
        bend = angles_of(*self.fore) - angles_of(*self.upper)
        return np.asarray(self.signs[2] * np.asarray(q)[..., 2] + bend)


def _plane_length(vector: Array) -> Array:
    """Return the lengths (...) of vectors (..., 2)."""
    return np.sqrt(vector[..., 0] * vector[..., 0] + vector[..., 1] * vector[..., 1])


def nearest_turn(q: Array, reference: Array) -> Array:
    """Shift each angle by whole turns to within half a turn of `reference`."""
    return q - 2.0 * np.pi * np.round((q - reference) / (2.0 * np.pi))


def singularity_margins(chain: RigidChain, q: Array) -> dict[str, Array]:
    """Return how far `q` (..., n) is from each kind of singularity, dimensionless, 0 at the singularity.

    For a spherical-wrist arm: 'wrist' |sin q5|, 'elbow' the sine of the angle between upper arm and
    forearm, 'shoulder' the distance of the wrist centre from axis 1 over the reach; |det J| is the product of
    the three, of both arm lengths and of the reach. For any other arm: 'arm', the smallest singular
    value of the Jacobian with lengths over 1 m.
    """
    arm = SphericalWristArm.from_chain(chain)
    if arm is None:
        return {"arm": np.asarray(np.linalg.svd(jacobian(chain, q), compute_uv=False)[..., -1])}
    return {
        "shoulder": np.abs(arm.forward_reach(chain, q)) / arm.reach,
        "elbow": np.abs(sines_cosines(arm.elbow_angle(q))[0]),
        "wrist": np.abs(sines_cosines(np.asarray(q)[..., 4])[0]),
    }


def pose_error(chain: RigidChain, q: Array, pose: Pose) -> Array:
    """Return the twist (6,) in m and rad that leads from the pose at `q` (n,) to `pose`, in base axes."""
    here = forward(chain, q)
    return np.concatenate(
        [
            pose.position - here.position,
            rotation_vector(product(pose.rotation, transposed(here.rotation))),
        ]
    )


def solve_near(chain: RigidChain, pose: Pose, guess: Array) -> Array | None:
    """Return the joint angles (n,) of one pose near `guess` by damped Newton steps, or None.

    The damping decreases with the error, so that the convergence is quadratic at the end, to rounding. An arm of more
    than six joints takes the shortest of the steps to the pose: none moves its elbow alone.
    """
    q = newton_steps(chain, pose, guess)
    return q if _size(pose_error(chain, q, pose)) < 10.0 * _NEWTON_RESIDUAL else None


def newton_steps(chain: RigidChain, pose: Pose, guess: Array) -> Array:
    """Return the joint angles (n,) at which damped Newton steps towards a pose end, whether they reach it or not."""
    q = np.array(guess, dtype=np.float64)
    error = pose_error(chain, q, pose)
    for _ in range(_NEWTON_STEPS):
        size = _size(error)
        if size < _NEWTON_RESIDUAL:
            break
        j = jacobian(chain, q)
        damping = 1e-2 * min(size * size, 1.0)
        # jᵀ (j jᵀ + damping)⁻¹ error; sums over the joints one after the other.
        squared = _sum_first(j.T[:, :, None] * j.T[:, None, :]) + damping * np.eye(6)
        q = q + _sum_first(j * solved(squared, error)[:, None])
        error = pose_error(chain, q, pose)
    return q


def _sum_first(terms: Array) -> Array:
    """Return the sum over the first axis, in its order."""
    return np.asarray(np.cumsum(terms, axis=0)[-1])


def _size(error: Array) -> float:
    return float(np.sqrt(_sum_first(error * error)))


def solve_anywhere(robot: RobotModel, pose: Pose) -> Array | None:
    """Return joint angles (n,) within the limits for one pose, or None.

    For arms without a closed form: Newton steps from the middle of the joint ranges, then from a fixed
    sequence of places within them, so that the same pose always gives the same answer.
    """
    guesses = np.random.default_rng(0).uniform(
        robot.lower, robot.upper, (_RESTARTS, len(robot.lower))
    )
    guesses[0] = (robot.lower + robot.upper) / 2.0
    for guess in guesses:
        q = solve_near(robot.chain, pose, guess)
        if q is not None:
            q = nearest_turn(q, guesses[0])
            if np.all((q >= robot.lower) & (q <= robot.upper)):
                return q
    return None
