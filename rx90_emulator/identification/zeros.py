"""Whether the encoders' zeros agree with the URDF: the decision, its message, and the fits for slow motions.

With a wrong zero the model bends the arm at a wrong angle. Logs are off by quarter turns where URDF and encoder count
from different poses, and by some hundredths of a radian after a bad calibration. `find_zeros` tries quarter turns of
one joint and of two neighbours, then small errors by the torque's derivatives, and doubts the zeros whose change makes
the fit clearly better. A payload or a spring that the model lacks changes the torques in a similar way; the message
names this possibility, too.

It needs fits of the torque with other angles. Those for excitation runs, where the inertials are free, are in
excitation/checks.py. Those in this module fit gravity on sliding joints, with the URDF's inertials known to some 20 %:
a small error is an extra column. For an axis along gravity this derivative is 0, and an uncertain weight of a link can
compensate a small error; both show in the deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import pairwise, product
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import pinvh

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import JointRecord, block_means

_QUARTERS = (-0.5 * math.pi, 0.5 * math.pi, math.pi)  # rad, between zeros of URDF and encoder that count differently
_MIN_GAIN = 0.02  # minimal share of a joint's unexplained torque that a changed zero must explain
SMALLEST: Final = 0.01
"""Smallest error of a zero to report, rad: elasticity and rounded geometry cause less."""
_SIGNIFICANT_SD = 4.0  # standard deviations above which a small error is significant
_MAX_SMALL_ERROR = 0.4  # rad, up to which the derivative predicts the torque
ROUNDS: Final = 3
"""Rounds of reweighting, and of Gauss-Newton steps."""
_INERTIAL_PRIOR_SD = 0.2  # of a link's mass, first moment and inertia: standard deviation of the URDF's values
_MIN_LEVER = 0.05  # m; the centre of a link's mass is not known better than this times _INERTIAL_PRIOR_SD
_CHI2_DROP = 36.0  # by which a quarter turn must lower chi squared: six standard deviations
_ZERO_PRIOR_SD = 1.0  # rad, standard deviation of a zero without data
_UNINFORMATIVE_SHARE = 0.5  # of it, above which the torques do not determine a zero
_PRIORS = (1e-6, 1.0, 1.0 / _ZERO_PRIOR_SD)  # of columns of friction, of errors of inertials in their units, of zeros
_MAX_INSTANTS, _SCREENING_STRIDE = 400, 5  # instants that are fitted, and the share of them that screens most turns
_MEAN_S, _CLUSTER_S = 0.05, 1.0  # s over which a run is averaged, and within which its errors count as one
_SLIDING_SPEED = 0.02  # rad/s from which an element slides
_MIN_TORQUE_SD = 3e-3  # of the torque's RMS: stamps, gears and geometry allow no better determination
_DECAY_SHARES = (0.02, 0.15)  # decay of Stribeck-like columns over the fastest speed


@dataclass(frozen=True, eq=False)
class ZeroCheck:
    """The zeros that would explain the recorded torques better than the given ones.

    Attributes:
        names: n joints.
        zero: the given zeros, rad, shape (n,).
        error: of the zeros, rad, shape (n,); 0 where there is no evidence of an error.
        deviation: standard deviation of small errors, rad, shape (n,); 0 where it is not known, as for quarter turns.
        identifiable: whether the torques determine an error of the joint's zero at all, shape (n,).
        before: RMS of the unexplained torque over the RMS torque, all joints together.
        after: the same with the better zeros.
        of: scope of these two where it is not the best fit of all joints, such as " of joint_3".
    """

    names: tuple[str, ...]
    zero: Array
    error: Array
    deviation: Array
    identifiable: Mask
    before: float
    after: float
    of: str = ""

    def of_joints(self, some: Mask) -> ZeroCheck:
        """Return the check of some of the joints, a mask of shape (n,)."""
        names = tuple(name for name, one in zip(self.names, some.tolist(), strict=True) if one)
        arrays = {name: getattr(self, name)[some] for name in ("zero", "error", "deviation", "identifiable")}
        return replace(self, names=names, **arrays)

    @property
    def text(self) -> str:
        """Return the finding in words; empty where nothing contradicts the zeros."""
        wrong = [
            f"{name} by {error:.4g}{f' +- {spread:.2g}' if spread else ''} rad"
            for name, error, spread in zip(self.names, self.error.tolist(), self.deviation.tolist(), strict=True)
            if error
        ]
        if not wrong:
            return ""
        better = (np.round(self.zero + self.error, 6) + 0.0).tolist()
        silent = [
            name for name, identifiable in zip(self.names, self.identifiable.tolist(), strict=True) if not identifiable
        ]
        unidentified = f"; the torques do not determine the zero of {', '.join(silent)}" if silent else ""
        return (
            f"zeros: {', '.join(wrong)} {'seem' if len(wrong) > 1 else 'seems'} to be off (unexplained torque"
            f"{self.of} {self.before:.1%} -> {self.after:.1%}), or the model lacks a payload or a spring: "
            f"try --zero {' '.join(f'{value:.6g}' for value in better)}{unidentified}"
        )


ResidualPower = Mapping[str, Array]
"""Mean square of each joint's residual torque, Nm^2, shape (n,), by what the fit holds fixed, in words.

