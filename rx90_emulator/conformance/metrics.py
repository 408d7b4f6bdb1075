"""The measured quantities of a run, with their limits: times what the CS7B has, and an allowance."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from rx90_common.base.arrays import Array, column_rms
from rx90_emulator.conformance.case import START, Metric, Record
from rx90_emulator.loop.line import path_accuracy

_SETTLED_SHARE = 0.02  # of the way of a step
_RIPPLE_WINDOW = 0.02  # s
_HUNTED = 5.0  # s at the end of a run
_AT_REST = 0.1  # s at the end of a run


def _moving(record: Record, values: Array) -> Array:
    return values[record.times >= START]


def _ending(record: Record, values: Array, seconds: float) -> Array:
    return values[-round(seconds / record.period) :]


def _ripple(record: Record) -> Array:
    torque = np.nan_to_num(_moving(record, record.torque))
    return column_rms(
        torque - uniform_filter1d(torque, max(1, round(_RIPPLE_WINDOW / record.period)), axis=0)
    )


def _path_error(record: Record) -> Array:
    case = record.case
    assert case.task is not None
    accuracy = path_accuracy(case.setup.robot, case.task, record.times, record.position, START)
    return np.array([accuracy.worst])


def _overshoot(record: Record) -> Array:
    start, goal = record.case.points.position[[0, -1]]
    return np.asarray(((record.position - goal) / (goal - start)).max(axis=0).clip(0.0))


def _settling(record: Record) -> Array:
    start, goal = record.case.points.position[[0, -1]]
    outside = np.abs(record.error) > _SETTLED_SHARE * np.abs(goal - start)
    until = np.where(outside, record.times[:, None] + record.period, 0.0).max(axis=0)
    return np.asarray((until - record.case.end).clip(0.0))


TORQUE_OFF = Metric(
    "torque_off",
    "s",
    "time without torque",
    lambda record: np.isnan(record.torque).sum(axis=0) * record.period,
)
REST_ERROR = Metric(
    "rest_error",
    "rad",
    "what is left of the error in the last 0.1 s",
    lambda record: np.abs(_ending(record, record.error, _AT_REST).mean(axis=0)),
    allowance=3e-4,
)
TRACKING = (
    TORQUE_OFF,
    Metric(
        "tracking_error_peak",
        "rad",
        "largest error of the joint's position",
        lambda record: np.abs(_moving(record, record.error)).max(axis=0),
        3.0,
        1e-4,
    ),
    Metric(
        "tracking_error_rms",
        "rad",
        "its root mean square",
        lambda record: column_rms(_moving(record, record.error)),
        3.0,
        1e-4,
    ),
    Metric(
        "torque_ripple", "Nm", "commanded torque less its mean over 20 ms, RMS", _ripple, 3.0, 0.2
    ),
)
LINE = (
    *TRACKING,
    Metric("path_error", "m", "largest distance of the tool from its line", _path_error, 3.0, 5e-5),
)
STEP = (
    *TRACKING,
    REST_ERROR,
    Metric("overshoot", "1", "beyond the end of the step, over its way", _overshoot, 3.0, 0.1),
    Metric(
        "settling_time",
        "s",
        "from the end of the step until it stays within 2 %",
        _settling,
        3.0,
        0.3,
    ),
)
REST = (
    *TRACKING,
    REST_ERROR,
    Metric(
        "hunting",
        "rad",
        "motion at rest in the last 5 s, peak to peak",
        lambda record: np.ptp(_ending(record, record.position, _HUNTED), axis=0),
        allowance=1e-4,
    ),
)
