"""Options: the robot that bags come from, tolerances, and the choices for excitation runs.

They are declared once, for checks and for --help, so this module imports nothing slow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, TypeAlias, get_type_hints

from rx90_common.base.errors import ConfigError, IdentificationError
from rx90_common.base.quoting import quoted

COULOMB_VISCOUS = "coulomb-viscous"
SLIDING_PARTS = ("viscous-exponent", "stribeck-rise")
MODEL_PARTS = (*SLIDING_PARTS, "bristle", "bristle-damping")
"""Parts that a friction model may have beside Coulomb and viscous friction, by their names in tables."""


def model_parts(model: Sequence[str], accepted: Sequence[str] = MODEL_PARTS) -> tuple[str, ...]:
    """Return the parts of a model beside Coulomb and viscous friction, which every model has."""
    unknown = [name for name in model if name not in (COULOMB_VISCOUS, *accepted)]
    if unknown or not model:
        found = quoted(unknown[0]) if unknown else "no part"
        raise ConfigError(f"--model: {found}; accepted: {', '.join((COULOMB_VISCOUS, *accepted))}")
    if "bristle-damping" in model and "bristle" not in model:
        raise ConfigError("--model: bristle-damping without bristle; accepted: both, or neither")
    return tuple(name for name in accepted if name in model)


@dataclass(frozen=True)
class RobotOptions:
    """The robot that bags come from: this project's by default, any other one with `urdf`.

    Attributes:
        robot: name or folder of this project's robot; by default the RX90B.
        tool: tool file of this project's robot, or "none"; by default the robot's own.
        drives: drives file of this project's robot; by default the robot's own.
        urdf: description of another robot, with n joints; the following attributes belong to it.
        topic: JointState topic; by default joint_states.
        joints: joints of interest from base to tip; the others are held at 0. By default all movable ones.
        names: names of these joints, or of their motors with `gear`, in the messages; by default `joints`.
        gear: motor turns per joint turn, shape (n,), if the messages hold the motors' states.
        coupling: turns of each motor per joint turn without the gears, row by row, shape (n * n,); by default the
            identity.
        torque_constant: torque per unit of effort, shape (n,), if effort is a current, Nm/A.
        rotor_inertia: of each motor, seen through its gear, kg m^2, shape (n,).
        spring: amplitude k of a torque -k sin(q) on each joint, Nm, shape (n,).
        fallback: friction file for omega_d and for parameters that are not identifiable, or "none"; by default the
            robot's own file for this project's robot and none for another one.
        torque_delay: by how much a torque acted later than in the sample period that ends at its stamp, s; half a
            period for a torque that was sampled at its stamp.
        record_time: whether the times of recording replace the stamps in the headers.
        zero: recorded angle of each joint in the zero pose of its URDF, which is subtracted, rad, shape (n,); by
            default 0.
        signals: signal map that states topic, names, gear, coupling, torque_constant, zero and record_time instead of
            these options, and the columns of tables; by default the file beside a table.
    """

    robot: str | None = None
    tool: str | None = None
    drives: str | None = None
    urdf: Path | str | None = None
    topic: str | None = None
    joints: Sequence[str] | None = None
    names: Sequence[str] | None = None
    gear: Sequence[float] | None = None
    coupling: Sequence[float] | None = None
    torque_constant: Sequence[float] | None = None
    rotor_inertia: Sequence[float] | None = None
    spring: Sequence[float] | None = None
    fallback: str | None = None
    torque_delay: float = 0.0
    record_time: bool = False
    zero: Sequence[float] | None = None
    signals: Path | str | None = None


SHIPPED_ROBOT = RobotOptions()


@dataclass(frozen=True)
class MeasuredLayout:
    """The contents of the JointState messages of a measured bag of this project's arm, n = 6 joints.

    The attributes are those of the same names in `RobotOptions`, with other defaults: the topic motor_states where the
    bag has it, else joint_states; this project's names; for motor_states the robot's gears and the coupling of its
    wrist, where motor 6 turns with joints 5 and 6.
    """

    topic: str | None = None
    names: Sequence[str] | None = None
    gear: Sequence[float] | None = None
    coupling: Sequence[float] | None = None
    torque_constant: Sequence[float] | None = None
    zero: Sequence[float] | None = None
    record_time: bool = False
    signals: Path | str | None = None


class _Tolerances:
    """Limits for agreement: positive numbers."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0.0:
                raise ConfigError(f"{name} is {value}; accepted: a positive number")


@dataclass(frozen=True)
class ValidationTolerances(_Tolerances):
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


EMULATED = ValidationTolerances()
"""Limits for bags with set-points of this project's controller, along which the closed loop is run, too."""


@dataclass(frozen=True)
class ExcitationTolerances(_Tolerances):
    """Limits for agreement of an excitation run that the identification did not use.

    Attributes:
        total: RMS difference of the torques of all joints over their RMS recorded torque.
        joint: the same for each joint alone; light joints differ more, because friction is most of their torque.
    """

    total: float = 0.1
    joint: float = 0.3


RECORDED = ValidationTolerances(
    torque=ExcitationTolerances.joint, worst_torque=math.inf, total=ExcitationTolerances.total
)
"""Limits for all other bags: those of excitation runs, so that both validations judge alike."""