The first entry, "", is the fit with all parameters free.
"""


class ZeroFits(Protocol):
    """Fits of recorded torques with the recorded angles of n joints increased by a shift, rad, shape (n,)."""

    @property
    def torque(self) -> Array:
        """Return the mean square of the torque of each joint, Nm^2, shape (n,)."""

    def residual_power(self, shift: Array) -> ResidualPower:
        """Return the mean square residual of fits with shifted angles."""

    def best(self, trials: list[Array], start: Array) -> Array:
        """Return the trial with the smallest residual, by the weights of the fit at `start`."""

    def clearly_better(self, shift: Array, than: Array) -> bool:
        """Return whether one shift explains more of the torque than another, by more than chance."""

    def small(self, start: Array) -> tuple[Array, Array]:
        """Return further small errors at a shift, by derivatives, and their standard deviations, rad, each (n,)."""

    def identifiable(self, deviation: Array) -> Mask:
        """Return the joints whose zero the torques determine, by the deviations of `small`, shape (n,)."""


def find_zeros(fits: ZeroFits, names: tuple[str, ...], zero: Array | None, joints: Mask) -> ZeroCheck:
    """Look for zeros that explain the torques clearly better.

    Args:
        fits: of the torque, with the zeros as they were given.
        names: n joints.
        zero: recorded angles in the zero pose of the URDF, rad, shape (n,); by default 0.
        joints: whose zeros may be wrong, shape (n,).
    """
    none, own = np.zeros(len(names)), np.flatnonzero(joints).tolist()
    quarter_shift = none
    for _ in own:
        single, double = quarter_turns(quarter_shift, own)
        best = fits.best(single, quarter_shift)
        if double and fits.clearly_better(two := fits.best(double, quarter_shift), best):
            best = two
        if not fits.clearly_better(best, quarter_shift):
            break
        quarter_shift = best
    small, deviation = fits.small(quarter_shift)
    significant = joints & is_error(small, deviation) & (np.abs(small) < _MAX_SMALL_ERROR)
    identifiable, known = fits.identifiable(deviation), np.where(significant, deviation, 0.0)
    check = ZeroCheck(names, none if zero is None else zero, none, known, identifiable, 0.0, 0.0)
    return check_of(check, quarter_shift + np.where(significant, small, 0.0), fits.residual_power, fits.torque)


def is_error(small: Array, deviation: Array) -> Mask:
    """Return which small errors are significant, and large enough to report, each shape (n,)."""
    return np.asarray(np.abs(small) > np.maximum(SMALLEST, _SIGNIFICANT_SD * deviation))


def check_of(
    check: ZeroCheck, shift: Array, residual_power: Callable[[Array], ResidualPower], torque: Array
) -> ZeroCheck:
    """Return the check with those angles that a fit needs, and the gain from them.

    An error may be many deviations large and still explain no relevant torque. Therefore angles are withdrawn one by
    one, the least useful first, until each remaining one lowers the unexplained torque of some joint by 2 %.

    Args:
        check: joints, zeros and deviations.
        shift: suspected angles, rad, shape (n,).
        residual_power: of fits with such angles.
        torque: mean square of the torque of each joint, Nm^2, shape (n,).
    """
    shift, none = shift.copy(), np.zeros(len(check.names))
    before, after = residual_power(none), residual_power(shift)
    while shift.any():
        others = {
            k: residual_power(np.where(np.arange(len(none)) == k, 0.0, shift)) for k in np.flatnonzero(shift).tolist()
        }
        gains = {k: _gain(other, after)[0] for k, other in others.items()}
        least = min(gains, key=lambda k: gains[k])
        if min(gains[least], _gain(before, after)[0]) >= _MIN_GAIN:
            break
        shift[least], after = 0.0, others[least]
    _, fit = _gain(before, after)
    pair, of = np.sqrt(np.stack([before[fit], after[fit]]) / max(float(torque.sum()), 1e-300)), fit
    both = np.linalg.norm(pair, axis=1)
    if shift.any() and f"{both[0]:.1%}" == f"{both[1]:.1%}":  # little of the arm's torque, but not of one joint's
        joint = int(np.argmin(pair[1] / np.maximum(pair[0], 1e-300)))
        both, of = pair[:, joint] * math.sqrt(float(torque.sum() / torque[joint])), f" of {check.names[joint]}{fit}"
    # Zeros are subtracted from the recorded angles: that of a joint whose angle is too small by the shift is too large.
    error = np.array([math.remainder(-value, 2.0 * math.pi) if value else 0.0 for value in shift.tolist()])
    return replace(check, error=error, before=float(both[0]), after=float(both[1]), of=of)


def _gain(before: ResidualPower, after: ResidualPower) -> tuple[float, str]:
    """Return the largest relative fall of a joint's RMS in a fit that worsens no total, and the scope of that fit.

    The fit with all parameters free must never become worse: zeros could hide an error of the inertials, such as a
    heavy payload.
    """
    if after[""].sum() >= before[""].sum():
        return 0.0, ""
    worse = {fit for fit in after if after[fit].sum() >= before[fit].sum()}
    falls = {fit: 1.0 - math.sqrt(float(np.min(after[fit] / np.maximum(before[fit], 1e-300))))
             for fit in after if fit not in worse}  # fmt: skip
    best = next((fit for fit, share in falls.items() if share >= _MIN_GAIN), "")
    return falls[best], best


def quarter_turns(start: Array, joints: Iterable[int]) -> tuple[list[Array], list[Array]]:
    """Return the angles with a quarter turn of one joint, and with turns of two neighbours, rad, each (n,).

    Opposite turns of neighbours leave the rest of the arm where it is, so either alone may be no better.
    """
    axes = dict(zip(joints, np.eye(len(start))[list(joints)], strict=True))
    single = [start + turn * axis for axis in axes.values() for turn in _QUARTERS]
    neighbours = [(axes[a], axes[b]) for a, b in pairwise(axes) if b == a + 1]
    double = [start + a * first + b * second for first, second in neighbours for a, b in product(_QUARTERS, repeat=2)]
    return single, double


@dataclass(frozen=True, eq=False)
class Instants:
    """Motion and torque of n joints at m instants.

    Attributes:
        position: rad, velocity: rad/s, acceleration: rad/s^2, and torque of the drives: Nm, each of shape (m, n).
        sliding: whether each friction element slides and does not stick, shape (m, n_el).
        plateau: number of the stretch within which errors are correlated, shape (m,).
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    sliding: Mask
    plateau: NDArray[np.int64]


