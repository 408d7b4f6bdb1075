"""The verdict on a friction by a bag that was not used for it: the drives' torques, and the path of the tip."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, sosfiltfilt

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.description.kinematics import forward
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.tracing import prescribed_torque
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.options import ValidationTolerances
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.sliding.fit import SlidingFit
from rx90_emulator.identification.validation.measured import read_setpoints, run_along, setpoint_rows
from rx90_emulator.identification.validation.verdict import Criterion, TorquePrediction, largest
from rx90_emulator.identification.zeros import ZeroCheck, check_zeros, record_instants

_BANDWIDTH_HZ = 40.0  # Hz, of the compared torques: above it lies the noise of differentiated velocities
_MOVING_SPEED = 1e-3  # rad/s, at which the arm counts as moving
_COMPARED_SPEED = 5e-3  # rad/s, at which a joint counts as moving, throughout the filter's reach
_FILTER_EDGE_S = 0.1  # s at both ends, where the filter's transients are
_MAX_WEIGHT_SD = 0.05  # standard deviation over RMS torque up to which a joint's error of the weights is applied


@dataclass(frozen=True, eq=False)
class Validation:
    """Recorded against predicted torques, and the recorded tip against the simulated one.

    Attributes:
        names: joints, n of them.
        torque: recorded and predicted torques of the joints.
        tip_time: s, shape (k,); empty where the bag holds no set-points.
        tip_distance: of the simulated from the recorded tip, m, shape (k,).
        tolerances: what counts as agreement.
        source: the bag.
        zeros: what the torques say of the encoders' zeros, where a given friction is held against the bag.
    """

    names: tuple[str, ...]
    torque: TorquePrediction
    tip_time: Array
    tip_distance: Array
    tolerances: ValidationTolerances
    source: str
    zeros: ZeroCheck | None = None

    rms = property(attrgetter("torque.rms"), doc="RMS torque difference, Nm, shape (n,); NaN for a joint at rest.")
    worst = property(attrgetter("torque.worst"), doc="Largest torque difference, Nm, shape (n,); NaN as in `rms`.")
    rms_share = property(attrgetter("torque.rms_share"), doc="RMS difference over RMS recorded torque, shape (n,).")
    worst_share = property(attrgetter("torque.worst_share"), doc="Largest difference over largest torque, shape (n,).")

    @property
    def largest_share(self) -> float:
        """Return the largest RMS difference of a joint that moves over its RMS recorded torque."""
        return float(np.nanmax(self.torque.rms_share))

    @property
    def tip_worst(self) -> float:
        """Return the largest distance of the tips, m; NaN without set-points."""
        return float(self.tip_distance.max()) if len(self.tip_distance) else math.nan

    @property
    def tip_rms(self) -> float:
        """Return the RMS distance of the tips, m; NaN without set-points."""
        return float(np.sqrt(np.mean(self.tip_distance**2))) if len(self.tip_distance) else math.nan

    @property
    def criteria(self) -> tuple[Criterion, Criterion, Criterion]:
        """Return what the verdict rests on: RMS and largest difference of torques, distance of the tips."""
        return (
            largest("torque RMS", self.names, self.torque.rms_share, self.tolerances.torque),
            largest("worst", self.names, self.torque.worst_share, self.tolerances.worst_torque),
            Criterion("tip worst", self.tip_worst, self.tolerances.tip, unit="um"),
        )

    @property
    def passed(self) -> bool:
        """Return whether everything that could be compared agrees."""
        return all(one.passed for one in self.criteria)


def validate(
    robot: RecordedRobot,
    lugre: tuple[FrictionElement, ...],
    sliding: SlidingFit | None,
    record: JointRecord,
    tolerances: ValidationTolerances,
) -> Validation:
    """Compare friction with a bag; the tip only for this project's robot, where set-points are in the bag.

    Args:
        robot: that the bag comes from.
        lugre: its friction elements.
        sliding: fit that they come from; None for elements that are given.
        record: what was read of the bag.
        tolerances: what counts as agreement.

    Raises:
        Rx90Error: if the bag cannot be read or used.
    """
    torque = _predict_torque(robot.arm, lugre, sliding, record)
    tip_time, distance = _tip_difference(robot, lugre, record)
    # With sweeps, these have been asked already.
    zeros = check_zeros(record_instants(record, robot.arm), robot.arm, robot.zero) if sliding is None else None
    return Validation(record.names, torque, tip_time, distance, tolerances, str(record.source), zeros)


def _predict_torque(
    arm: RigidArm, lugre: tuple[FrictionElement, ...], sliding: SlidingFit | None, record: JointRecord
) -> TorquePrediction:
    """Predict the drives' torques along a recorded motion, from its beginning on; refuse one in which nothing moves."""
    time, position = record.time, record.position
    step = float(np.median(np.diff(time)))
    sections = butter(4, min(_BANDWIDTH_HZ, 0.4 / step), fs=1.0 / step, output="sos")
    moving = np.flatnonzero(np.abs(record.velocity).max(axis=1) > _MOVING_SPEED)
    if len(moving) == 0 or time[-1] - time[moving[0]] < 4.0 * _FILTER_EDGE_S:
        raise IdentificationError(f"{record.source}: the arm does not move; accepted: a run of all joints")
    velocity = np.asarray(sosfiltfilt(sections, record.velocity, axis=0))
    inside = (time > time[moving[0]] + _FILTER_EDGE_S) & (time < time[-1] - _FILTER_EDGE_S)
    kept = np.flatnonzero(inside)[:: max(1, round(0.1 / _BANDWIDTH_HZ / step))]
    span = 2 * round(0.5 * _FILTER_EDGE_S / step) + 1
    compared = minimum_filter1d(np.abs(velocity), span, axis=0)[kept] > _COMPARED_SPEED
    if not compared.any():
        raise IdentificationError(
            f"{record.source}: no joint moves at {1e3 * _COMPARED_SPEED:g} mrad/s for {2.0 * _FILTER_EDGE_S:g} s, and "
            "torques at rest are not compared; accepted: a run of all joints"
        )
    inputs, steps = position @ arm.element_matrix.T, np.diff(time, prepend=time[0])
    mean = np.diff(inputs, axis=0, prepend=inputs[:1]) / np.where(steps > 0.0, steps, 1.0)[:, None]
    friction, recorded = (
        np.asarray(sosfiltfilt(sections, values, axis=0))[kept]
        for values in (prescribed_torque(lugre, mean, steps) @ arm.element_matrix, record.torque)
    )
    rigid = arm.torque(position[kept], record.velocity[kept], np.gradient(velocity, time, axis=0)[kept])
    if sliding is not None:
        rigid = rigid + _error_of_weights(arm, sliding, position[kept], recorded)
    return TorquePrediction(time[kept], recorded, rigid + friction, compared)


