"""Write a run without ROS as a bag with the topics that the nodes publish."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_common.friction.friction_set import element_names
from rx90_emulator.loop.closed_loop import RunResult

Array = NDArray[np.float64]


def run_series(result: RunResult, decimation: int = 1) -> list[JointSeries]:
    """Return the run's topics.

    Args:
        result: the run.
        decimation: keep every n-th row of the 1 kHz topics.
    """
    joints = result.setup.robot.joint_names
    rates = result.setup.rates
    step = rates.period_ns * rates.ratio * decimation
    slow = result.slow
    series = [
        _series("/joint_states", joints, slow.joint_states[::decimation], step),
        _series("/friction_states", element_names(joints), slow.friction_states[::decimation], step),
        _series("/rx90_controller/reference", joints, slow.reference[::decimation], step),
        _series("/rx90_controller/tracking_error", joints, slow.tracking_error[::decimation], step),
    ]
    if result.fast is not None:
        commands = result.fast.motor_commands
        series.append(_series("/motor_states", MOTOR_NAMES, result.fast.motor_states, rates.period_ns))
        stamps = np.arange(len(commands), dtype=np.int64) * rates.period_ns
        series.append(JointSeries("/motor_commands", MOTOR_NAMES, stamps, effort=commands))
    return series


def write_run(result: RunResult, path: Path, storage: str = "mcap", decimation: int = 1) -> None:
    """Write the run to a new bag folder.

    Raises:
        BagError: if the folder exists or cannot be written.
    """
    description = string_message("/robot_description", result.setup.robot.urdf)
    write_joint_states(path, run_series(result, decimation), storage=storage, messages=[description])


def _series(topic: str, names: tuple[str, ...], rows: Array, step_ns: int) -> JointSeries:
    stamps = np.arange(len(rows), dtype=np.int64) * step_ns
    return JointSeries(topic, names, stamps, *(np.ascontiguousarray(rows[:, k]) for k in range(3)))
