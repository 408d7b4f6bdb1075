"""Whether a log can be one of the described arm: gears and units, signs, zeros, swapped columns, delay of the torque.

A result with an alarm is at most "confirmed, but ...": a model with a mistake often predicts an unseen run well, for
that has the same mistake.

The simplest model (rigid body, Coulomb and viscous friction of 0 or more) is fitted to the motion and torque of a log,
and again with each usual mistake undone: a sign or a quarter turn of one motor, opposite quarter turns or swapped
columns of two, a delay of all torques. The mistake that clearly explains the torque better is named, and the search
goes on with it undone. Of mistakes that explain it equally well, as of an arm that moves like its mirror image, one is
named; a mistake that the rigid body compensates, such as the zero of a vertical first axis, is never found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from rx90_common.base.arrays import Array, Index, Mask, interpolated, rms
from rx90_common.base.quoting import listed
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.options import SHIPPED_ROBOT, RobotOptions
from rx90_emulator.identification.records import JointRecord, block_means, moving
from rx90_emulator.identification.rows.rigid import StandardColumns

_BAND_HZ = 5.0  # of the low-pass of motion and torque: arms move below it
_MOST_INSTANTS = 500  # evenly spread over all runs
_BLOCK_S = 2.0  # s, within which errors count as correlated
_SLOW_SPEED = 0.05  # rad/s, and a tenth of an element's usual speed: below both its torque is that of its bristles
LAGS = np.arange(-20, 21) * 5e-3
"""By how much the torque may be late, s."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """Motion and torque of n joints at m instants, through the same low-pass.

    Attributes:
        motion: position, velocity and acceleration, rad and s, shape (3, m, n).
        later: the torque that was recorded later by each of LAGS, or at once alone, Nm, shape (l, m, n).
        used: where no friction element that acts on the joint rests, shape (m, n).
        block: number of the stretch within which errors are correlated, shape (m,).
    """

    motion: Array
    later: Array
    used: Mask
    block: Index

    @classmethod
    def of(cls, records: Sequence[JointRecord], arm: RigidArm) -> Recorded:
        """Return the filtered motion and torque of some instants of records."""
        duration = sum(float(record.time[-1] - record.time[0]) for record in records)
        step = max(duration / _MOST_INSTANTS, 0.25 / _BAND_HZ)
        parts = [_filtered(record, step) for record in records]
        motion = np.concatenate([motion for motion, _ in parts], axis=1)
        later = np.concatenate([torque for _, torque in parts], axis=1)
        velocity = motion[1] @ arm.element_matrix.T
        usual = (
            np.quantile(np.abs(velocity), 0.9, axis=0)
            if len(velocity)
            else np.zeros(velocity.shape[1])
        )
        slow = (np.abs(velocity) < np.minimum(_SLOW_SPEED, 0.1 * usual)) | ~moving(velocity)
        used = ~(slow @ (arm.element_matrix != 0.0)) & arm.identified
        block = (np.arange(len(used)) * step / _BLOCK_S).astype(np.intp)
        return cls(motion, later, used, block)


def _filtered(record: JointRecord, step: float) -> tuple[Array, Array]:
    """Return the motion, (3, m, n), and the torque at all lags, (l, m, n), at instants that are `step` s apart."""
    size = max(1, round(1.0 / (40.0 * _BAND_HZ * max(record.period, 1e-9))))
    stamp = block_means(record.time, size)
    position = block_means(record.position, size)
    torque = block_means(record.torque, size)
    rate = 1.0 / max(size * record.period, 1e-9)
    band = min(_BAND_HZ, 0.1 * rate)
    margin = 1.0 / band + float(LAGS[-1])
    count = math.floor((record.time[-1] - record.time[0] - 2.0 * margin) / step)
    if count < 1:
        return np.empty((3, 0, position.shape[1])), np.empty((len(LAGS), 0, position.shape[1]))
    even = np.arange(stamp[0], stamp[-1], 1.0 / rate)
    series = interpolated(even, stamp, np.hstack([position, torque]))
    sections = butter(2, band, fs=rate, output="sos")
    curve = CubicSpline(even, sosfiltfilt(sections, series, axis=0))
    at = record.time[0] + margin + step * np.arange(count)
    at = at[np.interp(at, record.time[1:], np.diff(record.time)) < 4.0 * record.period]  # in no gap
    motion, _ = np.split(np.stack([curve(at, order) for order in range(3)]), 2, axis=2)
    return motion, np.split(np.stack([curve(at + lag) for lag in LAGS]), 2, axis=2)[1]


class Mistake(NamedTuple):
    """What may be wrong with the messages of one motor, of two or of all, by what undoes it.

    Attributes:
        quantity: in words.
        motors: indices.
        motion: factor of the positions.
        effort: factor of the efforts.
        turn: to be added to the zero of the joint, rad, and to be subtracted from that of the second one.
        swapped: whether positions, and whether efforts of the two are each other's.
        delay: by how much all torques are late, s.
    """

    quantity: str
    motors: tuple[int, ...] = ()
    motion: float = 1.0
    effort: float = 1.0
    turn: float = 0.0
    swapped: tuple[bool, bool] = (False, False)
    delay: float = 0.0

    @property
    def turns(self) -> Array:
        """Return what is to be added to the zero of each of the motors' joints, rad."""
        return self.turn * np.array([1.0, -1.0])[: len(self.motors)]

    def matrices(self, count: int) -> list[Array]:
        """Return right positions for given ones of so many motors, shape (n, n), and efforts likewise."""
        motors = list(self.motors)
        matrices = [np.eye(count), np.eye(count)]
        for matrix, sign, swapped in zip(
            matrices, (self.motion, self.effort), self.swapped, strict=True
        ):
            matrix[motors] = sign * matrix[motors[::-1] if swapped else motors]
        return matrices

    def text(self, names: Sequence[str]) -> str:
        """Return it in words."""
        if self.delay:
            return f"{self.quantity} by {1e3 * self.delay:.0f} ms"
        return f"{self.quantity} of {' and '.join(names[motor] for motor in self.motors)}"


