"""The metrics of a run: a short list of numbers with units.

They are computed from the series at the position rate, from the start of the line until the arm has settled at its end,
as the path error is. The rest before the line is left out: the controller still takes up the weight of the arm there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import path_error
from rx90_common.description.tip import tip_position
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.result import RunResult


@dataclass(frozen=True)
class Metric:
    """One number of a run.

    Attributes:
        name: of its column.
        unit: SI.
        meaning: a sentence.
        whole: whether it is a whole number.
    """

    name: str
    unit: str
    meaning: str
    whole: bool = False


def metrics_of(joints: Sequence[str], elements: Sequence[str]) -> tuple[Metric, ...]:
    """Return the metrics for six joints and seven friction elements, in the order of `measure`."""
    motors = [f"motor_{i + 1}" for i in range(len(joints))]
    return (
        Metric("path_error_worst", "m", "largest distance of the tip from the line"),
        Metric("path_error_rms", "m", "root mean square distance of the tip from the line"),
        *(Metric(f"tracking_error_worst_{j}", "rad", "largest position error the controller saw") for j in joints),
        *(Metric(f"tracking_error_rms_{j}", "rad", "root mean square position error") for j in joints),
        *(Metric(f"velocity_peak_{j}", "rad/s", "largest joint speed") for j in joints),
        *(Metric(f"drive_torque_peak_{j}", "Nm", "largest torque of the drives at the joint") for j in joints),
        *(Metric(f"friction_work_{e}", "J", "work done against the friction element") for e in elements),
        *(
            Metric(f"saturated_ticks_{m}", "1", "base ticks of the whole run at the motor's limit", whole=True)
            for m in motors
        ),
    )


def measure(task: LineTask, result: RunResult) -> tuple[float | int, ...]:
    """Return the metrics of a run of `task`."""
    rows = _window(task, result.times)
    slow = result.slow
    tip = tip_position(result.setup.robot.chain, slow.joint_states[rows, 0])
    path = path_error(tip, np.array(task.start), np.array(task.end)).perpendicular
    error = slow.tracking_error[rows, 0]
    power = slow.friction_states[rows, 1] * slow.friction_states[rows, 2]
    work = (result.setup.rates.position_period * (power[1:] + power[:-1]) / 2.0).sum(axis=0)
    return (
        float(path.max()),
        _rms(path),
        *np.abs(error).max(axis=0).tolist(),
        *map(_rms, error.T),
        *np.abs(slow.joint_states[rows, 1]).max(axis=0).tolist(),
        *np.abs(slow.joint_states[rows, 2]).max(axis=0).tolist(),
        *work.tolist(),
        *result.saturated.tolist(),
    )


def _window(task: LineTask, times: Array) -> slice:
    begin, end = task.counted
    first, last = np.searchsorted(times, begin), np.searchsorted(times, end, side="right")
    return slice(int(first), int(last))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
