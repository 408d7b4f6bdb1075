"""Whether the encoders' zeros are those of the URDF, by what gravity asks of the joints that slide.

A wrong zero bends the arm in the wrong place. With the URDF's inertials as known within some 20 %, the torques tell:
quarter turns are tried one joint and two neighbours at a time, and small errors are an extra column, the torque's
derivative by the angle. An axis along gravity has no such derivative, and a link whose weight is uncertain makes good
for a small error; both show in the deviation. A payload or a spring that the model lacks asks for other torques, as a
wrong zero does; the message names it, too.

The quarter turns, what is found and the option that helps are shared with the search in excitation runs, where the
inertials are free (excitation/checks.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import pinvh

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import JointRecord

QUARTERS: Final = (-0.5 * math.pi, 0.5 * math.pi, math.pi)
"""Turns by which the zeros of URDF and encoder differ where they count from other poses, rad."""
SMALLEST: Final = 0.01
"""Error of a zero that counts, rad: elasticity and rounded geometry pass for less."""
STEP: Final = 1e-4
"""Of differences by an angle, rad."""
_INERTIAL_PRIOR_SD = 0.2  # of a link's mass, first moment and inertia: standard deviation of the URDF's values
_MIN_LEVER = 0.05  # m: distance of a link's centre of mass that is not known better than this, times _INERTIAL_PRIOR_SD
_CHI2_DROP = 36.0  # by which a quarter turn must lower chi squared: six standard deviations
_SIGNIFICANT_SD = 5.0  # standard deviations from which a small error is one
_MAX_SMALL_ERROR = 0.4  # rad: up to which the derivative is good for the torque
_ZERO_PRIOR_SD = 1.0  # rad, standard deviation of a zero of which nothing is known
_UNINFORMATIVE_SHARE = 0.5  # of it, from which the torques tell nothing of a zero
_ROUNDS = 3  # of weights, and of Gauss and Newton
_MAX_INSTANTS, _SCREENING_STRIDE = 400, 5  # instants that are looked at, and which of them rule out most turns
_MEAN_S, _CLUSTER_S = 0.05, 1.0  # s over which a run is averaged, and within which its errors are taken as one
_SLIDING_SPEED = 0.02  # rad/s from which an element slides
_MIN_TORQUE_SD = 3e-3  # of the torque's RMS: no joint is told better, for stamps, gears and geometry are not
_DECAY_SHARES = (0.02, 0.15)  # decay of Stribeck-like columns over the fastest speed


@dataclass(frozen=True, eq=False)
class ZeroCheck:
    """Which zeros would explain the recorded torques better than those given.

    Attributes:
        names: n joints.
        zero: that were used, rad, shape (n,).
        error: of them, rad, shape (n,): 0 where nothing speaks against one.
        deviation: standard deviation of small errors, rad, shape (n,); 0 where it is not known, as of quarter turns.
        told: whether the torques tell an error of the joint's zero at all, shape (n,).
        before: RMS of the torque that is left, over that of the torque, all joints together.
        after: the same with the better zeros.
    """

    names: tuple[str, ...]
    zero: Array
    error: Array
    deviation: Array
    told: Mask
    before: float
    after: float

    @property
    def text(self) -> str:
        """Return it in words; empty where nothing speaks against the zeros."""
        wrong = [
            f"{name} by {error:.4g}{f' +- {spread:.2g}' if spread else ''} rad"
            for name, error, spread in zip(self.names, self.error.tolist(), self.deviation.tolist(), strict=True)
            if error
        ]
        if not wrong:
            return ""
        better = (np.round(self.zero + self.error, 6) + 0.0).tolist()
        silent = [name for name, told in zip(self.names, self.told.tolist(), strict=True) if not told]
        rest = f"; the torques do not tell the zero of {', '.join(silent)}" if silent else ""
        return (
            f"zeros: {', '.join(wrong)} {'seem' if len(wrong) > 1 else 'seems'} to be off (unexplained torque "
            f"{self.before:.1%} -> {self.after:.1%}), or the model lacks a payload or a spring: "
            f"try --zero {' '.join(f'{value:.6g}' for value in better)}{rest}"
        )


def encoder_error(shift: Array) -> Array:
    """Return the errors of zeros, within half a turn, for joints that stand further on than assumed by `shift`, rad.

    Recorded angles lose the zero, so that a joint which stands a further on has a zero that is a less.
    """
    return np.array([math.remainder(-value, 2.0 * math.pi) if value else 0.0 for value in shift.tolist()])


def quarter_turns(start: Array, joints: Iterable[int]) -> tuple[list[Array], list[Array]]:
    """Return the angles with a quarter turn of one of some joints, and with turns of two neighbours, rad, each (n,).

    Opposite turns of neighbours leave the rest of the arm where it is: either alone may be no better.
    """
    axes = dict(zip(joints, np.eye(len(start))[list(joints)], strict=True))
    single = [start + turn * axis for axis in axes.values() for turn in QUARTERS]
    neighbours = [(axes[a], axes[b]) for a, b in pairwise(axes) if b == a + 1]
    double = [start + a * first + b * second for first, second in neighbours for a, b in product(QUARTERS, repeat=2)]
    return single, double


@dataclass(frozen=True, eq=False)
class Instants:
    """Motion and torque of n joints at m instants.

    Attributes:
        position: rad, velocity: rad/s, acceleration: rad/s^2, and torque of the drives: Nm, each of shape (m, n).
        known: joints on which no element acts that sticks or may stick, shape (m, n).
        block: number of the stretch whose errors hang together, shape (m,).
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    known: Mask
    block: NDArray[np.int64]