def record_instants(record: JointRecord, arm: RigidArm) -> Instants:
    """Return means over short times of a run of any motion, by the arm of the same joints."""
    size = max(1, round(_MEAN_S / record.period))
    time, position, velocity, torque = (
        block_means(values, size) for values in (record.time, record.position, record.velocity, record.torque)
    )
    # Every sample of a mean has to slide, all of them in one direction.
    inputs = record.velocity @ arm.element_matrix.T
    fast, same_sign = block_means(np.abs(inputs) > _SLIDING_SPEED, size), block_means(np.sign(inputs), size)
    slides = (fast == 1.0) & (np.abs(same_sign) == 1.0)
    return Instants(
        position=position,
        velocity=velocity,
        acceleration=np.gradient(velocity, time, axis=0),
        torque=torque,
        sliding=slides,
        plateau=np.floor((time - time[0]) / _CLUSTER_S).astype(np.int64),
    )


def check_zeros(instants: Instants, arm: RigidArm, zero: Array | None = None) -> ZeroCheck:
    """Look for zeros that explain the torques clearly better.

    Args:
        instants: with the zeros as they were given.
        arm: rigid-body model with the inertials of the URDF.
        zero: recorded angles in the zero pose of the URDF, rad, shape (n,); by default 0.
    """
    stride = max(1, math.ceil(len(instants.torque) / _MAX_INSTANTS))
    fits = _SlidingFits(Instants(**{one.name: getattr(instants, one.name)[::stride] for one in fields(Instants)}), arm)
    return find_zeros(fits, arm.names, zero, arm.identified).of_joints(arm.identified)


