"""Which sign or zero of a recording looks wrong, by the simplest model: rigid body and friction.

The friction of an element has three columns: Coulomb, viscous, and a rise towards rest.

A torque constant of the wrong sign reverses its motor's torque, a gear of the wrong sign torque and motion, a wrong
sign of the position the motion alone; an encoder that counts from another pose is a quarter turn or two off. Each error
is tried on one motor or joint after the other, with friction bounded to 0 or more, until none explains the torque
clearly better. An error that the base parameters compensate, such as the zero of a vertical first axis, is never found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Index, Mask
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.fit import nonnegative, time_blocks
from rx90_emulator.identification.excitation.problem import BaseGroups, ExcitationProblem, StandardColumns
from rx90_emulator.identification.options import SHIPPED_ROBOT, RobotOptions

ROWS_PER_PARAMETER = 2.0
"""Of the simplest model, at least: fewer predict nothing, and fit any sign."""
_MOST_ROWS = 2500  # that trials are compared on, whole instants evenly spread over all
_SHORT_ROWS_PER_PARAMETER = 8.0  # with 2 to 6 rows per parameter, 7 % of right signs looked wrong, with more none
# of short runs: share of the torque unexplained; of it after a change
_SHORT_ERROR = 0.1
_SHORT_REMAINDER = 1.0 / 3.0
# standard errors, and share of the torque error, that an error must explain
_CLEAR_SE = 3.0
_MIN_GAIN = 0.15
_MIRRORED_GAIN = 0.02  # share by which one error must explain more than another to be told from it
_CUTOFF = 1e-11  # relative, of squares: directions that the rows do not determine
_RISE_SHARE = 0.05  # decay of a rise towards rest over the fastest speed
_ERRORS = (
    ("effort", 0.0), ("gear", 0.0), ("position", 0.0),
    ("zero", -0.5 * math.pi), ("zero", 0.5 * math.pi), ("zero", math.pi),
)  # fmt: skip
"""What may be wrong, the usual before the rare, and by how much a zero is too large, rad."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """Motion and torque of n joints at m instants.

    Attributes:
        motion: position, velocity and acceleration, rad and s, shape (3, m, n).
        torque: Nm, shape (m, n).
        used: where no friction element that acts on the joint rests, shape (m, n).
        block: number of the stretch within which errors are correlated, shape (m,).
    """

    motion: Array
    torque: Array
    used: Mask
    block: Index

    @classmethod
    def of(cls, problem: ExcitationProblem) -> Recorded:
        """Return the filtered motion and torque of a problem's instants."""
        names = ("position", "velocity", "acceleration", "torque")
        *motion, torque = (np.concatenate([run.parallel(getattr(run, name)) for run in problem.runs]) for name in names)
        used = np.zeros(torque.shape, dtype=np.bool_)
        block = np.zeros(len(torque), dtype=np.intp)
        used[problem.sample, problem.joint] = True
        block[problem.sample] = time_blocks(problem)
        return cls(np.stack(motion), torque, used, block)


class Suspect(NamedTuple):
    """What looks wrong: "effort", "gear", "position" or "zero" of one of some joints, which explain it equally well.

    The zero is too large by `turn`, rad; the numbers of the joints, or of their motors, count from 0 at the base.
    """

    joints: tuple[int, ...]
    what: str
    turn: float


class _Fit(NamedTuple):
    """A fit with some errors put right: residual, its standard deviation, and torque, Nm, all of shape (r,)."""

    residual: Array
    sigma: Array
    torque: Array


class _Fits:
    """Fits of r rows of a recording with errors put right."""

    def __init__(self, arm: RigidArm, recorded: Recorded) -> None:
        self._arm = arm
        self._columns = StandardColumns(arm)
        self._recorded = recorded
        self._leading = list(BaseGroups.of(self._columns).leading)
        rows = np.count_nonzero(recorded.used)
        self.rows_per_parameter = rows / (len(self._leading) + 2 * len(arm.element_names))
        self._some = slice(None, None, math.ceil(rows / _MOST_ROWS) or 1)
        self._row, self.joint = np.nonzero(recorded.used[self._some])
        self._block = recorded.block[self._some][self._row]

    def sizes(self, values: Array) -> Array:
        """Return the RMS of the values of each joint's rows, shape (n,)."""
        count = np.maximum(np.bincount(self.joint, minlength=len(self._arm.names)), 1)
        squares = np.bincount(self.joint, values**2, len(count)) / count
        return np.asarray(np.maximum(np.sqrt(squares), 1e-12 + 1e-9 * np.abs(self._recorded.torque).max()))

    def fit(self, suspects: Sequence[Suspect]) -> _Fit:
        """Return the fit with these put right."""
        arm = self._arm
        recorded = self._recorded
        row = self._row
        moves = np.ones(len(arm.names))
        acts = np.ones(len(arm.names))
        shift = np.zeros(len(arm.names))
        for (number, *_), what, turn in suspects:
            moves[number] *= -1.0 if what in ("gear", "position") else 1.0
            acts[number] *= -1.0 if what in ("gear", "effort") else 1.0
            shift[number] -= turn
        inverse = np.linalg.inv(arm.coupling)
        motion = recorded.motion[:, self._some] @ (inverse @ (moves[:, None] * arm.coupling)).T
        motion[0] += shift
        torque = (recorded.torque[self._some] @ inverse @ (acts[:, None] * arm.coupling))[row, self.joint]
        rigid = self._columns.torque(*motion)[row, self.joint][:, self._leading]
        speed = motion[1] @ arm.element_matrix.T
        rise = np.sign(speed) * np.exp(-np.abs(speed) / (_RISE_SHARE * np.abs(speed).max() + 1e-9))
        shapes = (np.sign(speed), speed, rise)
        friction = np.hstack([arm.element_matrix.T[self.joint] * shape[row] for shape in shapes])
        residual = torque
        for _ in range(2):  # the second time each joint is weighted by its own noise
            sigma = self.sizes(residual)[self.joint]
            scaled = rigid / sigma[:, None]
            scaled = scaled / np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
            squares, directions = np.linalg.eigh(scaled.T @ scaled)
            known = squares > _CUTOFF * squares[-1]
            basis = scaled @ directions[:, known] / np.sqrt(squares[known])
            dry, left = (values - basis @ (basis.T @ values) for values in (friction / sigma[:, None], torque / sigma))
            residual = (left - dry @ nonnegative(dry.T @ dry, dry.T @ left)) * sigma
        return _Fit(residual, self.sizes(residual)[self.joint], torque)

    def explains(self, other: _Fit, now: _Fit, least: float) -> bool:
        """Return whether a fit explains clearly more: block by block, in its own noise, and a relevant share."""
        before = np.bincount(self._block, (now.residual / other.sigma) ** 2)
        after = np.bincount(self._block, (other.residual / other.sigma) ** 2)
        gain = (before - after)[before > 0.0]
        error = float(np.std(gain)) * math.sqrt(len(gain))
        return float(gain.sum()) > max(_CLEAR_SE * error, (1.0 - (1.0 - least) ** 2) * float(before.sum()))