def record_instants(record: JointRecord, arm: RigidArm) -> Instants:
    """Return means over short times of a run of any motion.

    Args:
        record: the run.
        arm: of the same joints.
    """
    size = max(1, round(_MEAN_S / float(np.median(np.diff(record.time)))))
    count = len(record.time) // size

    def parts(values: Array) -> Array:
        return values[: count * size].reshape(count, size, -1)

    time = parts(record.time)[:, :, 0].mean(axis=1)
    velocity = parts(record.velocity).mean(axis=1)
    inputs = parts(record.velocity @ arm.element_matrix.T)
    slides = np.abs(inputs).min(axis=1) > _SLIDING_SPEED
    slides &= np.abs(np.sign(inputs).sum(axis=1)) == size
    return Instants(
        position=parts(record.position).mean(axis=1),
        velocity=velocity,
        acceleration=np.gradient(velocity, time, axis=0),
        torque=parts(record.torque).mean(axis=1),
        known=known_joints(slides, arm.element_matrix),
        block=np.floor((time - time[0]) / _CLUSTER_S).astype(np.int64),
    )


def known_joints(sliding: Mask, elements: Array) -> Mask:
    """Return the joints on which only elements act that slide, shape (m, n), of which elements slide, (m, n_el)."""
    return np.asarray(~(~sliding @ (elements != 0.0)))


def check_zeros(instants: Instants, arm: RigidArm, zero: Array | None = None) -> ZeroCheck:
    """Look for zeros that explain the torques clearly better.

    Args:
        instants: with the zeros as they were given.
        arm: rigid-body model with the inertials of the URDF.
        zero: recorded angles where those of the URDF are 0, rad, shape (n,); by default 0.
    """
    n = len(arm.names)
    stride = max(1, math.ceil(len(instants.torque) / _MAX_INSTANTS))
    search = _Search(replace(instants, **{name: values[::stride] for name, values in vars(instants).items()}), arm)
    shift = np.zeros(n)
    for _ in range(n):
        found = search.quarter_turned(shift)
        if found is None:
            break
        shift = found
    small, deviation = search.small(shift)
    sure = (np.abs(small) > np.maximum(SMALLEST, _SIGNIFICANT_SD * deviation)) & (np.abs(small) < _MAX_SMALL_ERROR)
    better = shift + np.where(sure, small, 0.0)
    usual = math.sqrt(max(search.power, 1e-300))
    before, after = search.left(np.zeros(n)), search.left(better)
    if after >= before:  # the zeros only spare the inertials an error, as that of a heavy payload
        better, after = np.zeros(n), before
    return ZeroCheck(
        arm.names,
        np.zeros(n) if zero is None else zero,
        encoder_error(better),
        deviation,
        deviation < _UNINFORMATIVE_SHARE * _ZERO_PRIOR_SD,
        before / usual,
        after / usual,
    )


