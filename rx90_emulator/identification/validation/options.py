"""Options of a comparison with a measured run: what its bag holds, and tolerances. Imports nothing slow, for --help."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rx90_common.base.errors import ConfigError


@dataclass(frozen=True)
class MeasuredLayout:
    """What the JointState messages of a measured bag hold; by default `motor_states`, else `joint_states`, as here.

    Attributes:
        topic: JointState topic; by default motor_states where the bag has it, else joint_states.
        names: of the joints, or of their motors with `gear`, in the messages; by default this project's.
        gear: motor turns per joint turn, shape (6,), if the messages hold the motors' states; for motor_states by
            default the robot's.
        coupling: turns of each motor per joint turn without the gears, row by row, shape (36,); by default the robot's
            wrist: motor 6 turns with joints 5 and 6.
        torque_constant: torque per unit of effort, shape (6,), if effort is a current, Nm/A.
        zero: recorded angle of each joint where that of the URDF is 0, which is subtracted, rad, shape (6,).
        record_time: whether the times of recording replace the stamps in the headers.
        signals: signal map that says all this in their place, and what the columns of a table hold; by default the
            file beside a table.
    """

    topic: str | None = None
    names: Sequence[str] | None = None
    gear: Sequence[float] | None = None
    coupling: Sequence[float] | None = None
    torque_constant: Sequence[float] | None = None
    zero: Sequence[float] | None = None
    record_time: bool = False
    signals: Path | str | None = None


@dataclass(frozen=True)
class MeasuredTolerances:
    """What counts as agreement of a simulated run with a measured one.

    Attributes:
        torque: RMS difference of a joint's torque over its RMS measured torque.
        total_torque: the same of all joints together.
        position: largest difference of a joint's position, rad.
    """

    torque: float = 0.25
    total_torque: float = 0.1
    position: float = 5e-3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0.0 < value < math.inf:
                raise ConfigError(f"{name} is {value}; accepted: a positive number")