def suspicion(
    arm: RigidArm, recorded: Recorded, options: RobotOptions = SHIPPED_ROBOT, zero: Array | None = None
) -> tuple[tuple[Suspect, ...], str]:
    """Return what of a recording clearly looks wrong, and this in words; nothing of a very short one.

    Args:
        arm: of the same joints.
        recorded: with signs and zeros as they were given.
        options: the given gears and torque constants.
        zero: the given zeros, rad, shape (n,); by default 0.
    """
    fits = _Fits(arm, recorded)
    joints = np.flatnonzero(arm.identified).tolist()
    found: tuple[Suspect, ...] = ()
    if fits.rows_per_parameter < ROWS_PER_PARAMETER:
        return found, ""
    now = first = fits.fit(found)
    for _ in joints:
        left = [k for k in joints if k not in {one.joints[0] for one in found}]
        suspects = [Suspect((k,), what, turn) for what, turn in _ERRORS for k in left]
        trials = {one: fits.fit((*found, one)) for one in suspects}
        # The most likely one: minus the logarithm of the likelihood, but for a constant.
        best = min(trials.values(), key=lambda trial: float(np.log(trial.sigma).sum()))
        fall = float(np.max(1.0 - fits.sizes(best.residual) / fits.sizes(now.residual)))
        if fall < _MIN_GAIN or not fits.explains(best, now, _MIN_GAIN):
            break
        # Where the motion does not tell its direction, an effort is more often wrong than a gear.
        equal = [one for one, trial in trials.items() if not fits.explains(best, trial, _MIRRORED_GAIN)]
        same = tuple(one.joints[0] for one in equal if one[1:] == equal[0][1:])
        found = (*found, equal[0]._replace(joints=same))
        now = trials[equal[0]]
    named = np.isin(fits.joint, [k for one in found for k in one.joints])
    size = float(np.linalg.norm(first.torque[named])) or 1.0
    before = float(np.linalg.norm(first.residual[named])) / size
    after = float(np.linalg.norm(now.residual[named])) / size
    short = fits.rows_per_parameter < _SHORT_ROWS_PER_PARAMETER
    if not found or after >= before or (short and (before < _SHORT_ERROR or after > _SHORT_REMAINDER * before)):
        return (), ""
    what, better = _advice(found, arm, options, zero)
    shares = f"{before:.1%} of the torque there are unexplained, after a change {after:.1%}"
    return found, f"wrong {what}: {shares}; accepted: {better}, there or in the signal map"


def _advice(found: Sequence[Suspect], arm: RigidArm, options: RobotOptions, zero: Array | None) -> tuple[str, str]:
    """Return what is wrong in words, and the options to give instead."""
    joints = np.flatnonzero(arm.identified).tolist()
    given = {"gear": options.gear, "torque-constant": options.torque_constant}
    values = {name: np.array(given[name] or [1.0] * len(joints)) for name in given}
    values["zero"] = np.zeros(len(joints)) if zero is None else zero[joints]
    words = []
    changed = dict[str, str]()
    for numbers, what, turn in found:
        place = joints.index(numbers[0])
        for name in {"effort": ["torque-constant"], "position": ["gear", "torque-constant"]}.get(what, [what]):
            values[name][place] = values[name][place] + turn if turn else -values[name][place]
            changed[name] = f"--{name} {' '.join(f'{value:.6g}' for value in np.round(values[name], 6) + 0.0)}"
        words.append(f"{'zero' if turn else f'sign of the {what}'} of {' or '.join(arm.names[k] for k in numbers)}")
    missing = ", unless a payload or spring is missing in the model" if any(turn for _, _, turn in found) else ""
    return " and ".join(words) + missing, " ".join(changed.values())
