"""Whether signs and encoder zeros are right, by the simplest model: rigid body, Coulomb and viscous friction.

With a wrong zero the model bends the arm at a wrong angle, which no inertia can compensate; `zeros.find_zeros` decides.
A zero whose error base parameters can compensate (that of a vertical first axis, or of the last joint) changes no
torque and is never reported. A torque constant of the wrong sign reverses its motor's torque: the drive seems to be
driven by friction. A gear of the wrong sign reverses torque and motion: power and friction are right, and the joint
bends the other way. Both errors, and a reversed motion alone, are tried one motor after the other, with friction
bounded to 0 or more. Some signs of gears cannot be determined: an arm whose joints all turn about vertical and parallel
axes moves as its mirror image does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.fit import nonnegative, solve, time_blocks
from rx90_emulator.identification.excitation.law import COULOMB, VISCOUS, ElementShape, joint_columns
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.options import SHIPPED_ROBOT, RobotOptions
from rx90_emulator.identification.zeros import ROUNDS, SMALLEST, ResidualPower, ZeroCheck, find_zeros, is_error


def coulomb_viscous(problem: ExcitationProblem) -> Array:
    """Return two columns for each element: sign(v) and v, the torques per tau_c and c2; shape (r, 2 n_el).

    The sign is of the filtered velocity at the full rate, where the torque was recorded, and is filtered with it.
    """
    columns = joint_columns(problem, [ElementShape()] * len(problem.arm.element_names))
    return np.asarray(columns[:, :, [COULOMB, VISCOUS]].reshape(len(problem), -1))


class WrongSign(NamedTuple):
    """A motor whose recorded values have the wrong sign.

    Attributes:
        motor: its number, from 0 at the base.
        motion: whether its position and velocity are reversed.
        torque: whether its torque is reversed.
        interchangeable: numbers of other motors whose reversal explains the runs equally well, as mirror images do.
    """

    motor: int
    motion: bool
    torque: bool
    interchangeable: tuple[int, ...] = ()

    @property
    def what(self) -> str:
        """Return what has the wrong sign."""
        return "gear" if self.motion and self.torque else "position" if self.motion else "effort"


_SIGN_ERRORS = ((False, True), (True, True), (True, False))
"""Motion and torque: wrong sign of the torque constant, of the gear, of the position alone."""
_MIN_SIGN_GAIN = 0.15  # share of the torque error, at least, that a right sign explains
ROWS_PER_PARAMETER = 2.0
"""Of the simplest model, at least: fewer predict nothing, and fit any sign."""
_SHORT_ROWS_PER_PARAMETER = 8.0  # with 2 to 6 7 % of right signs looked wrong, with more none
_SHORT_ERROR, _SHORT_REMAINDER = 0.1, 1.0 / 3.0  # of short runs: share of the torque unexplained; of it after a change
_CLEAR_SE = 3.0  # standard errors by which a sign, or a zero, must explain more


def check_signs(problem: ExcitationProblem, options: RobotOptions = SHIPPED_ROBOT) -> None:
    """Refuse runs in which torques or motions of motors clearly have the wrong sign; not by very short ones.

    Args:
        problem: equations with the signs as given.
        options: with the given gears and torque constants.

    Raises:
        IdentificationError: naming the joints, the unexplained torque with either sign, and the options to use instead.
    """
    search = _Search(problem)
    rows = len(problem) / problem.parameters
    if rows < ROWS_PER_PARAMETER:
        return
    wrong, before, after = search.wrong_signs()
    short = rows < _SHORT_ROWS_PER_PARAMETER
    if not wrong or after >= before or (short and (before < _SHORT_ERROR or after > _SHORT_REMAINDER * before)):
        return
    names, descriptions, choices = problem.arm.names, [], [wrong]
    for k, one in enumerate(wrong):
        descriptions.append(f"{one.what} of {names[one.motor]}")
        if one.interchangeable:
            motors = ", ".join(names[motor] for motor in sorted((one.motor, *one.interchangeable)))
            descriptions[-1] = f"{one.what} of one of {motors} (either fits as well, as mirror images do)"
        choices += [(*wrong[:k], one._replace(motor=motor), *wrong[k + 1 :]) for motor in one.interchangeable]
    better = " or ".join(filter(None, (_right_signs(one, options, len(names)) for one in choices)))
    raise IdentificationError(
        f"wrong sign of the {' and the '.join(descriptions)}: {before:.1%} of the torque there are unexplained, with "
        f"the other sign {after:.1%}; accepted: {better}, there or in the signal map"
    )


def _right_signs(wrong: Sequence[WrongSign], options: RobotOptions, count: int) -> str:
    """Return the options that reverse the signs of some of `count` motors."""
    gear, constant = (list(given or [1.0] * count) for given in (options.gear, options.torque_constant))
    for motor, motion, torque, _ in wrong:
        gear[motor] *= -1.0 if motion else 1.0
        constant[motor] *= -1.0 if motion != torque else 1.0
    changed = (
        ("gear", gear, any(one.motion for one in wrong)),
        ("torque-constant", constant, any(one.motion != one.torque for one in wrong)),
    )
    return " ".join(
        f"--{name} {' '.join(f'{value:g}' for value in values)}" for name, values, there in changed if there
    )


_SCREENING_ROWS = 2500  # largest number of rows that quarter turns are compared on, evenly spread over all
_STEP = 1e-4  # rad, of differences by an angle
_MIN_TORQUE_GAIN = 0.02  # minimal share of the torque error that a change must explain
_MIN_INDEPENDENT_SHARE = 1e-4  # minimal share of a derivative's squares outside the other columns, to determine a zero


def check_zeros(problem: ExcitationProblem, zero: Array | None = None) -> ZeroCheck:
    """Look for zeros that explain the torques of runs clearly better.

    Args:
        problem: equations with the zeros as given.
        zero: the given zeros: recorded angles in the zero pose of the URDF, rad, shape (n,); by default 0.
    """
    fits = _Search(problem)
    return find_zeros(fits, problem.arm.names, zero, fits.independent)


@dataclass(frozen=True, eq=False)
class _Signed:
    """Equations of s rows with friction bounded to 0 or more: joints, regressor, columns of friction, torque, Nm."""

    joint: Index
    regressor: Array
    friction: Array
    torque: Array

    def residual(self, sigma: Array) -> Array:
        """Return the residual of the fit with these standard deviations of the rows, Nm, shape (s,)."""
        weight = 1.0 / sigma
        friction, target = self.friction * weight[:, None], self.torque * weight
        columns = self.regressor * weight[:, None]
        basis = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))[0]
        friction, target = (values - basis @ (basis.T @ values) for values in (friction, target))
        return np.asarray((target - friction @ nonnegative(friction.T @ friction, friction.T @ target)) * sigma)

    @cached_property
    def sigma(self) -> Array:
        """Return the standard deviation of each row, that of its joint's residuals, Nm, shape (s,)."""
        return self._by_joint(self.residual(self._by_joint(self.torque)))

    def _by_joint(self, values: Array) -> Array:
        count = np.maximum(np.bincount(self.joint), 1)
        floor = max(1e-9 * float(np.abs(self.torque).max()), 1e-12)
        return np.asarray(np.maximum(np.sqrt(np.bincount(self.joint, values**2) / count), floor)[self.joint])