def _error_of_weights(arm: RigidArm, sliding: SlidingFit, position: Array, recorded: Array) -> Array:
    """Return the torque of the arm's inertial errors, Nm, shape (m, n); 0 for joints where it is too uncertain.

    Sweeps of some joints, or at one pose, leave the weights of other joints and at other poses undetermined. The
    fit's error of them is then hundreds of Nm with a standard deviation as large, and the weights of the description
    are better. Sweeps at constant velocity determine hardly anything of the inertias.
    """
    nothing = np.zeros_like(position)
    regressor = arm.regressor(position, nothing, nothing)
    values, directions = np.linalg.eigh(sliding.inertial_covariance)
    parts = regressor @ (directions * np.sqrt(np.maximum(values, 0.0)))
    deviation = np.sqrt(np.mean(np.sum(parts**2, axis=2), axis=0))
    known = deviation <= _MAX_WEIGHT_SD * np.sqrt(np.mean(recorded**2, axis=0))
    return np.asarray(np.where(known, regressor @ sliding.inertial, 0.0))


def _tip_difference(
    robot: RecordedRobot, lugre: tuple[FrictionElement, ...], record: JointRecord
) -> tuple[Array, Array]:
    """Return time and distance of the tip of the closed loop, run along the recorded set-points, from the recorded one.

    They are empty where that cannot be simulated; set-points with gaps are refused.
    """
    setup = robot.setup
    series = None if setup is None else read_setpoints(record.source, record.names, robot.zero, robot.mapping)
    if setup is None or series is None:
        return np.zeros(0), np.zeros(0)
    reference, position, velocity = series
    period_ns = setup.rates.period_ns * setup.rates.ratio
    gaps = np.flatnonzero(np.diff(reference.stamp_ns) != period_ns)
    if len(gaps):
        raise IdentificationError(
            f"{record.source}: the set-points of {reference.topic} have a gap at {reference.time[gaps[0]]:.3f} s; "
            f"accepted: one every {period_ns / 1e6:g} ms"
        )
    first = int(np.searchsorted(record.time, reference.time[0] - 1e-9))
    start = np.clip(record.position[first], setup.robot.lower, setup.robot.upper)
    identified = replace(setup, friction=FrictionSet(setup.friction.names, lugre))
    _, slow, _ = run_along(identified, setpoint_rows(position, velocity, setup), start)
    recorded = np.column_stack([np.interp(reference.time, record.time, joint) for joint in record.position.T])
    inside = (reference.time >= record.time[0]) & (reference.time <= record.time[-1])
    tips = [forward(setup.robot.chain, q).position for q in (slow.joint_states[:, 0], recorded)]
    return reference.time[inside], np.linalg.norm(tips[0] - tips[1], axis=1)[inside]
