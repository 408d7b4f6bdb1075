"""Whether signs and encoder zeros are right, by the simplest model: rigid body, Coulomb and viscous friction.

The simplest friction: Coulomb and viscous torque of each element.

Whether the encoders' zeros are those of the URDF: which other zeros would explain the torques clearly better.

A wrong zero bends the arm in the wrong place, and no inertia makes good for it. Logs are off by quarter turns where
URDF and encoder count from other poses, and by some hundredths of a radian after a bad calibration. Both are looked for
in the model of rigid body, Coulomb and viscous friction: quarter turns one joint and two neighbours at a time, then
small errors by their derivatives. A zero that base parameters can make good for (a vertical first axis, the last joint)
changes no torque, and is never blamed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.least_squares import solve, time_blocks
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.zeros import SMALLEST, STEP, ZeroCheck, encoder_error, quarter_turns

_WRONG_SIGN_SE = 6.0  # deviations


def coulomb_viscous(problem: ExcitationProblem) -> tuple[tuple[str, ...], Array]:
    """Return names and columns, two for each element: sign(v) and v, the torques per tau_c and c2; shape (r, 2 n_el).

    The sign is of the filtered velocity at the full rate, where the torque was recorded, and is filtered with it.
    """
    elements = problem.arm.element_matrix.T
    along = []
    for run in problem.runs:
        velocity = run.torque_velocity @ elements
        along.append(run.evened(np.stack([np.sign(velocity), velocity], axis=2)))
    names = tuple(f"{name}.{part}" for name in problem.arm.element_names for part in ("tau_c", "c2"))
    return names, problem.element_rows(along)


def check_signs(problem: ExcitationProblem) -> None:
    """Refuse torques of an element that drive the motion instead of opposing it, beyond any doubt.

    Raises:
        IdentificationError: naming the element and its Coulomb torque.
    """
    columns = coulomb_viscous(problem)[1]
    fit, first = solve(problem, np.hstack([problem.regressor, columns])), len(problem.names)
    value, deviation, told = (part[first:].tolist() for part in (fit.value, fit.deviation, fit.determined))
    for k, name in enumerate(problem.arm.element_names):
        coulomb, viscous = 2 * k, 2 * k + 1
        drives = value[viscous] < 0.0 and value[coulomb] < -_WRONG_SIGN_SE * deviation[coulomb]
        if drives and told[coulomb] and told[viscous]:
            raise IdentificationError(
                f"{name}: the torque does not oppose the motion (Coulomb torque {value[coulomb]:.3g} +- "
                f"{deviation[coulomb]:.2g} Nm); accepted: efforts of the sign with which the drive moves the joint "
                "(check the signs of gears and torque constants)"
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
    n = len(problem.arm.names)
    search = _Search.of(problem)
    told = search.told(np.zeros(n))
    quarters = search.turned(told)
    small, deviation = search.small(quarters, told)
    shift = quarters + small
    powers = [
        float(np.mean(values**2)) for values in (problem.torque, search.residual(np.zeros(n)), search.residual(shift))
    ]
    scale = max(powers[0], 1e-300)
    return ZeroCheck(
        problem.arm.names,
        np.zeros(n) if zero is None else zero,
        encoder_error(shift),
        deviation,
        told,
        math.sqrt(powers[1] / scale),
        math.sqrt(powers[2] / scale),
    )


@dataclass(frozen=True, eq=False)
class _Search:
    """Fits with other angles; the motion passes the parallel filter in place of each of its columns, which is cheap."""

    problem: ExcitationProblem
    friction: Array
    block: Index
    weight: Array
    instants: tuple[Array, Array, Array]
    instant: Index
    some: Index

    @classmethod
    def of(cls, problem: ExcitationProblem) -> _Search:
        starts = np.cumsum([0, *(len(run.rows) for run in problem.runs)])
        motion = [np.concatenate([run.parallel(getattr(run, name)) for run in problem.runs])
                  for name in ("position", "velocity", "acceleration")]  # fmt: skip
        friction = coulomb_viscous(problem)[1]
        fit = solve(problem, np.hstack([problem.regressor, friction]))
        # Whole instants are taken, so that no more regressors are computed than rows are compared.
        instant = starts[problem.run] + problem.place
        every = max(1, math.ceil(len(problem) / _SCREENING_ROWS))
        some = np.flatnonzero(instant % every == 0)
        position, velocity, acceleration = motion
        return cls(
            problem, friction, time_blocks(problem), 1.0 / fit.sigma[problem.joint],
            (position, velocity, acceleration), instant, some,
        )  # fmt: skip

    def told(self, shift: Array) -> Mask:
        """Return the joints whose zero the torques tell: no base parameter makes good for its error, shape (n,)."""
        columns, slopes = self._derivatives(shift)
        weight = self.weight[:, None]
        basis = np.linalg.qr(_scaled(columns * weight))[0]
        left = slopes * weight - basis @ (basis.T @ (slopes * weight))
        size = np.sum((slopes * weight) ** 2, axis=0)
        return np.asarray(np.sum(left**2, axis=0) > _MIN_INDEPENDENT_SHARE * np.maximum(size, 1e-300))

    def turned(self, told: Mask) -> Array:
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
            if not _clearly_less(less, squares):
                break
            best, squares = shift, less
        return best

    def small(self, start: Array, told: Mask) -> tuple[Array, Array]:
        """Return small errors beside quarter turns and their deviations, rad, each shape (n,): 0 where none is sure."""
        none = np.zeros(len(start))
        if not told.any():
            return none, none
        shift, spread = none.copy(), none.copy()
        for _ in range(_MAX_ROUNDS):
            columns, slopes = self._derivatives(start + shift)
            fit = solve(self.problem, np.hstack([columns, slopes[:, told]]))
            step = fit.value[columns.shape[1] :]
            shift[told] += step
            spread[told] = fit.deviation[columns.shape[1] :]
            sure = np.abs(shift) > np.maximum(SMALLEST, _ZERO_ERROR_SE * spread)
            if np.abs(step).max() < 0.1 * SMALLEST or not sure[told].any():
                break
        sure &= told & (np.abs(shift) < _MAX_SMALL_ERROR)
        shift, spread = np.where(sure, shift, 0.0), np.where(sure, spread, 0.0)
        return shift, spread

    def residual(self, shift: Array) -> Array:
        """Return what rigid body, Coulomb and viscous friction leave of the torque with shifted angles, Nm."""
        return solve(
            self.problem, np.hstack([self._regressor(shift, np.arange(len(self.problem))), self.friction])
        ).residual

    def _regressor(self, shift: Array, rows: Index) -> Array:
        leading = list(self.problem.base.leading)
        instants, place = np.unique(self.instant[rows], return_inverse=True)
        position, velocity, acceleration = (values[instants] for values in self.instants)
        columns = self.problem.columns.torque(position + shift, velocity, acceleration)[:, :, leading]
        return np.asarray(columns[place, self.problem.joint[rows]])

    def _squares(self, shift: Array) -> Array:
        """Return the sum of weighted squared residuals of each block of time."""
        rows = self.some
        weight = self.weight[rows]
        columns = np.hstack([self._regressor(shift, rows), self.friction[rows]]) * weight[:, None]
        target = (self.problem.torque[rows]) * weight
        basis = np.linalg.qr(_scaled(columns))[0]
        left = target - basis @ (basis.T @ target)
        return np.asarray(np.bincount(self.block[rows], left**2, int(self.block.max()) + 1), dtype=np.float64)

    def _least(self, shifts: Sequence[Array]) -> tuple[Array, Array]:
        """Return those of some angles that leave least, and the squares they leave in each block."""
        return min(((one, self._squares(one)) for one in shifts), key=lambda found: float(found[1].sum()))

    def _derivatives(self, shift: Array) -> tuple[Array, Array]:
        """Return the columns of the simple model, shape (r, q), and the derivatives by the angles, shape (r, n)."""
        rows = np.arange(len(self.problem))
        columns = np.hstack([self._regressor(shift, rows), self.friction])
        value = solve(self.problem, columns).value[: len(self.problem.names)]
        slopes = [
            (self._regressor(shift + step, rows) - self._regressor(shift - step, rows)) @ value / (2.0 * STEP)
            for step in np.eye(len(shift)) * STEP
        ]
        return columns, np.column_stack(slopes)


def _scaled(columns: Array) -> Array:
    return np.asarray(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))


def _clearly_less(squares: Array, before: Array) -> bool:
    """Return whether squares are less than before, block by block, by more than chance and by a share that counts."""
    gain = before - squares
    filled = gain[before > 0.0]
    error = float(np.std(filled, ddof=1)) * math.sqrt(len(filled)) if len(filled) > 1 else math.inf
    needed = (1.0 - (1.0 - _MIN_TORQUE_GAIN) ** 2) * float(before.sum())
    return float(gain.sum()) > max(_QUARTER_TURN_SE * error, needed)