class _Search:
    """Weighted fits of friction, errors of the inertials and of the zeros, with other angles."""

    def __init__(self, instants: Instants, arm: RigidArm) -> None:
        self._at, self._arm = instants, arm
        self._seen: dict[tuple[bytes, int], tuple[Array, Array]] = {}
        self._weights: dict[bytes, Array] = {}
        self._rows = np.nonzero(instants.known)
        self._joint = self._rows[1]
        self._cluster = np.unique(instants.block[self._rows[0]] * len(arm.names) + self._joint, return_inverse=True)[1]
        self._friction = _friction(instants.velocity, arm.element_matrix)[self._rows]
        self._inertial, self._known = arm.inertial, _uncertainty(arm)
        torque = instants.torque[self._rows]
        self.power = float(np.mean(torque**2)) if len(torque) else 0.0

    def left(self, shift: Array) -> float:
        """Return the RMS of the torque that friction and inertials do not explain, Nm."""
        residual = self._fit(shift, self._weight(shift))[1]
        return float(np.sqrt(np.mean(residual**2))) if len(residual) else 0.0

    def quarter_turned(self, start: Array) -> Array | None:
        """Return the angles with the quarter turn of a joint that explains the torques clearly better; None without."""
        weight = self._weight(start)
        for trials in quarter_turns(start, range(len(start))):
            best = self._best(trials, weight) if trials else start
            # By the scatter that the better one leaves: with wrong angles all of it passes for noise.
            sharp = self._weight(best)
            if self._fit(start, sharp)[2] - self._fit(best, sharp)[2] > _CHI2_DROP:
                return best
        return None

    def _best(self, trials: list[Array], weight: Array) -> Array:
        """Return the angles with the least chi squared.

        Fitted to all instants are only those that some of them do not rule out: the least squares of some equations are
        never more than those of all.
        """
        at_least = [self._fit(shift, weight, every=_SCREENING_STRIDE)[2] for shift in trials]
        best, least = trials[0], math.inf
        for k in np.argsort(at_least).tolist():
            if at_least[k] >= least:
                break
            squares = self._fit(trials[k], weight)[2]
            if squares < least:
                best, least = trials[k], squares
        return best

    def small(self, start: Array) -> tuple[Array, Array]:
        """Return small errors beside quarter turns and their standard deviations, rad, each shape (n,)."""
        shift, weight = np.zeros(len(start)), self._weight(start)
        deviation = np.full(len(start), _ZERO_PRIOR_SD)
        for _ in range(_ROUNDS):
            # The torque's derivatives by the angles, with the inertials that fit.
            first = self._friction.shape[1]
            inertial = self._inertial + self._known * self._fit(start + shift, weight)[0][first:]
            motion = self._at.position + start + shift, self._at.velocity, self._at.acceleration
            slopes = self._arm.stiffness_of(inertial, *motion)[self._rows]
            values, residual, _, covariance = self._fit(start + shift, weight, slopes, shift)
            shift = np.clip(shift + values[-len(start) :], -1.0, 1.0)
            deviation = np.sqrt(np.diag(covariance)[-len(start) :])
            weight = self._weight_of(residual)
        return shift, deviation

    def _weight(self, shift: Array) -> Array:
        """Return the weight of each row with these angles, by the residuals of a fit and these by the weights."""
        key = (shift + 0.0).tobytes()
        if key not in self._weights:
            weight = np.ones(len(self._joint))
            for _ in range(_ROUNDS):
                weight = self._weight_of(self._fit(shift, weight)[1])
            self._weights[key] = weight
        return self._weights[key]

    def _weight_of(self, left: Array) -> Array:
        """Return the weight of each row by the residuals' scatter and Kish's factor for stretches that err together."""
        sums, joints = np.bincount(self._cluster, left), len(self._arm.names)
        owner = np.zeros(len(sums), dtype=np.int64)
        owner[self._cluster] = self._joint
        squares = np.bincount(self._joint, left**2, joints)
        together = np.bincount(owner, sums**2, joints)
        count = np.bincount(self._joint, minlength=joints)
        power = np.maximum(squares, together) / np.maximum(count, 1)
        return np.asarray(1.0 / np.sqrt(np.maximum(power, _MIN_TORQUE_SD**2 * self.power + 1e-18))[self._joint])

    def _fit(
        self, shift: Array, weight: Array, slopes: Array | None = None, error: Array | None = None, every: int = 1
    ) -> tuple[Array, Array, float, Array]:
        """Return values, residual in Nm, chi squared with the prior's, and covariance; from all instants or fewer."""
        kept = self._rows[0] % every == 0
        target, regressor = self._rigid(shift, every)
        zeros = np.zeros((len(target), 0)) if slopes is None else slopes
        columns = np.hstack([self._friction[kept], regressor, zeros])
        first, size = self._friction.shape[1], columns.shape[1]
        prior = np.r_[np.full(first, 1e-6), np.ones(regressor.shape[1]), np.full(zeros.shape[1], 1.0 / _ZERO_PRIOR_SD)]
        wanted = np.zeros(size)
        if error is not None:
            wanted[-len(error) :] = -error / _ZERO_PRIOR_SD
        matrix = np.vstack([columns * weight[kept][:, None], np.diag(prior)])
        right = np.concatenate([target * weight[kept], wanted])
        covariance = _inverse(matrix.T @ matrix)
        values = covariance @ (matrix.T @ right)
        left = right - matrix @ values
        return values, target - columns @ values, float(left @ left), covariance

    def _rigid(self, shift: Array, every: int) -> tuple[Array, Array]:
        """Return the torque less the rigid arm's, Nm, and its derivatives by errors of the inertials in their units."""
        key = (shift + 0.0).tobytes(), every
        if key not in self._seen:
            known = self._at.known[::every]
            motion = self._at.position + shift, self._at.velocity, self._at.acceleration
            position, velocity, acceleration = (values[::every] for values in motion)
            regressor = self._arm.regressor(position, velocity, acceleration)
            torque = self._arm.torque_of(regressor, self._inertial, position, acceleration)
            self._seen[key] = (self._at.torque[::every] - torque)[known], regressor[known] * self._known
        return self._seen[key]