class _Search:
    """Fits with shifted angles; to save time, the parallel filter is applied to the motion, not to each column."""

    def __init__(self, problem: ExcitationProblem) -> None:
        self._problem, self._friction = problem, coulomb_viscous(problem)
        self._position, self._velocity, self._acceleration, self._torque = (
            np.concatenate([run.parallel(getattr(run, name)) for run in problem.runs])
            for name in ("position", "velocity", "acceleration", "torque")
        )
        self._block, self._all = time_blocks(problem), np.arange(len(problem))
        fit = solve(problem, np.hstack([problem.regressor, self._friction]))
        self._weight = (1.0 / fit.sigma[problem.joint])[:, None]
        # Whole instants are selected, so that no more regressors are computed than rows are compared.
        self._some = self._screened(np.arange(len(problem)))

    def _screened(self, rows: Index) -> Index:
        return np.asarray(rows[self._problem.sample[rows] % max(1, math.ceil(len(rows) / _SCREENING_ROWS)) == 0])

    @cached_property
    def independent(self) -> Mask:
        """Return the joints whose zero the torques determine: no base parameter compensates its error, shape (n,)."""
        arm = self._problem.arm
        columns, slopes = (values * self._weight for values in self._derivatives(np.zeros(len(arm.names))))
        independent = slopes - _projected(columns, slopes)
        size = np.sum(slopes**2, axis=0)
        return np.asarray(
            arm.identified & (np.sum(independent**2, axis=0) > _MIN_INDEPENDENT_SHARE * np.maximum(size, 1e-300))
        )

    def identifiable(self, _deviation: Array) -> Mask:
        """Return `independent`, which does not depend on the deviation."""
        return self.independent

    @property
    def torque(self) -> Array:
        """Return the mean square of the torque of each joint, Nm^2, shape (n,)."""
        return self._mean_square(self._problem.torque)

    def residual_power(self, shift: Array) -> ResidualPower:
        """Return the mean square residual of rigid body, Coulomb and viscous friction with shifted angles."""
        return {"": self._mean_square(solve(self._problem, self._columns(shift, self._all)).residual)}

    def _mean_square(self, values: Array) -> Array:
        squares = np.bincount(self._problem.joint, values**2, len(self._problem.arm.names))
        return np.asarray(squares / len(self._problem))

    def best(self, trials: list[Array], _start: Array) -> Array:
        """Return the trial with the smallest residual."""
        return min(trials, key=lambda shift: float(self._squares(shift).sum()))

    def clearly_better(self, shift: Array, than: Array) -> bool:
        """Return whether one shift explains clearly more than another: block by block, and by a relevant share."""
        return self._explains(self._squares(than), self._squares(shift), _CLEAR_SE, _MIN_TORQUE_GAIN)

    def small(self, start: Array) -> tuple[Array, Array]:
        """Return small errors beside quarter turns and their deviations, rad, each shape (n,)."""
        identifiable, (shift, spread) = self.independent, np.zeros((2, len(start)))
        for _ in range(ROUNDS if identifiable.any() else 0):
            columns, slopes = self._derivatives(start + shift)
            fit, first = solve(self._problem, np.hstack([columns, slopes[:, identifiable]])), columns.shape[1]
            shift[identifiable] += fit.value[first:]
            spread[identifiable] = fit.deviation[first:]
            if np.abs(fit.value[first:]).max() < 0.1 * SMALLEST or not is_error(shift, spread).any():
                break
        return shift, spread

    def wrong_signs(self) -> tuple[tuple[WrongSign, ...], float, float]:
        """Return the motors with wrong signs, and the unexplained share of their torque before and after the change."""
        motors, wrong, first = range(len(self._problem.arm.names)), tuple[WrongSign, ...](), self._signed(())
        now = first
        for _ in motors:
            there = {one.motor for one in wrong}
            tried = [(*wrong, WrongSign(k, *how)) for k in motors if k not in there for how in _SIGN_ERRORS]
            # The most likely one: minus the logarithm of the likelihood, but for a constant.
            best, other = min(
                ((one, self._signed(one)) for one in tried), key=lambda pair: float(np.log(pair[1].sigma).sum())
            )
            # The joint itself must improve as well: a small gain on another, quiet joint would weigh as much.
            own = self._problem.arm.coupling[best[-1].motor, other.joint] != 0.0
            error_now, error_with = (float(np.linalg.norm(one.residual(other.sigma)[own])) for one in (now, other))
            clearly = self._explains(*self._compared(now, other), _CLEAR_SE, _MIN_SIGN_GAIN)
            if not clearly or error_with > (1.0 - _MIN_SIGN_GAIN) * error_now:
                break
            # Where the direction of the joint's motion cannot be determined, the torque is more often wrong than the
            # position.
            plain = (*wrong, best[-1]._replace(motion=False, torque=True))
            torque_only = self._signed(plain)
            if not self._beats(other, torque_only):
                best, other = plain, torque_only
            wrong, now = best, other
        others = [motor for motor in motors if motor not in {one.motor for one in wrong}]
        for k, one in enumerate(wrong):
            swapped = [(*wrong[:k], one._replace(motor=motor), *wrong[k + 1 :]) for motor in others]
            interchangeable = [
                motor for motor, way in zip(others, swapped, strict=True) if not self._beats(now, self._signed(way))
            ]
            wrong = (*wrong[:k], one._replace(interchangeable=tuple(interchangeable)), *wrong[k + 1 :])
        named = [motor for one in wrong for motor in (one.motor, *one.interchangeable)]
        own = np.isin(self._problem.joint[self._some], named)
        size = max(float(np.linalg.norm(first.torque[own])), 1e-300)
        before, after = (float(np.linalg.norm(one.residual(now.sigma)[own])) / size for one in (first, now))
        return wrong, before, after

    def _beats(self, other: _Signed, now: _Signed) -> bool:
        """Return whether a hypothesis explains clearly more than another wrong sign."""
        return self._explains(*self._compared(now, other), _CLEAR_SE, _MIN_TORQUE_GAIN)

    def _compared(self, now: _Signed, other: _Signed) -> tuple[Array, Array]:
        """Return the squared residuals of two hypotheses by block, weighted by the noise of the other hypothesis.

        A wrong sign makes the noise of its joint large and so hides in it; the right one does not.
        """
        block, count = self._block[self._some], int(self._block.max()) + 1
        left = ((one.residual(other.sigma) / other.sigma) ** 2 for one in (now, other))
        first, second = (np.bincount(block, squares, count).astype(np.float64) for squares in left)
        return first, second

    def _signed(self, wrong: Sequence[WrongSign]) -> _Signed:
        """Return the equations of the rows, with some signs reversed.

        The friction's columns are those of the filtered velocities, which is accurate enough here.
        """
        problem, rows, coupling = self._problem, self._some, self._problem.arm.coupling
        signs = np.ones((2, len(coupling)))
        for motor, motion, torque, _ in wrong:
            signs[[motion, torque], motor] = -1.0
        moves, acts = (np.linalg.inv(coupling) @ (sign[:, None] * coupling) for sign in signs)
        instants, place = np.unique(problem.sample[rows], return_inverse=True)
        joint = problem.joint[rows]
        moved = [values[instants] @ moves.T for values in (self._position, self._velocity, self._acceleration)]
        columns = problem.columns.torque(*moved)[place, joint]
        speed, share = (moved[1] @ problem.arm.element_matrix.T)[place], problem.arm.element_matrix.T[joint]
        recorded = (self._torque[instants] @ acts)[place, joint]
        return _Signed(
            joint, columns[:, list(problem.base.leading)], np.hstack([share * np.sign(speed), share * speed]), recorded
        )

    @staticmethod
    def _explains(squares: Array, less: Array, errors: float, share: float) -> bool:
        """Return whether residuals fall clearly: block by block, by more than chance and by a relevant share."""
        gain = squares - less
        filled = gain[squares > 0.0]
        error = float(np.std(filled, ddof=1)) * math.sqrt(len(filled)) if len(filled) > 1 else math.inf
        return float(gain.sum()) > max(errors * error, (1.0 - (1.0 - share) ** 2) * float(squares.sum()))

    def _columns(self, shift: Array, rows: Index) -> Array:
        """Return the columns of the simple model with shifted angles, shape (r, q)."""
        instants, place = np.unique(self._problem.sample[rows], return_inverse=True)
        motion = self._position[instants] + shift, self._velocity[instants], self._acceleration[instants]
        columns = self._problem.columns.torque(*motion)[:, :, list(self._problem.base.leading)]
        return np.hstack([columns[place, self._problem.joint[rows]], self._friction[rows]])

    def _squares(self, shift: Array) -> Array:
        """Return the sum of weighted squared residuals of each block of time."""
        rows, weight = self._some, self._weight[self._some]
        target = self._problem.torque[rows] * weight[:, 0]
        left = target - _projected(self._columns(shift, rows) * weight, target)
        return np.bincount(self._block[rows], left**2, int(self._block.max()) + 1).astype(np.float64)

    def _derivatives(self, shift: Array) -> tuple[Array, Array]:
        """Return the columns of the simple model, shape (r, q), and the torque's derivatives by angles, (r, n)."""
        columns, b = self._columns(shift, self._all), len(self._problem.names)
        value, steps = solve(self._problem, columns).value[:b], _STEP * np.eye(len(shift))
        sides = (self._columns(shift + step, self._all) - self._columns(shift - step, self._all) for step in steps)
        return columns, np.column_stack([side[:, :b] @ value / (2.0 * _STEP) for side in sides])


def _projected(columns: Array, target: Array) -> Array:
    """Return the projection of values, shape (r, ...), on the space of columns, shape (r, q)."""
    basis = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))[0]
    return np.asarray(basis @ (basis.T @ target))
