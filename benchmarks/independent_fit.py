"""A plain fit of rigid body and friction, beside which `identification_guards` holds what the commands find.

NumPy, SciPy's filters and Pinocchio's regressor; nothing of the code under test. Links, rotors, offsets, Coulomb and
viscous torque of each element are linear; torque and columns pass the same zero-phase low-pass; each joint has the
weight of its residuals, with Huber's weights; rows count from 0.05 rad/s on; deviations come from leaving out one of
twenty blocks of time (jackknife). No torque is bounded: friction may fall with speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline
from scipy.linalg import qr
from scipy.signal import butter, sosfiltfilt

from rx90_common.base.arrays import Array

LEAST_SPEED = 0.05
"""rad/s below which a row is left out: an element may stick there."""
RESTING_SHARE = 0.9
"""Of the rows that are slow, from which an element trembles with the others and rests."""
BLOCKS = 20
_HUBER = 1.345
_STEPS = 20
_RANK = 1e-6
_OVERSAMPLING = 5.0
"""Rows per second that are kept, in parts of the torque's corner."""


@dataclass(frozen=True, eq=False)
class Log:
    """Positions, rad, and torques, Nm, of n joints at stamps, s, of shape (m,); (m, n) each."""

    time: Array
    position: Array
    torque: Array

    def evenly(self) -> Log:
        """Return the log at even times, through splines: stamps may jitter."""
        rising = np.append(True, np.diff(self.time) > 0.0)
        time = np.linspace(self.time[0], self.time[-1], int(rising.sum()))
        values = CubicSpline(
            self.time[rising], np.stack([self.position[rising], self.torque[rising]], axis=1)
        )(time)
        return Log(time, values[:, 0], values[:, 1])


@dataclass(frozen=True, eq=False)
class PlainArm:
    """What the fit knows of an arm.

    Attributes:
        model: Pinocchio's, of which only the kinematics count.
        coupling: motor turns for joint turns without the gears, shape (n, n).
        corner: of the positions' low-pass, Hz; torques and columns get `torque_corner`.
        torque_corner: Hz.
    """

    model: Any
    coupling: Array
    corner: float
    torque_corner: float

    @classmethod
    def of(
        cls,
        urdf: str,
        joints: Sequence[str],
        corners: tuple[float, float],
        coupling: Array | None = None,
    ) -> PlainArm:
        """Read a description; joints that are not named are held at 0."""
        whole = pin.buildModelFromUrdf(urdf)
        held = [number for number, name in enumerate(whole.names) if number and name not in joints]
        model = pin.buildReducedModel(whole, held, pin.neutral(whole))
        return cls(model, np.eye(len(joints)) if coupling is None else coupling, *corners)

    @cached_property
    def element_matrix(self) -> Array:
        """Return joint speeds to element speeds: the joints, then each motor that turns with several."""
        n = len(self.coupling)
        coupled = [row for row in self.coupling if np.count_nonzero(row) > 1]
        return np.vstack([np.eye(n), *coupled])

    def motion(self, log: Log) -> tuple[float, Array]:
        """Return the rate of an even log, 1/s, and position, velocity and acceleration, shape (3, m, n)."""
        rate = 1.0 / (log.time[1] - log.time[0])
        smooth = butter(4, min(self.corner, 0.45 * rate), fs=rate, output="sos")
        position = sosfiltfilt(smooth, log.position, axis=0)
        velocity = np.gradient(position, 1.0 / rate, axis=0)
        return rate, np.stack([position, velocity, np.gradient(velocity, 1.0 / rate, axis=0)])

    def kept(self, values: Array, rate: float) -> Array:
        """Return filtered torques or columns, thinned, without the filter's ends."""
        low = butter(4, min(self.torque_corner, 0.45 * rate), fs=rate, output="sos")
        every = max(1, int(rate / (_OVERSAMPLING * self.torque_corner)))
        margin = max(1, int(rate / self.torque_corner / every))
        return np.asarray(sosfiltfilt(low, values, axis=0)[::every][margin:-margin])

    def rows(self, log: Log, known: Callable[[Array], Array] | None = None) -> Rows:
        """Return the filtered equations of a log.

        Args:
            log: of the joints.
            known: torques, Nm, (m, n), of a motion of shape (3, m, n), which become the only column.
        """
        log = log.evenly()
        rate, motion = self.motion(log)
        inputs = motion[1] @ self.element_matrix.T
        columns = self._columns(motion, inputs) if known is None else known(motion)[:, :, None]
        speed = self.kept(inputs, rate)
        rests = np.abs(speed) < LEAST_SPEED
        rests |= rests.mean(axis=0) > RESTING_SHARE
        moving = ~(rests @ (self.element_matrix != 0.0))
        return Rows(self.kept(columns, rate), self.kept(log.torque, rate), moving)

    def _columns(self, motion: Array, inputs: Array) -> Array:
        data = self.model.createData()
        links = [
            pin.computeJointTorqueRegressor(self.model, data, *row).copy()
            for row in motion.transpose(1, 0, 2)
        ]
        turning = np.einsum("mk,kj->mjk", motion[2] @ self.coupling.T, self.coupling)
        offset = np.broadcast_to(np.eye(len(self.coupling)), turning.shape)
        coulomb = np.einsum("mk,kj->mjk", np.sign(inputs), self.element_matrix)
        viscous = np.einsum("mk,kj->mjk", inputs, self.element_matrix)
        return np.concatenate([coulomb, viscous, offset, np.array(links), turning], axis=2)


