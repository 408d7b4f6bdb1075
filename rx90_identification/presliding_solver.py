"""Fit c0 and c1 by simulating micro-oscillations from the recorded torque and comparing positions.

Recorded motion is not fed to the bristles: the encoder's noise reaches the torque through the controller, and what is
correlated with the torque like a velocity would be taken for damping. The simulated motion knows nothing of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rx90_common.compiled import kernel
from rx90_identification.micro_motion import MicroMotion
from rx90_sim.friction import LuGreElement
from rx90_sim.friction.bristle import bristle_step

Array = NDArray[np.float64]

_STRIDE = 0.002  # s, between two compared positions: micro-oscillations are slower
_BLOCK = 0.25  # s, over which errors of the simulation are correlated
_DIFFERENCE = 1e-4  # of a scaled parameter, for derivatives
_SPEED, _DEFLECTION, _TORQUE = 1e-3, 1e-4, 0.05  # scales of the start values, rad/s, rad, share of tau_c
_OUTLIER = 3.0  # deviations
_PRIOR = 0.05  # um for a scaled start value of 1: keeps apart what hardly differs in its effect
_INERTIA_PRIOR = 5.0  # um for a factor e on the inertia
_INERTIA_DEVIATION = 0.05  # of the description's inertia, relative
_FARTHEST = 1e-2  # rad; a simulation that runs farther is of no use
_ROUNDS = 50


@kernel
def simulate_group(
    elements: NDArray[Any],
    inputs: Array,
    inverse_mass: Array,
    drive: Array,
    step: float,
    z: Array,
    velocity: Array,
    position: Array,
) -> None:
    """Move a group of joints under recorded torques, as the plant does, with a constant mass matrix.

    Args:
        elements: e records of ELEMENT_DTYPE.
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        inverse_mass: 1/(kg m^2), shape (k, k).
        drive: torque held over each step, Nm, shape (m, k).
        step: s.
        z: bristle deflections at the start, rad, shape (e,); advanced in place.
        velocity: at the start, rad/s, shape (k,); advanced in place.
        position: row 0 holds the start and row i + 1 takes the position after step i, rad, shape (m + 1, k).
    """
    k = velocity.size
    acceleration, rest, middle = np.zeros(k), np.empty(k), np.empty(k)
    for row in range(drive.shape[0]):
        for i in range(k):
            middle[i] = velocity[i] + 0.5 * step * acceleration[i]
            rest[i] = drive[row, i]
        for e in range(z.size):
            speed = 0.0
            for i in range(k):
                speed += inputs[e, i] * middle[i]
            z[e], torque = bristle_step(elements[e], z[e], speed, step)
            for i in range(k):
                rest[i] -= inputs[e, i] * torque
        for i in range(k):
            total = 0.0
            for j in range(k):
                total += inverse_mass[i, j] * rest[j]
            acceleration[i] = total
        for i in range(k):
            position[row + 1, i] = position[row, i] + step * (velocity[i] + 0.5 * step * acceleration[i])
            velocity[i] += step * acceleration[i]


@dataclass(frozen=True, eq=False)
class GroupSolution:
    """What the fit of a group of joints found.

    Attributes:
        values: c0 Nm/rad and c1 Nm s/rad of the e elements, shape (e, 2).
        covariance: of ln c0 and ln c1, element by element, shape (2 e, 2 e).
        inertia: factor on the mass of each joint, shape (k,).
        simulated: position of each micro-motion by the simulation, rad, each shape (m, k).
        torque: friction torque at the joints by the simulation, Nm, each shape (m, k).
        residual: RMS of measured less simulated position, rad.
    """

    values: Array
    covariance: Array
    inertia: Array
    simulated: tuple[Array, ...]
    torque: tuple[Array, ...]
    residual: float


class _Problem:
    """Scaled parameters: ln c0 and ln c1 of each element, ln inertia of each joint, then for each motion its start.

    A motion's start is k velocities, e deflections and k torque offsets; what the position itself starts with goes
    with the mean of the difference.
    """

    def __init__(self, motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[LuGreElement]) -> None:
        self.motions = motions
        self.inputs = np.ascontiguousarray(inputs)
        self.sliding = sliding
        self.shared = 2 * len(sliding) + inputs.shape[1]
        self.own = 2 * inputs.shape[1] + len(sliding)
        self._offset = _TORQUE * (np.abs(inputs).T @ np.array([e.tau_c_positive for e in sliding]))
        self._kept = [self._rows(motion) for motion in motions]
        joints, count = inputs.shape[1], self.shared + self.own * len(motions)
        self._prior = np.concatenate(
            [np.zeros(2 * len(sliding)), np.full(joints, _INERTIA_PRIOR), np.full(count - self.shared, _PRIOR)]
        )
        own = 20_000_000 + np.arange(count - 2 * len(sliding))
        self.blocks = np.concatenate([*(self._blocks(i) for i in range(len(motions))), own])

    def trust_inertia(self, noise: float) -> None:
        """Hold the inertia to what the arm's description says, as far as that is known, once the noise is known, um."""
        alike = _BLOCK / _STRIDE  # errors of a simulation from a noisy torque differ little within a block
        self._prior[2 * len(self.sliding) : self.shared] = noise * np.sqrt(alike) / _INERTIA_DEVIATION

    def _rows(self, motion: MicroMotion) -> NDArray[np.int64]:
        rows = np.arange(0, len(motion.position), max(1, round(_STRIDE / motion.step)))
        return rows[motion.known[rows]]

    def _blocks(self, index: int) -> NDArray[np.int64]:
        """Return the number of the block that each residual belongs to, position by position of all joints."""
        motion = self.motions[index]
        block = (self._kept[index] * motion.step / _BLOCK).astype(np.int64) + 10_000 * index
        return np.repeat(block, motion.position.shape[1])

    def elements(self, x: Array) -> list[LuGreElement]:
        values = np.exp(np.clip(x[: 2 * len(self.sliding)], -20.0, 25.0)).reshape(-1, 2)
        return [replace(e, c0=float(c0), c1=float(c1)) for e, (c0, c1) in zip(self.sliding, values, strict=True)]

    def simulate(self, x: Array, index: int) -> Array:
        motion, k, e = self.motions[index], self.inputs.shape[1], len(self.sliding)
        start = x[self.shared + index * self.own : self.shared + (index + 1) * self.own]
        records = np.array([element.record() for element in self.elements(x)])
        scale = np.exp(0.5 * np.clip(x[2 * e : self.shared], -1.0, 1.0))
        position = np.empty((len(motion.drive) + 1, k))
        position[0] = motion.start[0]
        simulate_group(
            records,
            self.inputs,
            np.linalg.inv(motion.mass * np.outer(scale, scale)),
            motion.drive - start[k + e :] * self._offset,
            motion.step,
            start[k : k + e] * _DEFLECTION,
            motion.start[1] + start[:k] * _SPEED,
            position,
        )
        return position[1:]

    def motion_residual(self, x: Array, index: int) -> Array:
        difference = self.motions[index].position - self.simulate(x, index)
        kept = np.nan_to_num(difference[self._kept[index]], nan=_FARTHEST)
        kept = np.clip(kept - np.clip(kept.mean(axis=0), -_FARTHEST, _FARTHEST), -_FARTHEST, _FARTHEST)
        return np.asarray(1e6 * kept.ravel())

    def residual(self, x: Array) -> Array:
        parts = [self.motion_residual(x, i) for i in range(len(self.motions))]
        return np.concatenate([*parts, (self._prior * x)[2 * len(self.sliding) :]])

    def jacobian(self, x: Array) -> Array:
        """Return forward differences; a motion's own start concerns it alone, which saves most of the work."""
        parts = []
        for index in range(len(self.motions)):
            first = self.shared + index * self.own
            here = self.motion_residual(x, index)
            part = np.zeros((here.size, x.size))
            for column in [*range(self.shared), *range(first, first + self.own)]:
                moved = x.copy()
                moved[column] += _DIFFERENCE
                part[:, column] = (self.motion_residual(moved, index) - here) / _DIFFERENCE
            parts.append(part)
        return np.vstack([*parts, np.diag(self._prior)[2 * len(self.sliding) :]])


