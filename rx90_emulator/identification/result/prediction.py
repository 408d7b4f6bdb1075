"""Predict what a bag should hold by an identified friction: the drives' torques and the path of the tip."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter1d
from scipy.signal import butter, sosfiltfilt

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.description.kinematics import forward
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.tracing import prescribed_torque
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.identification.sliding.fit import SlidingFit
from rx90_emulator.loop.closed_loop import run_setpoints
from rx90_emulator.loop.result import empty_series
from rx90_emulator.loop.setup import Setup

_BANDWIDTH = 40.0  # Hz, of the compared torques: above it lies the noise of differentiated velocities
_MOVES = 1e-3  # rad/s, at which the arm counts as moving
_SLIDES = 5e-3  # rad/s, at which a joint counts as moving, throughout the filter's reach
_EDGE = 0.1  # s at both ends, where the filter's transients are
_WEIGHED = 0.05  # standard deviation over RMS torque up to which a joint's error of the weights is applied


class TorquePrediction(NamedTuple):
    """Recorded and predicted drive torques of n joints, low-passed, from the first motion on.

    Attributes:
        time: s, shape (m,).
        recorded: Nm, shape (m, n).
        predicted: Nm, shape (m, n).
        compared: 1.0 where a joint moves, else 0.0, shape (m, n).
    """

    time: Array
    recorded: Array
    predicted: Array
    compared: Array


def friction_along(element_matrix: Array, lugre: tuple[FrictionElement, ...], time: Array, position: Array) -> Array:
    """Return the friction torque at the joints along a motion, Nm, shape (m, n).

    Args:
        element_matrix: joint velocities to input velocities of the elements, shape (e, n).
        lugre: the e elements.
        time: s, shape (m,).
        position: of the joints, rad, shape (m, n).
    """
    inputs = position @ element_matrix.T
    steps = np.diff(time, prepend=time[0])
    mean = np.diff(inputs, axis=0, prepend=inputs[:1]) / np.where(steps > 0.0, steps, 1.0)[:, None]
    return np.asarray(prescribed_torque(lugre, mean, steps) @ element_matrix)


def predict_torque(
    arm: RigidArm, lugre: tuple[FrictionElement, ...], sliding: SlidingFit | None, record: JointRecord
) -> TorquePrediction:
    """Predict the drives' torques along a recorded motion.

    Args:
        arm: rigid-body model.
        lugre: its friction elements.
        sliding: fit whose error of the arm's weights is applied where it is known; None: the weights of the model.
        record: the motion and the recorded torques.

    Raises:
        IdentificationError: if the arm does not move in the record.
    """
    step = float(np.median(np.diff(record.time)))
    moving = np.flatnonzero(np.abs(record.velocity).max(axis=1) > _MOVES)
    if len(moving) == 0 or record.time[-1] - record.time[moving[0]] < 4.0 * _EDGE:
        raise IdentificationError(f"{record.source}: the arm does not move; accepted: a run of all joints")
    sections = butter(4, min(_BANDWIDTH, 0.4 / step), fs=1.0 / step, output="sos")

    def smooth(values: Array) -> Array:
        return np.asarray(sosfiltfilt(sections, values, axis=0))

    acceleration = np.gradient(smooth(record.velocity), record.time, axis=0)
    friction = smooth(friction_along(arm.element_matrix, lugre, record.time, record.position))
    inside = (record.time > record.time[moving[0]] + _EDGE) & (record.time < record.time[-1] - _EDGE)
    kept = np.flatnonzero(inside)[:: max(1, round(0.1 / _BANDWIDTH / step))]
    position = record.position[kept]
    rigid = arm.torque(position, record.velocity[kept], acceleration[kept])
    recorded = smooth(record.torque)[kept]
    if sliding is not None:
        rigid = rigid + _error_of_weights(arm, sliding, position, recorded)
    span = 2 * round(0.5 * _EDGE / step) + 1
    moves = minimum_filter1d(np.abs(smooth(record.velocity)), span, axis=0)[kept] > _SLIDES
    return TorquePrediction(record.time[kept], recorded, rigid + friction[kept], moves.astype(np.float64))


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
    known = deviation <= _WEIGHED * np.sqrt(np.mean(recorded**2, axis=0))
    return np.asarray(np.where(known, regressor @ sliding.inertial, 0.0))


def tip_difference(
    setup: Setup, lugre: tuple[FrictionElement, ...], record: JointRecord, reference: JointSeries
) -> tuple[Array, Array]:
    """Return time and distance of the tip of the closed loop, run along the recorded set-points, from the recorded one.

    Raises:
        IdentificationError: if the set-points have gaps.
        DivergenceError: naming joint and tick.
        SupervisionError: if the controller's supervision cuts the power.
    """
    rates = setup.rates
    period_ns = rates.period_ns * rates.ratio
    gaps = np.flatnonzero(np.diff(reference.stamp_ns) != period_ns)
    if len(gaps):
        raise IdentificationError(
            f"{record.source}: the set-points of {reference.topic} have a gap at {reference.time[gaps[0]]:.3f} s; "
            f"accepted: one every {period_ns / 1e6:g} ms"
        )
    assert reference.position is not None
    assert reference.velocity is not None
    first = int(np.searchsorted(record.time, reference.time[0] - 1e-9))
    identified = replace(setup, friction=FrictionSet(setup.friction.names, lugre))
    plant, controller = identified.plant(), identified.cs7b()
    plant.reset(np.clip(record.position[first], setup.robot.lower, setup.robot.upper))
    controller.reset(plant.motor_states()[0])
    acceleration = np.gradient(reference.velocity, rates.position_period, axis=0)
    setpoints = np.ascontiguousarray(np.stack([reference.position, reference.velocity, acceleration], axis=1))
    ticks = len(setpoints) * rates.ratio
    fast, slow = empty_series(ticks, rates.ratio, record_fast=False)
    run_setpoints(plant, controller, setpoints, ticks, fast, slow)
    recorded = np.column_stack(
        [np.interp(reference.time, record.time, record.position[:, j]) for j in range(len(record.names))]
    )
    inside = (reference.time >= record.time[0]) & (reference.time <= record.time[-1])
    tips = [forward(setup.robot.chain, q).position for q in (slow.joint_states[:, 0], recorded)]
    return reference.time[inside], np.linalg.norm(tips[0] - tips[1], axis=1)[inside]