def _mistakes(motors: Sequence[int]) -> Iterator[Mistake]:
    """Yield mistakes, the usual before the rare."""
    for motor in motors:
        yield Mistake("sign of the effort", (motor,), effort=-1.0)
        yield Mistake("sign of the gear", (motor,), motion=-1.0, effort=-1.0)
        yield Mistake("sign of the position", (motor,), motion=-1.0)
        for quarters in (-1, 1, 2):
            yield Mistake("zero", (motor,), turn=0.5 * math.pi * quarters)
    for pair in pairwise(motors):
        for quarters in (-1, 1):
            yield Mistake("zeros", pair, turn=0.5 * math.pi * quarters)
    for pair in combinations(motors, 2):
        yield Mistake("order of the columns", pair, swapped=(True, True))
        yield Mistake("order of the efforts", pair, swapped=(False, True))
        yield Mistake("order of the positions", pair, swapped=(True, False))


class _SimplestModel:
    """Rigid body, Coulomb and viscous friction at the used rows of a motion.

    Args:
        arm: n joints; its inertias are not used.
        motion: shape (3, m, n).
        used: shape (m, n).
        size: usual torque of each joint, which weighs its r rows, Nm, shape (n,).
    """

    def __init__(self, arm: RigidArm, motion: Array, used: Mask, size: Array) -> None:
        row, joint = np.nonzero(used)
        self._used = used
        self._weight = 1.0 / size[joint]
        rigid = StandardColumns(arm).torque(*motion)[used] * self._weight[:, None]
        length = np.linalg.norm(rigid, axis=0)
        directions, share, _ = np.linalg.svd(
            rigid[:, length > 0.0] / length[length > 0.0], full_matrices=False
        )
        self._basis = directions[:, share > 1e-6 * share[0]]
        velocity = motion[1] @ arm.element_matrix.T
        shares = np.tile(arm.element_matrix.T, 2)
        friction = np.hstack([np.sign(velocity), velocity])[row] * shares[joint]
        self._dry = self._beside(friction * self._weight[:, None])

    @property
    def parameters(self) -> int:
        """Return how many it has."""
        return len(self._basis.T) + len(self._dry.T)

    def residual(self, torque: Array) -> Array:
        """Return what a fit leaves of a torque, (m, n), in usual torques of the joints, shape (r,)."""
        left = self._beside(torque[self._used] * self._weight)
        return left - self._dry @ nnls(self._dry, left)[0]

    def _beside(self, values: Array) -> Array:
        return values - self._basis @ (self._basis.T @ values)


# what an undone mistake must explain: standard errors over blocks, and squared error as a share of what remains
_CLEAR_SE = 3.0
_MIN_GAIN = 0.4
_RARER = 0.05  # of the error's logarithm, that a mistake of two motors must explain beside one of a single motor
_ROWS_PER_PARAMETER = 8.0  # with 2 to 6, 7 % of right signs looked wrong, with more none