def solve_group(motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[LuGreElement]) -> GroupSolution:
    """Fit the elements of a group of joints to all its micro-motions.

    Args:
        motions: of the group, one or more.
        inputs: joint velocities to input velocities of the group's elements, shape (e, k).
        sliding: the elements with their sliding regime; c0 and c1 are not looked at.
    """
    problem = _Problem(motions, inputs, sliding)
    guess = first_guess(motions, inputs, sliding)
    shared = np.concatenate([np.log(guess).ravel(), np.zeros(inputs.shape[1])])
    start = np.concatenate([shared, np.zeros(problem.own * len(motions))])
    x = _levenberg_marquardt(problem, start, np.ones(problem.blocks.size))
    # Outliers, such as a missing message or a bump of the table, are held down once the size of the noise is known.
    ratio = np.abs(problem.residual(x)) / (_OUTLIER * _spread(problem.residual(x)))
    problem.trust_inertia(_spread(problem.residual(x)))
    x = _levenberg_marquardt(problem, x, 1.0 / np.sqrt(np.maximum(1.0, ratio)))
    count = 2 * len(sliding)
    covariance = _sandwich(problem.jacobian(x), problem.residual(x), problem.blocks)[:count, :count]
    simulated = tuple(problem.simulate(x, i) for i in range(len(motions)))
    return GroupSolution(
        np.exp(x[:count]).reshape(-1, 2),
        covariance,
        np.exp(x[count : problem.shared]),
        simulated,
        tuple(
            _friction(m, s, np.exp(0.5 * x[count : problem.shared])) for m, s in zip(motions, simulated, strict=True)
        ),
        1e-6 * float(np.sqrt(np.mean(problem.residual(x) ** 2))),
    )


