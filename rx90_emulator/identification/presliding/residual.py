"""Residuals of a group's fit, scaled to unit noise, with their Jacobian: torques in the band, and prior knowledge.

Torques are compared at the frequencies of micro-oscillations alone. The noise of the encoder, which reaches the torque
through the controller, is there some thousandths of the motion. The noise of the torque is in the measured side of the
comparison only, so that it makes the estimates uncertain, not biased. A simulation driven by the recorded torque would
respond to its noise at the resonance as if it were motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.presliding.band import BLOCK, band_spectrum, block_means
from rx90_emulator.identification.presliding.group_model import GroupFriction, ParameterVector
from rx90_emulator.identification.presliding.micro_motion import MicroMotion

Clusters = NDArray[np.int64]

INERTIA_DEVIATION = 0.05
"""Prior standard deviation of the errors of the mass matrix in parts of sqrt(M_jj M_ii)."""
_START_DEVIATION = 0.3  # prior standard deviation of a start deflection, in parts of that of steady sliding
_LINE = 1.0  # Hz, over which errors may be correlated: the line of a tone, widened by its fade
_CHANCE = 3.0  # standard deviations of the noise's power that are no misfit


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
            line = np.round(frequency / _LINE).astype(np.int64)
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
        beyond = np.sum(left**2, axis=0) - len(left) - _CHANCE * np.sqrt(2.0 * len(left))
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
