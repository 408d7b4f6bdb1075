"""Options: the robot that bags come from, and tolerances.

They are declared once, for checks and for --help, so this module imports nothing slow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

from rx90_common.base.errors import ConfigError

COULOMB_VISCOUS = "coulomb-viscous"
MODEL_PARTS = ("viscous-exponent", "stribeck-rise", "bristle")
"""Parts that a friction model may have beside Coulomb and viscous friction, by their names in tables."""


@dataclass(frozen=True)
class MeasuredLayout:
    """The contents of the JointState messages of bags; a signal map may state them instead.

    By default those of this project's robot: the topic motor_states where a bag has it, else joint_states; its names;
    for motor_states its gears and the coupling of its wrist, where motor 6 turns with joints 5 and 6.

    Attributes:
        topic: JointState topic.
        names: names of n joints, or of their motors with `gear`, in the messages.
        gear: motor turns per joint turn, shape (n,), if the messages hold the motors' states.
        coupling: turns of each motor per joint turn without the gears, row by row, shape (n * n,).
        torque_constant: torque per unit of effort, shape (n,), if effort is a current, Nm/A.
        zero: recorded angle of each joint in the zero pose of its URDF, which is subtracted, rad, shape (n,); by
            default 0.
        record_time: whether the times of recording replace the stamps in the headers.
        signals: signal map that states these, and the columns of tables; by default the file beside a table.
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
class RobotOptions(MeasuredLayout):
    """The robot that bags come from, and their contents: this project's by default, any other one with `urdf`.

    Attributes:
        robot: name or folder of this project's robot; by default the RX90B.
        tool: tool file of this project's robot, or "none"; by default the robot's own.
        drives: drives file of this project's robot; by default the robot's own.
        urdf: description of another robot, with n joints; then the topic is joint_states unless stated.
        joints: joints of interest from base to tip; the others are held at 0. By default all movable ones.
        rotor_inertia: of each motor, seen through its gear, kg m^2, shape (n,).
        spring: amplitude k of a torque -k sin(q) on each joint, Nm, shape (n,).
        fallback: friction file for omega_d and for parameters that are not identifiable, or "none"; by default the
            robot's own file for this project's robot and none for another one.
        torque_delay: by how much torques acted later than their stamps say, s; negative where they were recorded late.
            Micro-oscillations take a torque as that of the sample period that ends at its stamp: half a period where it
            was sampled at its stamp.
    """

    robot: str | None = None
    tool: str | None = None
    drives: str | None = None
    urdf: Path | str | None = None
    joints: Sequence[str] | None = None
    rotor_inertia: Sequence[float] | None = None
    spring: Sequence[float] | None = None
    fallback: str | None = None
    torque_delay: float = 0.0


SHIPPED_ROBOT = RobotOptions()


class Tolerances:
    """Limits for agreement: positive numbers."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0.0:
                raise ConfigError(f"{name} is {value}; accepted: a positive number")


@dataclass(frozen=True)
class ValidationTolerances(Tolerances):
    """Limits for agreement in a validation.

    Attributes:
        torque: RMS difference of a joint's torque over its RMS recorded torque.
        worst_torque: largest difference over the largest recorded torque; infinite if it is not limited.
        tip: largest distance between the tip positions, m.
        total: RMS difference of the torques of all joints over their RMS recorded torque.
    """

    torque: float = 0.05
    worst_torque: float = 0.15
    tip: float = 1e-4
    total: float = 0.1


@dataclass(frozen=True)
class MeasuredTolerances(Tolerances):
    """Limits for agreement of a simulated run with a measured one.

    Attributes:
        torque: RMS difference of a joint's torque over its RMS measured torque.
        total_torque: the same for all joints together.
        position: largest difference of a joint's position, rad.
    """

    torque: float = 0.25
    total_torque: float = 0.1
    position: float = 5e-3


EMULATED = ValidationTolerances()
"""Limits for bags with set-points of this project's controller, along which the closed loop is run, too."""


RECORDED = ValidationTolerances(torque=0.3, worst_torque=math.inf)
"""Limits for all other bags; light joints differ more, because friction is most of their torque."""


GivenTolerances: TypeAlias = Mapping[str, float]
"""Limits by the names of the attributes; the others are those of EMULATED or RECORDED."""
NO_TOLERANCES: GivenTolerances = MappingProxyType({})
Progress: TypeAlias = Callable[[str], None]
"""Called with the name of each step before it."""