def _inverse(normal: Array) -> Array:
    """Return the pseudo-inverse; in sweeps of one joint many columns are 0, and their prior stands alone."""
    scale = 1.0 / np.sqrt(np.diag(normal))
    inverse, scaled = np.eye(len(normal)), scale[:, None] * normal * scale
    joined = np.flatnonzero(np.count_nonzero(normal, axis=1) > 1)
    if len(joined):
        inverse[np.ix_(joined, joined)] = pinvh(scaled[np.ix_(joined, joined)], rtol=1e-13)
    return np.asarray(scale[:, None] * inverse * scale)


def _friction(velocity: Array, elements: Array) -> Array:
    """Return columns that any friction's torque at the joints is nearly made of, shape (m, n, 5 n_el)."""
    inputs = velocity @ elements.T
    fastest = np.maximum(np.abs(inputs).max(axis=0), 1e-9)
    shapes = [1.0 * (inputs > 0.0), 1.0 * (inputs < 0.0), inputs / fastest]
    shapes += [np.sign(inputs) * np.exp(-np.abs(inputs) / (share * fastest)) for share in _DECAY_SHARES]
    return np.concatenate([shape[:, None, :] * elements.T for shape in shapes], axis=2)


def _uncertainty(arm: RigidArm) -> Array:
    """Return the standard deviations of the URDF's inertial parameters, shape (10 n,), SI units."""
    parts = []
    for body in list(arm.model.inertias)[1:]:
        lever = math.hypot(float(np.linalg.norm(body.lever)), _MIN_LEVER)
        inertia = float(np.trace(np.asarray(body.inertia))) + body.mass * lever**2
        parts.append(_INERTIAL_PRIOR_SD * np.r_[body.mass, np.full(3, body.mass * lever), np.full(6, inertia)])
    return np.concatenate(parts)
