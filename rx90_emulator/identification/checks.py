"""Which sign or zero of a recording looks wrong, by the simplest model: rigid body, Coulomb and viscous friction.

A torque constant of the wrong sign reverses its motor's torque, a gear of the wrong sign torque and motion, a wrong
sign of the position the motion alone; an encoder that counts from another pose is a quarter turn or two off. Each error
is tried on one motor or joint after the other, with friction bounded to 0 or more, until none explains the torque
clearly better. Of motors or joints that explain it equally well, as of an arm that moves like its mirror image, one is
named. An error that the base parameters compensate, such as the zero of a vertical first axis, is never found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from rx90_common.base.arrays import Array, Index, Mask
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.options import SHIPPED_ROBOT, RobotOptions
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.rigid import BaseGroups, StandardColumns

ROWS_PER_PARAMETER = 2.0
"""Of the simplest model, at least: fewer predict nothing, and fit any sign."""
_CHECKED_ROWS_PER_PARAMETER = 8.0  # with 2 to 6, 7 % of right signs looked wrong, with more none
_MOST_ROWS = 2500  # that trials are compared on, whole instants evenly spread over all
# what an error must explain: standard errors, and squared torque error as a share of what remains
_CLEAR_SE = 3.0
_MIN_GAIN = 0.4
_QUARTER = 0.5 * math.pi
_OPTIONS = ("gear", "torque-constant", "zero")
_ERRORS = (
    ("sign of the effort", 1.0, -1.0, 0.0),
    ("sign of the gear", -1.0, 1.0, 0.0),
    ("sign of the position", -1.0, -1.0, 0.0),
    ("zero", 1.0, 1.0, -_QUARTER),
    ("zero", 1.0, 1.0, _QUARTER),
    ("zero", 1.0, 1.0, 2.0 * _QUARTER),
)
"""What may be wrong, the usual before the rare, and what puts it right: factors of gear and torque constant, and what
to add to the zero, rad."""


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
        filtered = [np.concatenate([run.parallel(getattr(run, name)) for run in problem.runs]) for name in names]
        used = np.zeros(filtered[0].shape, np.bool_)
        used[problem.sample, problem.joint] = True
        block = np.zeros(len(used), np.intp)
        block[problem.sample] = problem.block
        return cls(np.stack(filtered[:3]), filtered[3], used, block)


def suspicion(
    arm: RigidArm, recorded: Recorded, options: RobotOptions = SHIPPED_ROBOT, zero: Array | None = None
) -> tuple[dict[int, str], str]:
    """Return what of a recording clearly looks wrong, and this in words; nothing of a short one.

    Args:
        arm: of the same joints.
        recorded: with signs and zeros as they were given.
        options: the given gears and torque constants.
        zero: the given zeros, rad, shape (n,); by default 0.

    Returns:
        The sign or "zero" (as in _ERRORS) by the number of the joint, or of its motor, from 0 at the base; the text.
    """
    found: dict[int, str] = {}
    columns = StandardColumns(arm)
    leading = list(BaseGroups.of(columns).leading)
    rows = np.count_nonzero(recorded.used)
    if rows < _CHECKED_ROWS_PER_PARAMETER * (len(leading) + 2 * len(arm.element_names)):
        return found, ""
    step = 1 + rows // _MOST_ROWS
    used = recorded.used[::step]
    motion = recorded.motion[:, ::step]
    torque = recorded.torque[::step]
    row, joint = np.nonzero(used)
    block = recorded.block[::step][row]

    def sizes(values: Array) -> Array:
        """Return the RMS of the values of each row's joint, Nm, shape (r,)."""
        squares = np.bincount(joint, values**2)[joint] / np.bincount(joint)[joint]
        return np.asarray(np.sqrt(squares) + 1e-9)

    def residual(change: Array) -> Array:
        """Return what a fit leaves of the torque, Nm, shape (r,).

        Args:
            change: factors of gears and torque constants, and angles added to the zeros, rad, shape (3, n).
        """
        inverse = np.linalg.inv(arm.coupling)
        gear = change[0][:, None] * arm.coupling
        moved = motion @ (inverse @ gear).T
        moved[0] -= change[2]
        target = (torque @ inverse @ (change[1][:, None] * gear))[used]
        rigid = columns.torque(*moved)[used][:, leading]
        speed = moved[1] @ arm.element_matrix.T
        friction = np.tile(arm.element_matrix.T, 2)[joint] * np.hstack([np.sign(speed), speed])[row]
        left: Array = target
        for _ in range(2):  # the second time each joint is weighted by its own noise
            sigma = sizes(left)
            basis = np.linalg.qr(rigid / sigma[:, None])[0]
            dry = friction / sigma[:, None]
            dry = dry - basis @ (basis.T @ dry)
            left = target / sigma
            left = left - basis @ (basis.T @ left)
            left = (left - dry @ nnls(dry, left)[0]) * sigma
        return left

    usual = np.tile([[1.0], [1.0], [0.0]], len(arm.names))
    change = usual
    first = now = residual(change)
    joints = np.flatnonzero(arm.identified).tolist()
    for _ in joints:
        trials = []
        for what, *right in _ERRORS:
            for k in set(joints) - set(found):
                changed = change.copy()
                changed[:, k] = right
                trials.append((residual(changed), k, what, changed))
        # The most likely one, by minus the logarithm of the likelihood; of equal ones the most usual.
        best, k, what, changed = min(trials, key=lambda trial: round(np.log(sizes(trial[0])).mean(), 3))
        gain = np.bincount(block, (now**2 - best**2) / sizes(best) ** 2)
        if gain.sum() < max(_CLEAR_SE * np.std(gain) * math.sqrt(len(gain)), _MIN_GAIN * len(best)):
            break
        found[k] = what
        change = changed
        now = best
    if not found:
        return found, ""
    named = np.isin(joint, list(found))
    shares = [np.linalg.norm(left[named]) / np.linalg.norm(torque[used][named]) for left in (first, now)]
    wrong = " and ".join(f"{what} of {arm.names[k]}" for k, what in found.items())
    better = change[:, joints]
    better[0] *= options.gear or 1.0
    better[1] *= options.torque_constant or 1.0
    better[2] += 0.0 if zero is None else zero[joints]
    accepted = ""
    for name, values, differs in zip(_OPTIONS, better.round(6), change != usual, strict=True):
        if differs.any():
            accepted += f" --{name} {' '.join(f'{value:.6g}' for value in values)}"
    text = f"wrong {wrong}: {shares[0]:.1%} of the torque there are unexplained, after a change {shares[1]:.1%}"
    return found, f"{text}; accepted:{accepted}, there or in the signal map, or a payload or spring in the model"
