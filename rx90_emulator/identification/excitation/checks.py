"""Whether signs and encoder zeros are right, by the simplest model: rigid body, Coulomb and viscous friction.

A wrong zero bends the arm in the wrong place, and no inertia makes good for it. Logs are off by quarter turns where
URDF and encoder count from other poses, and by some hundredths of a radian after a bad calibration: quarter turns are
tried one joint and two neighbours at a time, then small errors by their derivatives. A zero that base parameters can
make good for (a vertical first axis, the last joint) changes no torque, and is never blamed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.law import COULOMB, VISCOUS, ElementShape, joint_columns
from rx90_emulator.identification.excitation.least_squares import solve, time_blocks
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.zeros import SMALLEST, STEP, ZeroCheck, check_of, quarter_turns

_WRONG_SIGN_SE = 6.0  # deviations


def coulomb_viscous(problem: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
    """Return names and columns, two for each element: sign(v) and v, the torques per tau_c and c2; shape (r, 2 n_el).

    The sign is of the filtered velocity at the full rate, where the torque was recorded, and is filtered with it.
    """
    names = tuple(f"{name}.{part}" for name in problem.arm.element_names for part in ("tau_c", "c2"))
    columns = joint_columns(problem, [ElementShape()] * len(problem.arm.element_names))
    return names, columns[:, :, [COULOMB, VISCOUS]].reshape(len(problem), -1)


def check_signs(problem: ExcitationProblem) -> None:
    """Refuse torques of an element that drive the motion instead of opposing it, beyond any doubt.

    Raises:
        IdentificationError: naming the element and its Coulomb torque.
    """
    fit, first = solve(problem, np.hstack([problem.regressor, coulomb_viscous(problem)[1]])), len(problem.names)
    value, deviation, told = (part[first:].reshape(-1, 2) for part in (fit.value, fit.deviation, fit.determined))
    drives = (value[:, 1] < 0.0) & (value[:, 0] < -_WRONG_SIGN_SE * deviation[:, 0]) & told.all(axis=1)
    for k in np.flatnonzero(drives)[:1]:
        raise IdentificationError(
            f"{problem.arm.element_names[k]}: the torque does not oppose the motion (Coulomb torque {value[k, 0]:.3g} "
            f"+- {deviation[k, 0]:.2g} Nm); accepted: efforts of the sign with which the drive moves the joint (check "
            "the signs of gears and torque constants)"
        )


_SCREENING_ROWS = 2500  # that quarter turns are compared on, at most: evenly taken from all
_QUARTER_TURN_SE = 3.0  # standard errors by which a change must explain more
_ZERO_ERROR_SE = 4.0  # deviations from which a small error is one
_MIN_SECOND_JOINT_GAIN = 0.005  # share of the squares that a second joint must explain, to be turned with the first
_MIN_TORQUE_GAIN = 0.02  # share of the torque error, at least
_MAX_SMALL_ERROR = 0.3  # rad, of an error that counts as small
_MAX_ROUNDS = 3  # of Gauss and Newton
_MIN_INDEPENDENT_SHARE = 1e-4  # share of a derivative's squares that the other columns must leave, to tell the zero


def check_zeros(problem: ExcitationProblem, zero: Array | None = None) -> ZeroCheck:
    """Look for zeros that explain the torques of runs clearly better.

    Args:
        problem: equations with the zeros as they were given.
        zero: these, recorded angles where those of the URDF are 0, rad, shape (n,); by default 0.
    """
    none = np.zeros(len(problem.arm.names))
    search = _Search(problem)
    told = search.told() & problem.arm.identified
    quarters = search.quarter_turned(told)
    small, deviation = search.small(quarters, told)
    shift = quarters + small

    def mean_square(values: Array) -> Array:
        return np.asarray(np.bincount(problem.joint, values**2, len(none)) / len(problem))

    check = ZeroCheck(problem.arm.names, none if zero is None else zero, none, deviation, told, 0.0, 0.0)
    return check_of(
        check, shift, lambda angles: {"": mean_square(search.residual(angles))}, mean_square(problem.torque)
    )


class _Search:
    """Fits with other angles; the motion passes the parallel filter in place of each of its columns, which is cheap."""

    def __init__(self, problem: ExcitationProblem) -> None:
        self._problem, self._friction = problem, coulomb_viscous(problem)[1]
        self._position, self._velocity, self._acceleration = (
            np.concatenate([run.parallel(getattr(run, name)) for run in problem.runs])
            for name in ("position", "velocity", "acceleration")
        )
        self._block, self._all = time_blocks(problem), np.arange(len(problem))
        fit = solve(problem, np.hstack([problem.regressor, self._friction]))
        self._weight = (1.0 / fit.sigma[problem.joint])[:, None]
        # Whole instants are taken, so that no more regressors are computed than rows are compared.
        self._some = np.flatnonzero(problem.sample % max(1, math.ceil(len(problem) / _SCREENING_ROWS)) == 0)

    def told(self) -> Mask:
        """Return the joints whose zero the torques tell: no base parameter makes good for its error, shape (n,)."""
        columns, slopes = (
            values * self._weight for values in self._derivatives(np.zeros(len(self._problem.arm.names)))
        )
        left = slopes - _projected(columns, slopes)
        size = np.sum(slopes**2, axis=0)
        return np.asarray(np.sum(left**2, axis=0) > _MIN_INDEPENDENT_SHARE * np.maximum(size, 1e-300))

    def quarter_turned(self, told: Mask) -> Array:
        """Return the quarter turns of joints that explain clearly more, rad, shape (n,)."""
        best = np.zeros(len(told))
        squares = self._squares(best)
        joints = np.flatnonzero(told).tolist()
        for _ in joints:
            single, double = quarter_turns(best, joints)
            shift, less = self._least(single)
            if double:
                two = self._least(double)
                if two[1].sum() < less.sum() - _MIN_SECOND_JOINT_GAIN * squares.sum():
                    shift, less = two
            # Clearly: block by block, by more than chance and by a share that counts.
            gain = squares - less
            filled = gain[squares > 0.0]
            error = float(np.std(filled, ddof=1)) * math.sqrt(len(filled)) if len(filled) > 1 else math.inf
            needed = (1.0 - (1.0 - _MIN_TORQUE_GAIN) ** 2) * float(squares.sum())
            if float(gain.sum()) <= max(_QUARTER_TURN_SE * error, needed):
                break
            best, squares = shift, less
        return best

    def small(self, start: Array, told: Mask) -> tuple[Array, Array]:
        """Return small errors beside quarter turns and their deviations, rad, each shape (n,): 0 where none is sure."""
        shift, spread = np.zeros((2, len(start)))
        sure = told
        for _ in range(_MAX_ROUNDS if told.any() else 0):
            columns, slopes = self._derivatives(start + shift)
            fit, first = solve(self._problem, np.hstack([columns, slopes[:, told]])), columns.shape[1]
            shift[told] += fit.value[first:]
            spread[told] = fit.deviation[first:]
            sure = told & (np.abs(shift) > np.maximum(SMALLEST, _ZERO_ERROR_SE * spread))
            if np.abs(fit.value[first:]).max() < 0.1 * SMALLEST or not sure.any():
                break
        sure = sure & (np.abs(shift) < _MAX_SMALL_ERROR)
        return np.where(sure, shift, 0.0), np.where(sure, spread, 0.0)

    def residual(self, shift: Array) -> Array:
        """Return what rigid body, Coulomb and viscous friction leave of the torque with shifted angles, Nm."""
        return solve(self._problem, self._columns(shift, self._all)).residual

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

    def _least(self, shifts: Sequence[Array]) -> tuple[Array, Array]:
        """Return those of some angles that leave least, and the squares they leave in each block."""
        return min(((one, self._squares(one)) for one in shifts), key=lambda found: float(found[1].sum()))

    def _derivatives(self, shift: Array) -> tuple[Array, Array]:
        """Return the columns of the simple model, shape (r, q), and the torque's derivatives by angles, (r, n)."""
        columns, b = self._columns(shift, self._all), len(self._problem.names)
        value, steps = solve(self._problem, columns).value[:b], STEP * np.eye(len(shift))
        sides = (self._columns(shift + step, self._all) - self._columns(shift - step, self._all) for step in steps)
        return columns, np.column_stack([side[:, :b] @ value / (2.0 * STEP) for side in sides])


def _projected(columns: Array, target: Array) -> Array:
    """Return the part of some values, shape (r, ...), in the space of columns, shape (r, q)."""
    basis = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))[0]
    return np.asarray(basis @ (basis.T @ target))