@dataclass(frozen=True, eq=False)
class Rows:
    """Columns, shape (m, n, p), torques, Nm, and which count, shape (m, n)."""

    columns: Array
    torque: Array
    moving: Array

    def error(self, value: Array) -> float:
        """Return the RMS difference over the RMS torque of all joints together, of parameters of shape (p,)."""
        predicted = self.columns @ value
        left = np.where(self.moving, self.torque - predicted, 0.0)
        return float(np.linalg.norm(left) / np.linalg.norm(np.where(self.moving, self.torque, 0.0)))


@dataclass(frozen=True, eq=False)
class PlainFit:
    """Parameters, shape (p,), with deviations; Coulomb and viscous torques of the elements come first."""

    value: Array
    deviation: Array
    elements: int


def fit(arm: PlainArm, logs: Sequence[Log]) -> PlainFit:
    """Fit all logs together."""
    parts = [arm.rows(log) for log in logs]
    columns, torque, moving = (
        np.concatenate(values)
        for values in zip(*((p.columns, p.torque, p.moving) for p in parts), strict=True)
    )
    joint = np.nonzero(moving)[1]
    block = (np.arange(len(torque)) * BLOCKS // len(torque))[np.nonzero(moving)[0]]
    matrix, target = columns[moving], torque[moving]
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    upper, order = qr(matrix / scale, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(upper))
    chosen = np.sort(order[: len(diagonal)][diagonal > _RANK * diagonal[0]])
    reduced = matrix[:, chosen] / scale[chosen]
    weight = np.ones(len(target))
    for _ in range(_STEPS):
        value = np.linalg.lstsq(reduced * weight[:, None], target * weight, rcond=None)[0]
        left = target - reduced @ value
        sigma = np.sqrt(np.bincount(joint, (left**2)) / np.bincount(joint))[joint]
        weight = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(np.abs(left) / sigma, 1e-9))) / sigma
    weighted, aim = reduced * weight[:, None], target * weight
    normal = np.array(
        [weighted[block == number].T @ weighted[block == number] for number in range(BLOCKS)]
    )
    right = np.array(
        [weighted[block == number].T @ aim[block == number] for number in range(BLOCKS)]
    )
    without = [
        np.linalg.lstsq(normal.sum(0) - normal[k], right.sum(0) - right[k], rcond=1e-12)[0]
        for k in range(BLOCKS)
    ]
    deviation = np.sqrt(
        (BLOCKS - 1) / BLOCKS * np.sum((np.array(without) - np.mean(without, axis=0)) ** 2, axis=0)
    )
    found = np.zeros((2, len(scale)))
    found[:, chosen] = np.stack([value, deviation]) / scale[chosen]
    return PlainFit(found[0], found[1], len(arm.element_matrix))
