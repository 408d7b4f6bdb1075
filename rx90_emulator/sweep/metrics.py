"""What is measured of a run of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import path_error, tip_position
from rx90_common.kernels.compiled import kernel
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.result import RunResult
from rx90_emulator.perturbation.model import PerturbationResult

DEVIATION: Final = "tip_deviation_worst"
"""The metric that says how far the perturbation method holds."""


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
    return (
        *_errors(joints, "largest position error the controller saw"),
        *(Metric(f"velocity_peak_{j}", "rad/s", "largest joint speed") for j in joints),
        *(Metric(f"drive_torque_peak_{j}", "Nm", "largest torque of the drives at the joint") for j in joints),
        *(Metric(f"friction_work_{e}", "J", "work done against the friction element") for e in elements),
        *_saturated(joints),
    )


def perturbation_metrics(joints: Sequence[str]) -> tuple[Metric, ...]:
    """Return the metrics of a run by the perturbation method, in the order of `measure_perturbation`."""
    return (
        *_errors(joints, "largest position error, without the encoder's counts"),
        *_saturated(joints),
        Metric(DEVIATION, "m", "largest distance of the tip from its set-point"),
    )


def _errors(joints: Sequence[str], worst: str) -> tuple[Metric, ...]:
    return (
        Metric("path_error_worst", "m", "largest distance of the tip from the line"),
        Metric("path_error_rms", "m", "root mean square distance of the tip from the line"),
        *(Metric(f"tracking_error_worst_{j}", "rad", worst) for j in joints),
        *(Metric(f"tracking_error_rms_{j}", "rad", "root mean square position error") for j in joints),
    )


def _saturated(joints: Sequence[str]) -> tuple[Metric, ...]:
    about = "base ticks of the whole run at the motor's limit"
    return tuple(Metric(f"saturated_ticks_motor_{i + 1}", "1", about, whole=True) for i in range(len(joints)))


def measure(task: LineTask, result: RunResult) -> tuple[float | int, ...]:
    """Return the metrics of a run of `task`."""
    rows = _window(task, result.times)
    slow = result.slow
    tip = tip_position(result.setup.robot.chain, slow.joint_states[rows, 0])
    peaks, work = np.zeros((3, 6)), np.zeros(7)
    _scan(
        slow.joint_states[rows], slow.friction_states[rows], slow.tracking_error[rows],
        result.setup.rates.position_period, peaks, work,
    )  # fmt: skip
    velocity, torque, error = peaks.tolist()
    return (
        *_path_errors(task, tip), *error, *map(_rms, slow.tracking_error[rows, 0].T),
        *velocity, *torque, *work.tolist(), *result.saturated.tolist(),
    )  # fmt: skip


@kernel
def _scan(joints: Array, friction: Array, tracking: Array, period: float, peaks: Array, work: Array) -> None:
    """Find the peaks of velocity, torque and tracking error, shape (3, 6), and add up the friction's work."""
    for n in range(len(joints)):
        for j in range(6):
            values = joints[n, 1, j], joints[n, 2, j], tracking[n, 0, j]
            for k in range(3):
                if not abs(values[k]) <= peaks[k, j]:  # NaN stays
                    peaks[k, j] = abs(values[k])
        if n > 0:
            for e in range(7):
                power = friction[n, 1, e] * friction[n, 2, e] + friction[n - 1, 1, e] * friction[n - 1, 2, e]
                work[e] += period * power / 2.0


def measure_perturbation(task: LineTask, result: PerturbationResult, run: int) -> tuple[float | int, ...]:
    """Return the metrics of a run of `task` by the perturbation method."""
    rows = _window(task, result.model.times)
    deviation = result.joint_deviation[run, rows]
    return (
        *_path_errors(task, result.tip_position(run)[rows]),
        *np.abs(deviation).max(axis=0).tolist(),
        *map(_rms, deviation.T),
        *result.saturated[run].tolist(),
        tip_distance(result, run),
    )


def tip_distance(result: PerturbationResult, run: int) -> float:
    """Return how far the tip is from its set-point at most, from start to end of a run, m."""
    return float(np.linalg.norm(result.tip_deviation[run], axis=1).max())


def _path_errors(task: LineTask, tip: Array) -> tuple[float, float]:
    path = path_error(tip, np.array(task.start), np.array(task.end)).perpendicular
    return float(path.max()), _rms(path)


def _window(task: LineTask, times: Array) -> slice:
    begin, end = task.counted
    first, last = np.searchsorted(times, begin), np.searchsorted(times, end, side="right")
    return slice(int(first), int(last))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
