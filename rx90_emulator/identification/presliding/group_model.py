"""Friction and inertia of a group of joints along its micro-motions, and the residuals of a fit, scaled to unit noise.

A bristle is deflected along the measured motion; what does not depend on c0 and c1 is computed once. Torques are
compared at the frequencies of micro-oscillations alone. The noise of the encoder, which reaches the torque through the
controller, is there some thousandths of the motion. The noise of the torque is in the measured side of the comparison
only, so that it makes the estimates uncertain, not biased. A simulation driven by the recorded torque would respond to
its noise at the resonance as if it were motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_common.friction.bristle import damping, decay, sliding_torque
from rx90_common.friction.compiled_elements import element_arrays, one_element
from rx90_common.kernels.compiled import kernel
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.micro_motion import BLOCK, MicroMotion, band_spectrum, block_means


@dataclass(frozen=True, eq=False)
class BristlePath:
    """A motion of one element, as its bristle sees it.

    Attributes:
        motion: input velocity, held over each step, rad/s; c0 g(v), equation 19, Nm; c1(v) / c1; shape (3, m).
        viscous: viscous torque, Nm, block means, shape (m // BLOCK,).
        coulomb: Coulomb torque, Nm.
        step: s.
    """

    motion: Array
    viscous: Array
    coulomb: float
    step: float

    @classmethod
    def of(cls, element: FrictionElement, speed: Array, step: float) -> BristlePath:
        """Return the path of an element, of which c0 and c1 are not used.

        Args:
            element: its sliding regime.
            speed: input velocity, rad/s, shape (m,).
            step: s.
        """
        motion = np.empty((3, len(speed)))
        motion[0] = speed
        _sliding_regime(element_arrays((replace(element, c1=1.0),)), motion)
        return cls(motion, block_means(element.viscous_torque(speed)), element.tau_c_positive, step)

    @property
    def speed(self) -> Array:
        """Return the input velocity, rad/s, shape (m,)."""
        return np.asarray(self.motion[0])

    def deflect(self, c0: float, start: float) -> tuple[Array, Array]:
        """Return block means of the bristle's torque, Nm, and of the rate that c1 multiplies, rad/s.

        Args:
            c0: Nm/rad.
            start: deflection at the start over that of steady sliding.
        """
        result = np.empty((2, self.motion.shape[1]))
        deflect_bristle(self.motion, self.step, c0, start * self.coulomb / c0, result)
        return block_means(result[0]), block_means(result[1])


@kernel
def _sliding_regime(arrays: NDArray[Any], motion: Array) -> None:
    element = one_element(arrays[0], 0)
    for row in range(motion.shape[1]):
        motion[1, row] = sliding_torque(element, motion[0, row])
        motion[2, row] = damping(element, motion[0, row])


@kernel
def deflect_bristle(motion: Array, step: float, c0: float, start: float, result: Array) -> None:
    """Deflect a bristle by the exact steps of the simulation.

    Args:
        motion: as the attribute of BristlePath, shape (3, m).
        step: s.
        c0: Nm/rad.
        start: deflection at the start, rad.
        result: takes the means over each step of the bristle's torque, Nm, and of the rate of deflection times
            c1(v) / c1, rad/s, shape (2, m).
    """
    z = start
    for row in range(motion.shape[1]):
        v = motion[0, row]
        rate = c0 * abs(v) / motion[1, row]
        phi, psi = decay(rate * step)
        z_dot = v - rate * z
        result[0, row] = c0 * (z + step * z_dot * psi)
        result[1, row] = motion[2, row] * z_dot * phi
        z += step * z_dot * phi


_RELATIVE_STEP = 1e-4  # relative step of difference quotients


@dataclass(frozen=True, eq=False)
class JointGroup:
    """Joints that share friction elements with each other and with no other joint.

    Attributes:
        joints: indices of the group's k joints.
        elements: indices of their e elements.
        inputs: velocities of these joints to input velocities of the elements, shape (e, k).
    """

    joints: tuple[int, ...]
    elements: tuple[int, ...]
    inputs: Array


def joint_groups(arm: RigidArm) -> list[JointGroup]:
    """Return the groups of an arm's joints, from base to tip."""
    groups = [{j} for j in range(len(arm.names))]
    for row in arm.element_matrix:
        joined: set[int] = set(np.flatnonzero(row).tolist())
        touched = [group for group in groups if group & joined]
        groups = [group for group in groups if not group & joined] + [set().union(*touched)]
    found = []
    for joints in sorted(tuple(sorted(group)) for group in groups):
        elements = np.flatnonzero(arm.element_matrix[:, list(joints)].any(axis=1))
        found.append(JointGroup(joints, tuple(elements.tolist()), arm.element_matrix[elements][:, list(joints)]))
    return found


@dataclass(frozen=True)
class ParameterVector:
    """What stands where in the parameters x of a group's fit.

    First ln c0 and ln c1, element by element; then errors of the mass matrix in parts of sqrt(M_jj M_ii); then the
    start deflections of the elements in parts of those of steady sliding, motion by motion. All micro-oscillations are
    made at one pose, so whatever the description of the links lacks is a constant error of the mass matrix.

    Attributes:
        elements: e of them.
        joints: indices of the group's k joints.
        arm_joints: n, of the whole arm.
        motions: micro-motions of the group.
    """

    elements: int
    joints: tuple[int, ...]
    arm_joints: int
    motions: int

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Return row and column of each free entry of the group's rows of the mass matrix: one of a symmetric pair.

        The other joints hardly move, by less than their encoders resolve.
        """
        k = len(self.joints)
        return [(j, self.joints[i]) for j in range(k) for i in range(j, k)]

    @property
    def bristles(self) -> int:
        """Return how many are ln c0 or ln c1; they come first."""
        return 2 * self.elements

    @property
    def shared(self) -> int:
        """Return how many belong to all motions; they come before the start deflections."""
        return self.bristles + len(self.pairs)

    @property
    def size(self) -> int:
        """Return how many there are."""
        return self.shared + self.elements * self.motions

    def start_columns(self, index: int) -> range:
        """Return where the start deflections of a motion stand."""
        first = self.shared + index * self.elements
        return range(first, first + self.elements)

    def values(self, x: Array) -> Array:
        """Return c0, Nm/rad, and c1, Nm s/rad, shape (e, 2)."""
        return np.exp(np.clip(x[: self.bristles], -20.0, 25.0)).reshape(-1, 2)

    def start(self, x: Array, index: int) -> Array:
        """Return the start deflections of a motion, shape (e,)."""
        return np.asarray(x[self.start_columns(index)])

    def inertia_errors(self, x: Array) -> Array:
        """Return the relative errors of the group's rows of the mass matrix, shape (k, n)."""
        errors = np.zeros((len(self.joints), self.arm_joints))
        for value, (j, i) in zip(x[self.bristles : self.shared], self.pairs, strict=True):
            errors[j, i] = value
            errors[self.joints.index(i), self.joints[j]] = value
        return errors


@dataclass(frozen=True, eq=False)
class GroupFriction:
    """Friction torques of a group along its micro-motions.

    Attributes:
        parameters: of the fit.
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        sliding: the elements' sliding regime.
        speeds: input velocities of each motion, rad/s, shape (m, e).
        step: of each motion, s.
    """

    parameters: ParameterVector
    inputs: Array
    sliding: tuple[FrictionElement, ...]
    speeds: tuple[Array, ...]
    step: tuple[float, ...]
    _last: dict[tuple[int, int], tuple[tuple[float, float], tuple[Array, Array]]] = field(
        default_factory=dict, init=False
    )

    @cached_property
    def paths(self) -> list[list[BristlePath]]:
        """Return the paths of the elements along each motion."""
        return [
            [BristlePath.of(element, speed[:, n], step) for n, element in enumerate(self.sliding)]
            for speed, step in zip(self.speeds, self.step, strict=True)
        ]

    def with_element(self, n: int, element: FrictionElement) -> GroupFriction:
        """Return the same motions with another sliding regime of one element."""
        return replace(self, sliding=(*self.sliding[:n], element, *self.sliding[n + 1 :]))

    def deflection(self, x: Array, index: int, n: int) -> tuple[Array, Array]:
        """Return what `BristlePath.deflect` does of element n along a motion; the last result is kept."""
        key = float(self.parameters.values(x)[n, 0]), float(self.parameters.start(x, index)[n])
        known = self._last.get((index, n))
        if known is None or known[0] != key:
            known = self._last[index, n] = key, self.paths[index][n].deflect(*key)
        return known[1]

    def torque(self, x: Array, index: int) -> Array:
        """Return block means of the friction torque at the joints along a motion, Nm, shape (b, k)."""
        values, total = self.parameters.values(x), []
        for n, path in enumerate(self.paths[index]):
            torque, rate = self.deflection(x, index, n)
            total.append(torque + values[n, 1] * rate + path.viscous)
        return np.column_stack(total) @ self.inputs

    def slopes(self, x: Array, index: int) -> tuple[list[Array], list[Array]]:
        """Return derivatives of the torque by ln c0 and ln c1 in turn, and by the start deflections, each (b, k)."""
        by_bristles, by_starts = [], []
        values, starts = self.parameters.values(x), self.parameters.start(x, index)
        for n, (path, (c0, c1), start) in enumerate(zip(self.paths[index], values, starts, strict=True)):
            torque, rate = self.deflection(x, index, n)
            here, row = torque + c1 * rate, self.inputs[n]
            stiffer, moved = path.deflect(c0 * (1.0 + _RELATIVE_STEP), start), path.deflect(c0, start + _RELATIVE_STEP)
            by_c0, by_start = ((one[0] + c1 * one[1] - here) / _RELATIVE_STEP for one in (stiffer, moved))
            by_bristles += [np.outer(by_c0, row), np.outer(c1 * rate, row)]
            by_starts.append(np.outer(by_start, row))
        return by_bristles, by_starts

    def loads(self, x: Array) -> Array:
        """Return the amplitude of each bristle's torque over its Coulomb torque, shape (motions, e)."""
        found = np.empty((len(self.paths), len(self.sliding)))
        for index, paths in enumerate(self.paths):
            for n, path in enumerate(paths):
                low, high = np.percentile(self.deflection(x, index, n)[0], (1.0, 99.0))
                found[index, n] = 0.5 * (high - low) / path.coulomb
        return found


Clusters = NDArray[np.int64]

INERTIA_DEVIATION = 0.05
"""Prior standard deviation of the errors of the mass matrix in parts of sqrt(M_jj M_ii)."""
_START_DEVIATION = 0.3  # prior standard deviation of a start deflection, in parts of that of steady sliding
_LINE_HZ = 1.0  # Hz, over which errors may be correlated: the line of a tone, widened by its fade
_NOISE_POWER_SD = 3.0  # standard deviations of the noise's power that are no misfit


class MotionBlocks(NamedTuple):
    """Block means of a micro-motion, with what turns accelerations into torques.

    Attributes:
        drive: drive torque less weight, Nm, shape (b, k).
        acceleration: of all joints, rad/s^2, shape (b, n).
        mass: the group's rows of the mass matrix, kg m^2, shape (k, n).
        mass_scale: sqrt(M_jj M_ii), kg m^2, shape (k, n).
        step: s.
    """

    drive: Array
    acceleration: Array
    mass: Array
    mass_scale: Array
    step: float

    @classmethod
    def of(cls, motion: MicroMotion) -> MotionBlocks:
        """Average a micro-motion."""
        scale = np.sqrt(np.outer(motion.inertia[list(motion.joints)], motion.inertia))
        return cls(block_means(motion.drive), block_means(motion.acceleration), motion.mass, scale, motion.step)


@dataclass(frozen=True, eq=False)
class GroupResidual:
    """Torque residuals of all micro-motions of a group in standard deviations, then the prior's residuals.

    Attributes:
        motions: what was measured.
        friction: what the elements give.
        scale: standard deviation of the torques' noise in a single step, Nm, shape (k,).
    """

    motions: tuple[MotionBlocks, ...]
    friction: GroupFriction
    scale: Array

    @classmethod
    def of(cls, motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[FrictionElement]) -> GroupResidual:
        """Return the residuals with a first guess of the noise: a tenth of the Coulomb torque."""
        first = motions[0]
        parameters = ParameterVector(len(sliding), first.joints, len(first.inertia), len(motions))
        speeds = tuple(motion.velocity @ inputs.T for motion in motions)
        friction = GroupFriction(parameters, inputs, tuple(sliding), speeds, tuple(motion.step for motion in motions))
        scale = 0.1 * np.abs(inputs).T @ np.array([e.tau_c_positive for e in sliding])
        return cls(tuple(MotionBlocks.of(motion) for motion in motions), friction, scale)

    @property
    def parameters(self) -> ParameterVector:
        """Return what stands where in x."""
        return self.friction.parameters

    def mass(self, x: Array, index: int) -> Array:
        """Return the group's rows of the mass matrix, kg m^2, shape (k, n)."""
        motion = self.motions[index]
        return np.asarray(motion.mass + self.parameters.inertia_errors(x) * motion.mass_scale)

    def of_motion(self, x: Array, index: int) -> Array:
        """Return the torque residuals of a motion at each frequency, in standard deviations, shape (r, k)."""
        motion = self.motions[index]
        inertial = motion.acceleration @ self.mass(x, index).T
        torque = motion.drive - inertial - self.friction.torque(x, index)
        return np.asarray(band_spectrum(torque, motion.step)[0] / self.scale)

    def of_all(self, x: Array) -> Array:
        """Return the torque residuals of all motions, shape (sum of r, k)."""
        return np.vstack([self.of_motion(x, index) for index in range(len(self.motions))])

    def __call__(self, x: Array) -> Array:
        """Return all residuals, shape (q,)."""
        return np.concatenate([self.of_all(x).ravel(), self._prior(x)])

    def _prior(self, x: Array) -> Array:
        bristles, shared = self.parameters.bristles, self.parameters.shared
        return np.concatenate([x[bristles:shared] / INERTIA_DEVIATION, x[shared:] / _START_DEVIATION])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the residuals, shape (q, size of x)."""
        parts, parameters = [], self.parameters
        for index, motion in enumerate(self.motions):
            columns = [*range(parameters.shared), *parameters.start_columns(index)]
            by_bristles, by_starts = self.friction.slopes(x, index)
            slopes = [*by_bristles, *self._mass_slopes(motion), *by_starts]
            seen = band_spectrum(np.hstack(slopes), motion.step)[0].reshape(-1, len(columns), len(self.scale))
            part = np.zeros((seen.shape[0] * len(self.scale), x.size))
            part[:, columns] = -(seen / self.scale).transpose(0, 2, 1).reshape(-1, len(columns))
            parts.append(part)
        own = np.zeros((x.size - parameters.bristles, x.size))
        own[:, parameters.bristles :] = np.diag(self._prior(np.ones(x.size)))
        return np.vstack([*parts, own])

    def _mass_slopes(self, motion: MotionBlocks) -> list[Array]:
        """Return derivatives of the joints' torques by the errors of the mass matrix, each (b, k)."""
        unit = np.eye(self.parameters.size)[self.parameters.bristles : self.parameters.shared]
        shares = (self.parameters.inertia_errors(row) for row in unit)
        return [motion.acceleration @ (share * motion.mass_scale).T for share in shares]

    def clusters(self) -> tuple[Clusters, Clusters]:
        """Return the numbers of the spectral line of a motion, and of the motion, that each residual belongs to.

        The prior of a start deflection goes with its motion, that of the inertia with the first motion.
        """
        by_line, by_motion, first = [], [], 0
        for index, motion in enumerate(self.motions):
            frequency = band_spectrum(motion.drive[:, :1], motion.step)[1]
            line = np.round(frequency / _LINE_HZ).astype(np.int64)
            line -= line.min()
            by_line.append(np.repeat(first + line, len(self.scale)))
            by_motion.append(np.full(by_line[-1].size, index))
            first += int(line.max()) + 1
        parameters = self.parameters
        inertia = np.zeros(len(parameters.pairs), np.int64)
        starts = np.repeat(np.arange(len(self.motions)), parameters.elements)
        own = first + np.arange(parameters.size - parameters.bristles)
        return np.concatenate([*by_line, own]), np.concatenate([*by_motion, inertia, starts])

    def misfit(self, x: Array) -> Array:
        """Return the RMS of each joint's torque residuals beyond noise over that of its friction, shape (k,)."""
        left = self.of_all(x)
        friction = [band_spectrum(self.friction.torque(x, i), motion.step)[0] for i, motion in enumerate(self.motions)]
        beyond = np.sum(left**2, axis=0) - len(left) - _NOISE_POWER_SD * np.sqrt(2.0 * len(left))
        power = np.sum((np.vstack(friction) / self.scale) ** 2, axis=0)
        return np.asarray(np.sqrt(np.maximum(beyond, 0.0) / power))

    def with_measured_noise(self, x: Array) -> GroupResidual:
        """Return the residuals scaled by their own median absolute deviations."""
        spread = 1.4826 * np.median(np.abs(self.of_all(x)), axis=0)
        return replace(self, scale=self.scale * np.maximum(1e-9, spread))

    def with_predicted_speeds(self, x: Array, velocities: Sequence[Array], period: float) -> GroupResidual:
        """Return the residuals with the velocities at which a simulated plant evaluates its bristles.

        The plant predicts the middle of its tick with the friction of the tick before, which is off by half a tick
        squared times the rate of the friction over the mass: 1 % of the stiffness of a light joint.

        Args:
            x: parameters.
            velocities: of the joints in each motion, rad/s, shape (m, k).
            period: tick of the plant, s.
        """
        speeds, joints = [], list(self.parameters.joints)
        for index, (motion, velocity) in enumerate(zip(self.motions, velocities, strict=True)):
            rate = np.gradient(self.friction.torque(x, index), BLOCK * motion.step, axis=0)
            coarse = 0.5 * period**2 * np.linalg.solve(self.mass(x, index)[:, joints], rate.T).T
            place = (np.arange(len(velocity)) + 0.5) / BLOCK - 0.5
            ahead = np.column_stack([np.interp(place, np.arange(len(coarse)), column) for column in coarse.T])
            speeds.append((velocity + ahead) @ self.friction.inputs.T)
        return replace(self, friction=replace(self.friction, speeds=tuple(speeds)))
