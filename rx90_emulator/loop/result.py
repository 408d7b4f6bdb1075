"""The result of a run as named arrays, each name with its unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.base.errors import Rx90Error
from rx90_emulator.loop.closed_loop import RunResult

Array = NDArray[np.float64]

_ROWS = ("position [rad]", "velocity [rad/s]", "effort [Nm]")
# What the three rows of a series hold where it is not position, velocity and torque.
_OTHER_ROWS = {"friction_states": ("bristle deflection [rad]", "input velocity [rad/s]", "friction torque [Nm]")}


def named_arrays(result: RunResult) -> dict[str, Array]:
    """Return a run as arrays by `<series> <quantity> [unit]`; the series are named as the topics.

    `time [s]`, shape (m,), belongs to the series on position ticks, shape (m, joints); `base time [s]`, shape (n,), to
    `motor_states` and `motor_commands`, which are there if the run kept them.
    """
    arrays: dict[str, Array] = {"time [s]": result.times}
    for series, values in result.slow._asdict().items():
        for row, quantity in enumerate(_OTHER_ROWS.get(series, _ROWS)):
            arrays[f"{series} {quantity}"] = values[:, row]
    if result.fast is not None:
        ticks = np.arange(len(result.fast.motor_commands), dtype=np.float64)
        arrays["base time [s]"] = np.asarray(ticks * result.setup.rates.period)
        for row, quantity in enumerate(_ROWS):
            arrays[f"motor_states {quantity}"] = result.fast.motor_states[:, row]
        arrays["motor_commands effort [Nm]"] = result.fast.motor_commands
    return arrays


def save_arrays(result: RunResult, file: Path) -> None:
    """Write the arrays and the joints' names to a compressed NumPy file, `.npz`.

    Raises:
        Rx90Error: if the file cannot be written.
    """
    contents: dict[str, Any] = {
        "joint names": np.array(result.setup.robot.joint_names),
        "element names": np.array(result.setup.friction.names),
        **named_arrays(result),
    }
    try:
        with file.open("xb") as stream:
            np.savez_compressed(stream, **contents)
    except OSError as error:
        raise Rx90Error(f"{file}: cannot be written ({error.strerror}); accepted: a new file") from error