def _levenberg_marquardt(problem: _Problem, start: Array, weight: Array) -> Array:
    def residual(x: Array) -> Array:
        return weight * problem.residual(x)

    def jacobian(x: Array) -> Array:
        return weight[:, None] * problem.jacobian(x)

    result = least_squares(
        residual, start, jacobian, method="lm", x_scale="jac", max_nfev=_ROUNDS, xtol=1e-5, ftol=1e-6
    )
    return np.asarray(result.x)


def _spread(values: Array) -> float:
    return max(1e-3, 1.4826 * float(np.median(np.abs(values))))


def first_guess(motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[LuGreElement]) -> Array:
    """Return c0 and c1 by linear regression of the torque on deflection and velocity, shape (e, 2).

    The bristles soften with their deflection, so that this c0 is low; it is where the fit begins.
    """
    elements, k = inputs.shape
    matrix, torque = [], []
    for motion in motions:
        rows = slice(None, None, max(1, round(_STRIDE / motion.step)))
        q, v, a = (part[rows] for part in motion.smooth)
        deflection, speed = (q - q.mean(axis=0)) @ inputs.T, v @ inputs.T
        rest = motion.drive[rows] - a @ motion.mass.T
        for i in range(k):
            columns = np.hstack([deflection, speed]) * np.tile(inputs[:, i], 2)
            matrix.append(columns - columns.mean(axis=0))
            torque.append(rest[:, i] - rest[:, i].mean())
    solution = np.linalg.lstsq(np.vstack(matrix), np.concatenate(torque), rcond=1e-6)[0]
    viscous = np.array([e.c2 for e in sliding])
    weakest = np.array([e.tau_c_positive for e in sliding]) / 2e-3
    c0 = np.maximum(1.2 * solution[:elements], weakest)
    return np.column_stack([c0, np.maximum(solution[elements:] - viscous, 2e-4 * c0)])


def _sandwich(jacobian: Array, residual: Array, blocks: NDArray[np.int64]) -> Array:
    """Return the covariance of a fit whose residuals are correlated within blocks, but not between them."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    scaled = jacobian / scale
    bread = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12)
    _, number = np.unique(blocks, return_inverse=True)
    scores = np.zeros((number.max() + 1, scaled.shape[1]))
    np.add.at(scores, number, scaled * residual[:, None])
    count = len(scores)
    wide = count / max(1, count - 1) * len(residual) / max(1, len(residual) - scaled.shape[1])
    return np.asarray(wide * (bread @ (scores.T @ scores) @ bread) / np.outer(scale, scale))


def _friction(motion: MicroMotion, simulated: Array, scale: Array) -> Array:
    """Return what is left of the drive torque once the simulated motion is accelerated, Nm, shape (m, k)."""
    velocity = np.gradient(simulated, motion.step, axis=0)
    acceleration = np.gradient(velocity, motion.step, axis=0)
    return np.asarray(motion.drive - acceleration @ (motion.mass * np.outer(scale, scale)).T)
