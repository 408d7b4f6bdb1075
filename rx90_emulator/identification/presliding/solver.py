"""Fit c0 and c1 by bending simulated bristles along measured micro-oscillations and comparing torques.

Torques are compared at the frequencies of micro-oscillations alone. There the noise of the encoder, which reaches the
torque through the controller, is some thousandths of the motion, and the noise of the torque adds to what is compared
but not to what it is compared with: it makes the estimates uncertain, not wrong. A simulation from the recorded torque
would carry its noise to the resonance and take it for motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import prev_fast_len, rfft, rfftfreq
from scipy.optimize import least_squares
from scipy.signal.windows import tukey

from rx90_common.friction import LuGreElement
from rx90_emulator.identification.model.estimates import SLIDING
from rx90_emulator.identification.presliding.bristle_path import THIN, slide, thinned
from rx90_emulator.identification.presliding.micro_motion import MicroMotion

Array = NDArray[np.float64]

INERTIA_DEVIATION = 0.05
"""Of errors of the mass matrix in parts of sqrt(M_jj M_ii), as they are assumed."""
_LOWEST, _HIGHEST = 2.0, 50.0  # Hz: slower is creep and weight, faster is noise
_TAPER = 0.2  # share of a motion that is faded in and out, against leakage
_LINE = 1.0  # Hz, over which errors may be correlated: an oscillation's line with its fade
_DIFFERENCE = 1e-4  # relative, for derivatives
_START_DEVIATION = 0.3  # of the largest deflection: what a bristle starts with
_ROUNDS = 30
_FEW = 3  # motions, below which leaving out one says nothing
_LEAST_REST = 1e-3  # of a direction that a cluster leaves to the others: a motion's own start is its own
_TELLING = 0.1  # of what is assumed of the inertia: smaller corrections of it are rounding
_FLOOR = (0.002, 0.01)  # of c0 and c1: steps of the encoders, and 10 us of timing, are in no noise
_CHANCE = 3.0  # deviations of the noise's power that are left to chance
_PASSES = 3  # of the fit, with the noise told from the one before


@dataclass(frozen=True, eq=False)
class GroupSolution:
    """What the fit of a group of joints found.

    Attributes:
        values: c0 Nm/rad and c1 Nm s/rad of the e elements, shape (e, 2).
        covariance: of ln c0 and ln c1, element by element, shape (2 e, 2 e).
        inertia: errors of the group's rows of the mass matrix, in parts of sqrt(M_jj M_ii), shape (k, n).
        strain: the same in the deviations that they would have if they were as small as is assumed, shape (k, n).
        torque: friction torque at the joints by the bristles, thinned, Nm, of each micro-motion, shape (m, k).
        loads: amplitude of each bristle's torque over its Coulomb torque, of each micro-motion, shape (motions, e).
        misfit: RMS of what is left of each joint's torque beyond noise, over that of its friction torque, shape (k,).
    """

    values: Array
    covariance: Array
    inertia: Array
    strain: Array
    torque: tuple[Array, ...]
    loads: Array
    misfit: Array


class _Problem:
    """Scaled parameters: ln c0 and ln c1 of each element, errors of the mass matrix, start deflections by motion.

    All micro-oscillations are made at one pose, where whatever the description of the links lacks is a constant error
    of the mass matrix, beside its diagonal as well.
    """

    def __init__(
        self,
        motions: Sequence[MicroMotion],
        inputs: Array,
        sliding: Sequence[LuGreElement],
        plant_period: float | None,
    ) -> None:
        self.motions = motions
        self.plant_period = plant_period
        self.inputs = inputs
        self.joints, self.own = inputs.shape[1], len(sliding)
        self.count = 2 * len(sliding)
        self.drive = [thinned(motion.drive) for motion in motions]
        self.acceleration = [thinned(motion.acceleration) for motion in motions]
        # Of each symmetric pair of the group one. The other joints nearly rest: by less than their encoders tell.
        group = motions[0].joints
        self.masses = [(j, group[i]) for j in range(self.joints) for i in range(j, self.joints)]
        self.shared = self.count + len(self.masses)
        self.size = self.shared + self.own * len(motions)
        self.scale = 0.1 * np.abs(inputs).T @ np.array([e.tau_c_positive for e in sliding])
        self.use(sliding, [motion.velocity @ inputs.T for motion in motions])

    def use(self, sliding: Sequence[LuGreElement], speeds: Sequence[Array]) -> None:
        """Take a sliding regime, and input velocities for each motion, shape (m, e)."""
        self._bent: dict[tuple[int, int], tuple[tuple[float, float], tuple[Array, Array]]] = {}
        self.sliding = list(sliding)
        self.paths = [
            [slide(element, speed[:, n], motion.step) for n, element in enumerate(sliding)]
            for motion, speed in zip(self.motions, speeds, strict=True)
        ]

    def values(self, x: Array) -> Array:
        return np.exp(np.clip(x[: self.count], -20.0, 25.0)).reshape(-1, 2)

    def start(self, x: Array, index: int) -> Array:
        first = self.shared + index * self.own
        return np.asarray(x[first : first + self.own])

    def bent(self, x: Array, index: int, n: int) -> tuple[Array, Array]:
        """Return what `BristlePath.bent` does of element n along a motion; the last ones are kept."""
        c0, start = float(self.values(x)[n, 0]), float(self.start(x, index)[n])
        key, known = (c0, start), self._bent.get((index, n))
        if known is None or known[0] != key:
            known = self._bent[index, n] = key, self.paths[index][n].bent(c0, start)
        return known[1]

    def friction(self, x: Array, index: int) -> Array:
        """Return the friction torque at the joints along a motion, thinned, Nm, shape (m, k)."""
        values, total = self.values(x), []
        for n, path in enumerate(self.paths[index]):
            torque, rate = self.bent(x, index, n)
            total.append(torque + values[n, 1] * rate + path.viscous)
        return np.column_stack(total) @ self.inputs

    def inertia(self, x: Array) -> Array:
        """Return the errors of the mass matrix in parts of sqrt(M_jj M_ii), shape (k, n)."""
        group = self.motions[0].joints
        errors = np.zeros_like(self.motions[0].mass)
        for value, (j, i) in zip(x[self.count : self.shared], self.masses, strict=True):
            errors[j, i] = value
            errors[group.index(i), group[j]] = value
        return errors

    def mass(self, x: Array, index: int) -> Array:
        """Return the group's rows of the mass matrix, kg m^2, shape (k, n)."""
        motion = self.motions[index]
        return np.asarray(motion.mass + self.inertia(x) * self.mass_scale(index))

    def mass_scale(self, index: int) -> Array:
        inertia = self.motions[index].inertia
        return np.asarray(np.sqrt(np.outer(inertia[list(self.motions[index].joints)], inertia)))

    def predict(self, x: Array) -> None:
        """Give the bristles the velocity at which a simulated plant evaluates them; a real one has no ticks.

        The plant predicts the middle of its tick with the friction of the tick before, which is off by half a tick
        squared times the rate of the friction over the mass: 1 % of the stiffness of a light joint.
        """
        if self.plant_period is None:
            return
        period, speeds = self.plant_period, []
        for index, motion in enumerate(self.motions):
            rate = np.gradient(self.friction(x, index), THIN * motion.step, axis=0)
            coarse = 0.5 * period**2 * np.linalg.solve(self.mass(x, index)[:, motion.joints], rate.T).T
            place = (np.arange(len(motion.velocity)) + 0.5) / THIN - 0.5
            ahead = np.column_stack([np.interp(place, np.arange(len(coarse)), column) for column in coarse.T])
            speeds.append((motion.velocity + ahead) @ self.inputs.T)
        self.use(self.sliding, speeds)

    def motion_residual(self, x: Array, index: int) -> Array:
        """Return what is left of the torque at each frequency, in deviations, shape (r, k)."""
        motion = self.motions[index]
        inertial = self.acceleration[index] @ self.mass(x, index).T
        return np.asarray(lines(self.drive[index] - inertial - self.friction(x, index), motion.step)[0] / self.scale)

    def loads(self, x: Array) -> Array:
        """Return the amplitude of each bristle's torque over its Coulomb torque, shape (motions, e)."""
        found = np.empty((len(self.motions), self.own))
        for index, paths in enumerate(self.paths):
            for n, path in enumerate(paths):
                low, high = np.percentile(self.bent(x, index, n)[0], (1.0, 99.0))
                found[index, n] = 0.5 * (high - low) / path.coulomb
        return found

    def misfit(self, x: Array) -> Array:
        """Return the RMS of what is left of each joint's torque beyond noise over that of friction, shape (k,)."""
        left = np.vstack([self.motion_residual(x, index) for index in range(len(self.motions))])
        friction = [lines(self.friction(x, index), motion.step)[0] for index, motion in enumerate(self.motions)]
        beyond = np.sum(left**2, axis=0) - len(left) - _CHANCE * np.sqrt(2.0 * len(left))
        power = np.sum((np.vstack(friction) / self.scale) ** 2, axis=0)
        return np.asarray(np.sqrt(np.maximum(beyond, 0.0) / power))

    def prior(self, x: Array) -> Array:
        return np.concatenate([x[self.count : self.shared] / INERTIA_DEVIATION, x[self.shared :] / _START_DEVIATION])

    def residual(self, x: Array) -> Array:
        parts = [self.motion_residual(x, index).ravel() for index in range(len(self.motions))]
        return np.concatenate([*parts, self.prior(x)])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives; an element's parameters concern its torque alone, a start its motion alone."""
        parts = []
        for index, motion in enumerate(self.motions):
            first = self.shared + index * self.own
            torques = self._element_slopes(x, index)
            columns = [*range(self.shared), *range(first, first + self.own)]
            slopes = [*torques[: self.count], *self._mass_slopes(index), *torques[self.count :]]
            seen = lines(np.hstack(slopes), motion.step)[0].reshape(-1, len(columns), self.joints)
            part = np.zeros((seen.shape[0] * self.joints, x.size))
            part[:, columns] = -(seen / self.scale).transpose(0, 2, 1).reshape(-1, len(columns))
            parts.append(part)
        own = np.zeros((self.size - self.count, x.size))
        own[:, self.count :] = np.diag(self.prior(np.ones(x.size)))
        return np.vstack([*parts, own])

    def _element_slopes(self, x: Array, index: int) -> list[Array]:
        """Return derivatives of the joints' torques by ln c0 and ln c1 in turn, then by the starts, each (m, k)."""
        shared, own = [], []
        values, starts = self.values(x), self.start(x, index)
        for n, (path, (c0, c1), start) in enumerate(zip(self.paths[index], values, starts, strict=True)):
            torque, rate = self.bent(x, index, n)
            here, row = torque + c1 * rate, self.inputs[n]
            stiffer, moved = path.bent(c0 * (1.0 + _DIFFERENCE), start), path.bent(c0, start + _DIFFERENCE)
            by_c0, by_start = ((one[0] + c1 * one[1] - here) / _DIFFERENCE for one in (stiffer, moved))
            shared += [np.outer(by_c0, row), np.outer(c1 * rate, row)]
            own.append(np.outer(by_start, row))
        return shared + own

    def _mass_slopes(self, index: int) -> list[Array]:
        """Return derivatives of the joints' torques by the errors of the mass matrix, each (m, k)."""
        scale, acceleration, slopes = self.mass_scale(index), self.acceleration[index], []
        for row in np.eye(len(self.masses)):
            share = self.inertia(np.concatenate([np.zeros(self.count), row]))
            slopes.append(acceleration @ (share * scale).T)
        return slopes

    def groupings(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the numbers of the line of a motion, and of the motion, that each residual belongs to.

        What is assumed of a motion's start goes with the motion, what is assumed of the inertia with the first.
        """
        by_line, by_motion, first = [], [], 0
        for index, motion in enumerate(self.motions):
            frequency = lines(self.drive[index][:, :1], motion.step)[1]
            line = np.round(frequency / _LINE).astype(np.int64)
            line -= line.min()
            by_line.append(np.repeat(first + line, self.joints))
            by_motion.append(np.full(by_line[-1].size, index))
            first += int(line.max()) + 1
        assumed = np.concatenate(
            [np.zeros(len(self.masses), np.int64), np.repeat(np.arange(len(self.motions)), self.own)]
        )
        own = first + np.arange(self.size - self.count)
        return np.concatenate([*by_line, own]), np.concatenate([*by_motion, assumed])


def lines(torque: Array, step: float) -> tuple[Array, Array]:
    """Return sine and cosine parts of thinned torques in the band of micro-oscillations, and their frequencies, Hz.

    Of shape (r, columns), scaled so that the noise of a single step keeps its deviation.
    """
    length = prev_fast_len(len(torque), real=True)
    window = tukey(length, _TAPER)
    frequency = rfftfreq(length, THIN * step)
    band = (frequency >= _LOWEST) & (frequency <= _HIGHEST)
    parts = rfft((torque - torque.mean(axis=0))[:length] * window[:, None], axis=0)[band]
    parts = parts * np.sqrt(2.0 * THIN / (window @ window))
    return np.concatenate([parts.real, parts.imag]), np.tile(frequency[band], 2)


def solve_group(
    motions: Sequence[MicroMotion],
    inputs: Array,
    sliding: Sequence[LuGreElement],
    sliding_covariance: Array | None = None,
    plant_period: float | None = None,
) -> GroupSolution:
    """Fit the elements of a group of joints to all its micro-motions.

    Args:
        motions: of the group, one or more.
        inputs: joint velocities to input velocities of the group's elements, shape (e, k).
        sliding: the elements with their sliding regime; c0 and c1 are not looked at.
        sliding_covariance: of that regime, element by element in the order of SLIDING, shape (7 e, 7 e); none if it
            is known.
        plant_period: as in `identify_presliding`.
    """
    problem = _Problem(motions, inputs, sliding, plant_period)
    guess = first_guess(motions, inputs, sliding)
    x = np.concatenate([np.log(guess).ravel(), np.zeros(problem.size - problem.count)])
    for _ in range(_PASSES):
        x = _fit(problem, x, 1e-3)
        parts = np.vstack([problem.motion_residual(x, index) for index in range(len(motions))])
        problem.scale = problem.scale * np.maximum(1e-9, 1.4826 * np.median(np.abs(parts), axis=0))
        problem.predict(x)
    x = _fit(problem, x, 1e-6)
    residual, jacobian = problem.residual(x), problem.jacobian(x)
    loads, misfit = problem.loads(x), problem.misfit(x)
    covariance = _covariance(jacobian, residual, problem.groupings()[: 1 if len(motions) < _FEW else 2])
    torque = tuple(problem.friction(x, index) for index in range(len(motions)))
    if sliding_covariance is not None:
        slopes = np.linalg.lstsq(jacobian, -_by_sliding(problem, x, residual), rcond=None)[0]
        covariance = covariance + slopes @ sliding_covariance @ slopes.T
    covariance = covariance + np.diag(np.append(np.tile(_FLOOR, problem.own), np.zeros(x.size - problem.count))) ** 2
    count = problem.count
    inertia, strain = problem.inertia(x), problem.inertia(_strain(problem, x, jacobian, covariance))
    return GroupSolution(problem.values(x), covariance[:count, :count], inertia, strain, torque, loads, misfit)


def _strain(problem: _Problem, x: Array, jacobian: Array, covariance: Array) -> Array:
    """Return x with the errors of the mass matrix in deviations of what data with noise make of assumed ones.

    What is assumed draws them to zero; where the data tell little, small ones already speak against it. What the
    covariance has beyond noise may be errors of the model instead.
    """
    own = slice(problem.count, problem.shared)
    left = np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True))[own]
    beyond = np.maximum(np.diag(covariance)[own] - left, 0.0)
    told = np.sqrt(np.maximum(INERTIA_DEVIATION**2 - left, (_TELLING * INERTIA_DEVIATION) ** 2) + beyond)
    strain = np.zeros_like(x)
    strain[own] = x[own] / told
    return strain


def _by_sliding(problem: _Problem, x: Array, here: Array) -> Array:
    """Return the derivatives of the residuals by the sliding parameters, element by element in the order of SLIDING.

    A bristle's start, in parts of its largest deflection, is left where it is.
    """
    sliding, paths, columns = problem.sliding, problem.paths, []
    speeds = [np.column_stack([path.speed for path in own]) for own in paths]
    for n, element in enumerate(sliding):
        for name in SLIDING:
            # The Coulomb torque goes down, which keeps it below the static one.
            step = getattr(element, name) * (-_DIFFERENCE if name.startswith("tau_c") else _DIFFERENCE)
            moved = replace(element, **{name: getattr(element, name) + step})
            problem.use([*sliding[:n], moved, *sliding[n + 1 :]], speeds)
            columns.append((problem.residual(x) - here) / step if step else np.zeros_like(here))
    problem.use(sliding, speeds)
    return np.column_stack(columns)


def _fit(problem: _Problem, start: Array, tolerance: float) -> Array:
    result = least_squares(
        problem.residual,
        start,
        problem.jacobian,
        method="lm",
        max_nfev=_ROUNDS,
        xtol=tolerance,
        ftol=tolerance**1.5,
    )
    return np.asarray(result.x)


def first_guess(motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[LuGreElement]) -> Array:
    """Return c0 and c1 by linear regression of the torque on deflection and velocity, shape (e, 2).

    The bristles soften with their deflection, so that this c0 is low; it is where the fit begins.
    """
    elements, k = inputs.shape
    matrix, torque = [], []
    for motion in motions:
        deflection = np.cumsum(motion.velocity, axis=0) * motion.step @ inputs.T
        speed = motion.velocity @ inputs.T
        rest = lines(thinned(motion.drive - motion.acceleration @ motion.mass.T), motion.step)[0]
        columns = lines(thinned(np.hstack([deflection, speed])), motion.step)[0]
        for i in range(k):
            matrix.append(columns * np.tile(inputs[:, i], 2))
            torque.append(rest[:, i])
    solution = np.linalg.lstsq(np.vstack(matrix), np.concatenate(torque), rcond=1e-6)[0]
    viscous = np.array([e.c2 for e in sliding])
    weakest = np.array([e.tau_c_positive for e in sliding]) / 2e-3
    c0 = np.maximum(1.2 * solution[:elements], weakest)
    return np.column_stack([c0, np.maximum(solution[elements:] - viscous, 2e-4 * c0)])


def _covariance(jacobian: Array, residual: Array, groupings: Sequence[NDArray[np.int64]]) -> Array:
    """Return the covariance by the noise, widened where groups of residuals show more than noise would.

    The noise is white in the band, and it is what lies between the lines of the motions. Errors of the model lie on
    the lines and grow with the amplitude: sandwich estimates with lines and with motions as clusters tell them. Both
    are those of Bell and McCaffrey (CR2), which few clusters of unequal weight do not bias where there is only noise.
    """
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    inverse_root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])) @ vectors.T
    noise = inverse_root @ inverse_root
    wide = np.ones(len(noise))
    for numbers in groupings:
        variance = np.zeros(len(noise))
        for number in range(int(numbers.max()) + 1):
            rows = numbers == number
            own = jacobian[rows] @ inverse_root
            leverage, turn = np.linalg.eigh(own.T @ own)
            adjusted = turn / np.sqrt(np.maximum(1.0 - leverage, _LEAST_REST)) @ turn.T
            variance += (inverse_root @ (adjusted @ (own.T @ residual[rows]))) ** 2
        wide = np.maximum(wide, np.sqrt(variance / np.diag(noise)))
    return np.asarray(noise * np.outer(wide, wide))
