"""What is measured of a run of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import path_error, tip_position
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
    power = slow.friction_states[rows, 1] * slow.friction_states[rows, 2]
    work = (result.setup.rates.position_period * (power[1:] + power[:-1]) / 2.0).sum(axis=0)
    return (
        *_measured_errors(task, tip, slow.tracking_error[rows, 0]),
        *np.abs(slow.joint_states[rows, 1]).max(axis=0).tolist(),
        *np.abs(slow.joint_states[rows, 2]).max(axis=0).tolist(),
        *work.tolist(),
        *result.saturated.tolist(),
    )


def measure_perturbation(task: LineTask, result: PerturbationResult, run: int) -> tuple[float | int, ...]:
    """Return the metrics of a run of `task` by the perturbation method."""
    rows = _window(task, result.model.times)
    return (
        *_measured_errors(task, result.tip_position(run)[rows], result.joint_deviation[run, rows]),
        *result.saturated[run].tolist(),
        tip_distance(result, run),
    )


def tip_distance(result: PerturbationResult, run: int) -> float:
    """Return how far the tip is from its set-point at most, from start to end of a run, m."""
    return float(np.linalg.norm(result.tip_deviation[run], axis=1).max())


def _measured_errors(task: LineTask, tip: Array, error: Array) -> list[float]:
    path = path_error(tip, np.array(task.start), np.array(task.end)).perpendicular
    return [float(path.max()), _rms(path), *np.abs(error).max(axis=0).tolist(), *map(_rms, error.T)]


def _window(task: LineTask, times: Array) -> slice:
    begin, end = task.counted
    first, last = np.searchsorted(times, begin), np.searchsorted(times, end, side="right")
    return slice(int(first), int(last))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