GivenTolerances: TypeAlias = ValidationTolerances | Mapping[str, float]
"""All limits, or some by the names of the attributes; the others are then those of EMULATED or RECORDED."""
NO_TOLERANCES: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class MeasuredTolerances(_Tolerances):
    """Limits for agreement of a simulated run with a measured one.

    Attributes:
        torque: RMS difference of a joint's torque over its RMS measured torque.
        total_torque: the same for all joints together.
        position: largest difference of a joint's position, rad.
    """

    torque: float = 0.25
    total_torque: float = 0.1
    position: float = 5e-3


QUICK = {"runs": 1, "periods": 1, "steps": 15}
"""Options of a short plan: one run, and a validation run."""
_LONGEST_S = 600.0  # of a run's periodic part
_FARTHEST = 1000.0  # m, of a plane from the base


@dataclass(frozen=True)
class Wall:
    """A plane of which the arm stays on one side.

    Attributes:
        normal: unit vector in the base's frame, shape (3,), pointing to the side where the arm may be.
        distance: normal @ x for points x of the plane, m.
        name: for messages.
    """

    normal: tuple[float, float, float]
    distance: float
    name: str

    @classmethod
    def above(cls, height: float) -> Wall:
        """Return a horizontal table at a height, m, over the base's origin; refuses as `through`."""
        return cls.through((0.0, 0.0, 1.0, height), f"--keep-above {height:g}")

    @classmethod
    def through(cls, numbers: Sequence[float], name: str = "") -> Wall:
        """Return the wall n x = d for four numbers n, d, with n of any length: the arm stays where n x > d."""
        name = name or f"--wall {' '.join(f'{one:g}' for one in numbers)}"
        length = math.hypot(*numbers[:3])
        if not (len(numbers) == 4 and length > 0.0 and all(map(math.isfinite, (*numbers, length)))):
            raise IdentificationError(f"{name}; accepted: NX NY NZ D, of which the first three are not all 0")
        x, y, z, distance = (one / length for one in numbers)
        if abs(distance) > _FARTHEST:
            raise IdentificationError(f"{name}: {abs(distance):g} m from the base; accepted: up to {_FARTHEST:g} m")
        return cls((x, y, z), distance, name)


@dataclass(frozen=True)
class OptionRange:
    """What an option accepts: a number in [low, high], a whole one if `low` is an integer, or one of the choices."""

    about: str
    low: float = 0
    high: float = 0
    choices: tuple[str, ...] = ()

    def check(self, name: str, value: object) -> None:
        """Refuse a value that is not accepted."""
        kinds = int if isinstance(self.low, int) else int | float
        noun = "an integer" if isinstance(self.low, int) else "a number"
        accepted = f"{noun} in [{self.low:g}, {self.high:g}]"
        good = isinstance(value, kinds) and not isinstance(value, bool) and self.low <= value <= self.high
        if self.choices:
            accepted = f"one of {', '.join(self.choices)}"
            good = value in self.choices
        if not good:
            raise ConfigError(f"--excitation: {name} is {quoted(value)}; accepted: {accepted}")


_NOISE = OptionRange("standard deviation of a joint's torque, Nm", 1e-6, 1e6)


@dataclass(frozen=True)
class ExcitationOptions:
    """The options of a plan; the other fields declare their meaning and range themselves.

    Attributes:
        walls: planes that links and tool stay clear of.
        torque_noise: standard deviation of the noise of each joint's torque, Nm, shape (n,); by default 1 % of the
            URDF's effort.
        validation: whether a run is planned for validation alone.
    """

    criterion: Annotated[
        str,
        OptionRange(
            "condition: condition number of the weighted columns; d: determinant of the information",
            choices=("condition", "d"),
        ),
    ] = "d"
    runs: Annotated[
        int, OptionRange("to identify from, of different speeds; one more is for the validation", 1, 20)
    ] = 3
    harmonics: Annotated[int, OptionRange("of the base frequency in each joint's series", 3, 50)] = 10
    period: Annotated[float, OptionRange("s, of the base frequency", 1.0, _LONGEST_S)] = 12.0
    periods: Annotated[int, OptionRange("of each run", 1, 100)] = 3
    share: Annotated[
        float, OptionRange("of the limits of speed, acceleration and torque that may be used", 0.05, 1.0)
    ] = 0.8
    seed: Annotated[
        int,
        OptionRange("of the random motions that the search begins with; the same seed gives the same plan", 0, 2**31),
    ] = 0
    clearance: Annotated[float, OptionRange("m, least distance to the planes", 0.0, 10.0)] = 0.02
    steps: Annotated[int, OptionRange("of the search, for each run", 2, 10_000)] = 60
    walls: tuple[Wall, ...] = ()
    torque_noise: tuple[float, ...] | None = None
    validation: bool = True

    def __post_init__(self) -> None:
        for name, accepted in DECLARED.items():
            accepted.check(name, vars(self)[name])
        DECLARED["period"].check("period times periods", self.period * self.periods)
        for value in self.torque_noise or ():
            _NOISE.check("torque-noise", value)


_hints = get_type_hints(ExcitationOptions, include_extras=True)
DECLARED: dict[str, OptionRange] = {
    name: hint.__metadata__[0] for name, hint in _hints.items() if hasattr(hint, "__metadata__")
}
"""Meaning and range of each option."""