class _Fit(NamedTuple):
    values: Array
    residual: Array  # Nm
    squares: float  # chi squared, the prior's included
    covariance: Array


class _SlidingFits:
    """Weighted fits of friction, errors of the inertials and errors of the zeros, with shifted angles."""

    def __init__(self, instants: Instants, arm: RigidArm) -> None:
        self._at, self._arm = instants, arm
        self._usable = (
            ~(~instants.sliding @ (arm.element_matrix != 0.0)) & arm.identified
        )  # joints on which no element sticks, (m, n)
        self._row, self._joint = np.nonzero(self._usable)
        self._cluster = np.unique(instants.plateau[self._row] * len(arm.names) + self._joint, return_inverse=True)[1]
        self._friction = _friction(instants.velocity, arm.element_matrix)[self._usable]
        self._inertial, self._known = arm.inertial, _uncertainty(arm)
        self._power = max(float(np.mean(instants.torque[self._usable] ** 2)) if len(self._row) else 0.0, 1e-300)
        self._cached_rigid, self._cached_weight = lru_cache(None)(self._rigid), lru_cache(None)(self._found_weight)

    @property
    def torque(self) -> Array:
        """Return the mean square of the torque of each joint where no element sticks, Nm^2, shape (n,)."""
        return self._mean_square(self._at.torque[self._usable])

    def residual_power(self, shift: Array) -> ResidualPower:
        """Return the mean square residual beside friction, with free inertials and with those of the description."""
        weight, target = self.weight(shift), self._cached_rigid(tuple(shift.tolist()), 1)[0]
        friction = self._friction * weight[:, None]
        described = target - self._friction @ np.linalg.lstsq(friction, target * weight, rcond=1e-10)[0]
        both = {"": self.fit(shift, weight).residual, " with the inertials of the description": described}
        return {fit: self._mean_square(values) for fit, values in both.items()}

    def _mean_square(self, values: Array) -> Array:
        return np.asarray(np.bincount(self._joint, values**2, len(self._arm.names)) / max(len(values), 1))

    def best(self, trials: list[Array], start: Array) -> Array:
        """Return the trial with the least chi squared, by the weights of the fit at `start`.

        Only trials that a part of the instants does not rule out are fitted to all instants.
        """
        weight, best, least = self.weight(start), start, math.inf
        at_least = [self.fit(shift, weight, every=_SCREENING_STRIDE).squares for shift in trials]
        for k in np.argsort(at_least).tolist():
            if at_least[k] < least and (squares := self.fit(trials[k], weight).squares) < least:
                best, least = trials[k], squares
        return best

    def clearly_better(self, shift: Array, than: Array) -> bool:
        """Return whether chi squared falls by six standard deviations, in units of the better fit's residual scatter.

        With wrong angles all of the misfit would count as noise.
        """
        weight = self.weight(shift)
        return self.fit(than, weight).squares - self.fit(shift, weight).squares > _CHI2_DROP

    def identifiable(self, deviation: Array) -> Mask:
        """Return the joints whose zero is known better with the torques than without."""
        return deviation < _UNINFORMATIVE_SHARE * _ZERO_PRIOR_SD

    def small(self, start: Array) -> tuple[Array, Array]:
        """Return small errors beside quarter turns and their standard deviations, rad, each shape (n,)."""
        shift, weight, count = np.zeros(len(start)), self.weight(start), len(start)
        for _ in range(ROUNDS):
            # The torque's derivatives by the angles, with the fitted inertials.
            first = self._friction.shape[1]
            inertial = self._inertial + self._known * self.fit(start + shift, weight).values[first:]
            motion = self._at.position + start + shift, self._at.velocity, self._at.acceleration
            slopes = self._arm.stiffness_of(inertial, *motion)[self._usable]
            found = self.fit(start + shift, weight, slopes, shift)
            shift = np.clip(shift + found.values[-count:], -1.0, 1.0)
            weight = self._weight_of(found.residual)
        return shift, np.sqrt(np.diag(found.covariance)[-count:])

    def weight(self, shift: Array) -> Array:
        """Return the weight of each row with shifted angles: weights and residuals of a fit, computed in turn."""
        return self._cached_weight(tuple(shift.tolist()))

    def _found_weight(self, shift: tuple[float, ...]) -> Array:
        weight = np.ones(len(self._joint))
        for _ in range(ROUNDS):
            weight = self._weight_of(self.fit(np.array(shift), weight).residual)
        return weight

    def _weight_of(self, residual_power: Array) -> Array:
        """Return the weight of each row: residual scatter, and Kish's factor for the correlation within stretches."""
        sums, joints = np.bincount(self._cluster, residual_power), len(self._arm.names)
        owner = np.zeros(len(sums), dtype=np.int64)
        owner[self._cluster] = self._joint
        squares, together = np.bincount(self._joint, residual_power**2, joints), np.bincount(owner, sums**2, joints)
        power = np.maximum(squares, together) / np.maximum(np.bincount(self._joint, minlength=joints), 1)
        return np.asarray(1.0 / np.sqrt(np.maximum(power, _MIN_TORQUE_SD**2 * self._power + 1e-18))[self._joint])

    def fit(
        self, shift: Array, weight: Array, slopes: Array | None = None, error: Array | None = None, every: int = 1
    ) -> _Fit:
        """Fit friction, inertials and, with the torque's slopes by the angles, zeros to every n-th instant."""
        chosen = self._row % every == 0
        target, regressor = self._cached_rigid(tuple(shift.tolist()), every)
        parts = [self._friction[chosen], regressor] if slopes is None else [self._friction[chosen], regressor, slopes]
        columns, prior = np.hstack(parts), np.repeat(_PRIORS[: len(parts)], [part.shape[1] for part in parts])
        prior_target = np.zeros(columns.shape[1])
        if error is not None:
            prior_target[-len(error) :] = -error / _ZERO_PRIOR_SD
        matrix = np.vstack([columns * weight[chosen][:, None], np.diag(prior)])
        right = np.concatenate([target * weight[chosen], prior_target])
        # In sweeps of one joint many columns are 0, and only their prior determines them.
        normal = matrix.T @ matrix
        scale, joined = 1.0 / np.sqrt(np.diag(normal)), np.flatnonzero(np.count_nonzero(normal, axis=1) > 1)
        covariance, some = np.eye(len(normal)), np.ix_(joined, joined)
        if len(joined):
            covariance[some] = pinvh((scale[:, None] * normal * scale)[some], rtol=1e-13)
        covariance = scale[:, None] * covariance * scale
        values = covariance @ (matrix.T @ right)
        residual = right - matrix @ values
        return _Fit(values, target - columns @ values, float(residual @ residual), covariance)

    def _rigid(self, shift: tuple[float, ...], every: int) -> tuple[Array, Array]:
        """Return the torque less the rigid arm's, Nm, and its derivatives by errors of the inertials in their units."""
        at, known = self._at, self._usable[::every]
        motion = at.position + np.array(shift), at.velocity, at.acceleration
        position, velocity, acceleration = (values[::every] for values in motion)
        regressor = self._arm.regressor(position, velocity, acceleration)
        torque = self._arm.torque_of(regressor, self._inertial, position, acceleration)
        return (at.torque[::every] - torque)[known], regressor[known] * self._known


def _friction(velocity: Array, elements: Array) -> Array:
    """Return columns that approximate any friction's torque at the joints, shape (m, n, 5 n_el)."""
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
        parts.append(_INERTIAL_PRIOR_SD * np.repeat([body.mass, body.mass * lever, inertia], [1, 3, 6]))
    return np.concatenate(parts)