class _Trials:
    """The torque of a log as the simplest model explains it, with mistakes undone one after the other."""

    def __init__(self, arm: RigidArm, recorded: Recorded, options: RobotOptions) -> None:
        row, self._joint = np.nonzero(recorded.used)
        self._block = recorded.block[row]
        self._arm = arm
        self._used = recorded.used
        self.joints = np.flatnonzero(recorded.used.any(axis=0)).tolist()
        factors = np.ones((2, len(arm.names)))
        for factor, values in zip(factors, (options.gear, options.torque_constant), strict=True):
            factor[arm.identified] = 1.0 if values is None else values
        self._turns = factors[0][:, None] * arm.coupling
        self._push = self._turns.T * factors[1]
        # At each delay that can be tried, of which the middle one is none.
        self._take(recorded.motion, recorded.later)

    def _take(self, motion: Array, torques: Array) -> None:
        """Go on with a motion, and with torques at all delays."""
        self._motion = motion
        self._torques = torques
        self._size = self._usual(torques)
        self.model = self._fitted(motion)
        self.residual = self.model.residual(torques[len(torques) // 2])

    def undo(self, joints: Sequence[int]) -> Mistake | None:
        """Undo the mistake that explains the torque best, and return it, if it does so clearly."""
        delays = LAGS if len(self._torques) == len(LAGS) else LAGS[:0]
        mistakes = [
            *(Mistake("delay of the torques", delay=float(lag)) for lag in delays),
            *_mistakes(joints),
        ]
        trials = [(mistake, *self._without(mistake)) for mistake in mistakes]

        def unlikelihood(trial: tuple[Mistake, Array, Array, Array]) -> float:
            errors = round(float(np.log(self._errors(trial[-1])).mean()), 3)
            return errors + _RARER if len(trial[0].motors) > 1 else errors

        # Of mistakes that explain it equally well, the first.
        best = min(trials, key=unlikelihood, default=None)
        if best is None or not self._clear(best[-1]):
            return None
        mistake, motion, torques, _ = best
        self._take(motion, torques)
        return mistake

    @property
    def unexplained(self) -> float:
        """Return the RMS of the residual, each joint's in parts of its own torque."""
        return rms(self.residual)

    def _without(self, mistake: Mistake) -> tuple[Array, Array, Array]:
        """Return motion, torques and what the model leaves of them with a mistake undone."""
        positions, efforts = mistake.matrices(len(self._turns))
        torques = self._torques @ np.linalg.solve(self._push.T, efforts.T @ self._push.T)
        if mistake.delay:
            torques = torques[[int(np.argmin(np.abs(LAGS - mistake.delay)))]]
        motion = self._motion
        model = self.model
        if mistake.turn or (positions != np.eye(len(positions))).any():
            motion = motion @ np.linalg.solve(self._turns, positions @ self._turns).T
            motion[0][:, list(mistake.motors)] -= mistake.turns
            model = self._fitted(motion)
        residual = model.residual(torques[len(torques) // 2])
        # a joint that rests has little torque, of which any model leaves little
        if mistake.swapped[1]:
            residual = residual * np.maximum(self._size / self._usual(torques), 1.0)[self._joint]
        return motion, torques, residual

    def _usual(self, torques: Array) -> Array:
        """Return the RMS of the torque of no delay at each joint where it is used, Nm, shape (n,)."""
        used = self._used | ~self._used.any(axis=0)
        return np.asarray(
            np.sqrt(np.mean(torques[len(torques) // 2] ** 2, axis=0, where=used)) + 1e-9
        )

    def _clear(self, residual: Array) -> bool:
        """Return whether a residual is clearly less than the one now: in sum, or in nearly all blocks."""
        errors = self._errors(residual)
        rows = np.bincount(self._block)
        whole = rows > 0.5 * rows.mean()
        now = np.bincount(self._block, (self.residual / errors) ** 2)[whole] + 1e-9
        then = np.bincount(self._block, (residual / errors) ** 2)[whole] + 1e-9
        falls = np.array([now - then, np.log(now / then)])
        clear = falls.mean(axis=1) > _CLEAR_SE * falls.std(axis=1) / math.sqrt(len(now))
        gain = np.sum((self.residual**2 - residual**2) / errors**2)
        return bool(clear.any() and gain > _MIN_GAIN * len(residual))

    def _fitted(self, motion: Array) -> _SimplestModel:
        return _SimplestModel(self._arm, motion, self._used, self._size)

    def _errors(self, residual: Array) -> Array:
        """Return the RMS of the residual of each row's joint, shape (r,)."""
        squares = np.bincount(self._joint, residual**2) / np.maximum(np.bincount(self._joint), 1)
        return np.sqrt(squares)[self._joint] + 1e-9


def find_mistakes(
    arm: RigidArm, recorded: Recorded, options: RobotOptions = SHIPPED_ROBOT
) -> tuple[list[Mistake], str]:
    """Return the mistakes that clearly explain a log better, and in words how much better; none of a short log.

    Args:
        arm: of the same joints.
        recorded: as the options say.
        options: the given gears and torque constants.
    """
    mistakes: list[Mistake] = []
    if not recorded.used.any():
        return mistakes, ""
    trials = _Trials(arm, recorded, options)
    if np.count_nonzero(recorded.used) < _ROWS_PER_PARAMETER * trials.model.parameters:
        return mistakes, ""
    before = trials.unexplained
    unnamed = trials.joints
    while mistake := trials.undo(unnamed):
        mistakes.append(mistake)
        unnamed = [joint for joint in unnamed if joint not in mistake.motors]
    return (
        mistakes,
        f"{before:.1%} of the torques are unexplained, with this undone {trials.unexplained:.1%}",
    )


def mistake_alarms(
    arm: RigidArm,
    recorded: Recorded,
    options: RobotOptions = SHIPPED_ROBOT,
    zero: Array | None = None,
) -> tuple[str, ...]:
    """Return in a sentence which mistakes `find_mistakes` finds, and what to write instead.

    Args:
        arm: of the same joints.
        recorded: as the options say.
        options: the given gears and torque constants.
        zero: the given zeros, rad, shape (n,); by default 0.
    """
    mistakes, gain = find_mistakes(arm, recorded, options)
    if not mistakes:
        return ()
    joints = np.flatnonzero(arm.identified).tolist()
    gear = np.array(options.gear or np.ones(len(joints)))
    constant = np.array(options.torque_constant or np.ones(len(joints)))
    zeros = np.zeros(len(joints)) if zero is None else zero[joints].copy()
    accepted = []
    for mistake in mistakes:
        motors = [joints.index(motor) for motor in mistake.motors]
        gear[motors] *= mistake.motion
        constant[motors] *= mistake.motion * mistake.effort
        zeros[motors] += mistake.turns
        if any(mistake.swapped):
            accepted.append("names or columns of these two in the other order")
        if mistake.delay:
            accepted.append(
                f"torque_delay: {options.torque_delay - mistake.delay:.3g} in the signal map"
            )
    if any(mistake.motion < 0.0 for mistake in mistakes):
        accepted.append(_option("gear", gear))
    if any(mistake.motion * mistake.effort < 0.0 for mistake in mistakes):
        accepted.append(_option("torque-constant", constant))
    if any(mistake.turn for mistake in mistakes):
        accepted.append(_option("zero", zeros.round(6) + 0.0))
    wrong = " and ".join(mistake.text(arm.names) for mistake in mistakes)
    accepted.append("there or in the signal map, or a payload or spring in the model")
    return (f"wrong {wrong}: {gain}; accepted: {', '.join(accepted)}",)


def _option(name: str, values: Array) -> str:
    return f"--{name} {' '.join(f'{value:.6g}' for value in values)}"


_FAR_SCALE = 10.0  # of torques, or less than one over it: units are 1000 off, forgotten gears 30 to 300, masses less
_TOLD_SHARE = 0.3  # of a scale: three standard errors up to which it is told


def torque_scales(arm: RigidArm, recorded: Recorded) -> dict[str, float]:
    """Return by joint how many times the torque that the described bodies need was recorded; 1 for the described arm.

    It is the slope of the recorded over the described torque, beside an offset, Coulomb and viscous friction. NaN where
    what the bodies need varies too little to tell, such as the weight on a vertical axis.

    Args:
        arm: with the description's inertias.
        recorded: of its joints.
    """
    described = arm.torque(*recorded.motion)
    velocity = recorded.motion[1] @ arm.element_matrix.T
    scales = {}
    for joint, name in enumerate(arm.names):
        rows = np.flatnonzero(recorded.used[:, joint])
        inputs = velocity[rows][:, arm.element_matrix[:, joint] != 0.0]
        beside = np.hstack([np.ones((len(rows), 1)), np.sign(inputs), inputs])
        both = np.column_stack(
            [described[rows, joint], recorded.later[len(recorded.later) // 2, rows, joint]]
        )
        needed, given = (both - beside @ np.linalg.lstsq(beside, both, rcond=None)[0]).T
        size = needed @ needed + 1e-12
        scale = needed @ given / size
        errors = np.bincount(recorded.block[rows], needed * (given - scale * needed))
        told = _CLEAR_SE * np.linalg.norm(errors) / size < _TOLD_SHARE * abs(scale)
        many = len(rows) > _ROWS_PER_PARAMETER * len(beside.T)
        scales[name] = scale if told and many else math.nan
    return scales


def scale_alarms(scales: Mapping[str, float]) -> tuple[str, ...]:
    """Return in a sentence that torques are far less, or more, than the described bodies need, of most joints."""
    sizes = {name: abs(scale) for name, scale in scales.items() if not math.isnan(scale)}
    # A gear or a unit is wrong at all joints or at none; a single effort may be dead.
    far = _far(sizes, _FAR_SCALE)
    if not far:
        return ()
    times = ", ".join(f"{sizes[name]:.2g}" for name in far)
    return (
        f"the torque of {listed(far)} is {times} times what the described bodies need; accepted: --gear for states of "
        "the motors, --torque-constant with the gears' ratios for torques of the motors beside angles of the joints, "
        "efforts in Nm, or a description of this arm",
    )


def _far(ratios: Mapping[str, float], most: float) -> list[str]:
    """Return the joints whose ratios are above the most, or below one over it, if they are more than half of all."""
    for power in (1.0, -1.0):
        far = [name for name, ratio in ratios.items() if ratio > 0.0 and ratio**power > most]
        if 2 * len(far) > len(ratios):
            return far
    return []


class MovedBodies(NamedTuple):
    """What a joint moves: each pair by the description and by the result.

    Attributes:
        joint: its name.
        mass: kg.
        moment: mass times distance of its centre from the axis, in the zero pose, kg m.
        inertia: about the axis, in the zero pose, rotor included, kg m^2.
    """

    joint: str
    mass: tuple[float, float]
    moment: tuple[float, float]
    inertia: tuple[float, float]


def moved_bodies(described: RigidArm, result: RigidArm) -> tuple[MovedBodies, ...]:
    """Return what each joint moves by the description and by the result."""
    joints = np.stack([_moved(described), _moved(result)]).transpose(2, 1, 0)
    named = zip(described.names, joints.tolist(), strict=True)
    return tuple(MovedBodies(name, *map(tuple, pairs)) for name, pairs in named)


def _moved(arm: RigidArm) -> Array:
    """Return mass, first moment and inertia of what each joint moves, shape (3, n)."""
    model = arm.model
    data = model.createData()
    zero = pin.neutral(model)
    pin.centerOfMass(model, data, zero)
    mass = np.array(data.mass)[1:]
    inertia = np.diag(pin.crba(model, data, zero) + arm.rotor)
    axes = pin.computeJointJacobians(model, data, zero)[3:].T
    frames = list(data.oMi)[1:]
    centres = [
        frame.rotation @ centre for frame, centre in zip(frames, list(data.com)[1:], strict=True)
    ]
    return np.stack([mass, mass * np.linalg.norm(np.cross(axes, centres), axis=1), inertia])


_MASS_RATIO = 4.0  # of what a joint moves by the result to the described


def body_alarms(bodies: Sequence[MovedBodies]) -> tuple[str, ...]:
    """Return in a sentence that most joints move far more, or far less, than described; a payload is at the last."""
    masses = {moved.joint: moved.mass for moved in bodies}
    ratios = {
        name: after / before if before > 0.0 else 1.0 for name, (before, after) in masses.items()
    }
    far = _far(ratios, _MASS_RATIO)
    if not far:
        return ()
    texts = [
        f"{name} {masses[name][1]:.3g} kg ({masses[name][0]:.3g} kg described)" for name in far
    ]
    payload = ", or, where all joints move as much more, its payload in the description"
    return (
        f"the bodies of the result are not the described ones: {', '.join(texts)}; accepted: gears, units and torque "
        f"constants with which they agree, or a description of this arm{payload if ratios[far[0]] > 1.0 else ''}",
    )


def log_alarms(records: Mapping[str, Sequence[JointRecord]]) -> tuple[str, ...]:
    """Return what was mended in the reading of records, by use, a sentence each."""
    return tuple(alarm for logs in records.values() for record in logs for alarm in record.alarms)


def alarms(
    arm: RigidArm,
    recorded: Recorded,
    options: RobotOptions = SHIPPED_ROBOT,
    zero: Array | None = None,
    scales: Mapping[str, float] | None = None,
) -> tuple[str, ...]:
    """Return what clearly looks wrong in a log, a sentence each; arguments as in `mistake_alarms`.

    Where gears are forgotten, no body explains the torques of two joints, and nothing else can be told.
    The scales are those of `torque_scales`, where they are at hand.
    """
    scales = torque_scales(arm, recorded) if scales is None else scales
    return scale_alarms(scales) or mistake_alarms(arm, recorded, options, zero)
