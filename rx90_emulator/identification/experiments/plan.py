"""The plan of a series of experiments: which motions, at which speeds and poses, and for how long."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from enum import Enum
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.config import load_yaml
from rx90_common.base.entries import Numbers, Rows
from rx90_common.base.errors import IdentificationError
from rx90_common.base.groups import Group
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles
from rx90_common.description.wrist import coupling_matrix
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.identification.experiments.motion import Motion
from rx90_emulator.identification.sliding.fit import LEAST_SPEEDS

Pose = tuple[float, ...]


def _positions(about: str) -> Group:
    return Group(about, keys={"positions": Rows("Joint positions, six for each pose.", "rad", count=6)})


POSES = Group(
    "Where the experiments of an identification take place.",
    keys={
        "home": Group(
            "Where every experiment begins and ends.",
            keys={"position": Numbers("Six joint positions.", "rad", count=6)},
        ),
        "sweeps": _positions("Where the sweeps take place."),
        "validation": _positions("Between which the validation moves."),
    },
)
"""What a poses file holds."""


@dataclass(frozen=True)
class Poses:
    """Joint positions, rad, each of shape (6,).

    Attributes:
        home: where every experiment begins and ends.
        sweeps: where the sweeps take place, at least one.
        validation: between which the validation moves.
    """

    home: Pose
    sweeps: tuple[Pose, ...]
    validation: tuple[Pose, ...]

    @classmethod
    def load(cls, file: Path) -> Poses:
        """Read a poses file.

        Raises:
            ConfigError: naming file, key, value and what is accepted.
        """
        content = POSES.read(load_yaml(file))
        return cls(content["home"]["position"], content["sweeps"]["positions"], content["validation"]["positions"])

    @classmethod
    def shipped(cls) -> Poses:
        """Return those of the RX90B."""
        return cls.load(RobotFiles().required("poses"))

    def check(self, robot: RobotModel) -> None:
        """Check that an arm reaches the poses.

        Raises:
            IdentificationError: naming pose, joint, value and limits.
        """
        if not self.sweeps:
            raise IdentificationError("no pose; accepted: one or more")
        sweeps = ((f"pose {i + 1}", pose) for i, pose in enumerate(self.sweeps))
        validation = ((f"pose {i + 1} of the validation", pose) for i, pose in enumerate(self.validation))
        for what, pose in (("home", self.home), *sweeps, *validation):
            _check_pose(robot, what, pose)


def _check_pose(robot: RobotModel, what: str, pose: Sequence[float]) -> None:
    if len(pose) != len(robot.joint_names):
        raise IdentificationError(f"{what} has {len(pose)} angles; accepted: {len(robot.joint_names)}")
    for name, value, low, high in zip(robot.joint_names, pose, robot.lower, robot.upper, strict=True):
        if not low <= value <= high:
            raise IdentificationError(
                f"{what}: {name} is {value:g} rad; accepted: [{low:.4g}, {high:.4g}], the joint's limits"
            )


_SAMPLING_PERIOD = Rates().position_period  # s, that of joint_states too
_MAX_LOG_SHIFT = 0.1  # of the logarithm of a speed, at most
_SPEED_CANDIDATES = 401
_BEAT_DENOMINATORS = (1, 2, 3, 4)
_AVERAGED_OUT = 0.25  # distance from a beat, times the denominator, beyond which the ripple averages out


def sweep_speeds(direction: Array, lowest: float, highest: float, count: int, drives: DriveParameters) -> Array:
    """Return the speeds of a direction's sweeps.

    Args:
        direction: joint velocities at speed 1, shape (6,).
        lowest: about the slowest, rad/s.
        highest: the fastest at most, rad/s.
        count: how many.
        drives: gears and encoders.

    Returns:
        Speeds, rad/s, increasing, shape (count,).
    """
    turns = drives.gear * (coupling_matrix() @ direction)
    steps = np.abs(turns) * drives.encoder_counts / (2.0 * math.pi) * _SAMPLING_PERIOD
    steps = steps[steps > 0.0]
    spacing = math.log(highest / lowest) / (count - 1)
    shift = np.linspace(-1.0, 0.0, _SPEED_CANDIDATES) * min(_MAX_LOG_SHIFT, 0.9 * spacing)
    nominal = np.geomspace(lowest, highest, count)
    return np.array([_quietest(speed * np.exp(shift), steps) for speed in nominal])


def _quietest(speeds: Array, steps: Array) -> float:
    """Return the speed at which the motors, with `steps` in a period at speed 1, shape (k,), beat least."""
    phase = np.outer(speeds, steps)
    distances = [np.abs(d * phase - np.round(d * phase)) for d in _BEAT_DENOMINATORS]
    least = np.minimum(np.min(distances, axis=(0, 2)), _AVERAGED_OUT)
    # Of equally good ones the nearest to the nominal speed, which is the last.
    return float(speeds[np.flatnonzero(least >= least.max() - 1e-12)[-1]])


_MAX_SPEEDS = 1000  # two hours for each group
_MIN_HOLD_S, _MAX_HOLD_S = 0.7, 4.0  # s at a speed: the servo loops need 0.25 s to settle
_VALIDATION_SPEED_SHARES = (0.3, 0.12, 0.04)  # of the joints' speeds, in turn
_LIMIT_MARGIN = 0.02  # rad, from a sweep to the joints' limits
_MIN_TRAVEL = 0.016  # rad at a speed: three times what a bristle needs to settle


class Kind(str, Enum):
    """What an experiment is for."""

    SLIDING = "sliding"
    PRESLIDING = "presliding"
    EXCITATION = "excitation"
    VALIDATION = "validation"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class PlanOptions:
    """What can be chosen.

    Attributes:
        speeds: how many speeds in each direction, spaced logarithmically.
        lowest_speed: slowest sweep, rad/s.
        highest_share: fastest sweep as a share of the joint's speed limit.
        travel: longest travel of a sweep at its speed, rad. Speeds near omega_s determine the curve's shape; held for
            4 s instead of 0.7 s, the torque's noise changes omega_s and delta less than half as much.
        acceleration: of sweeps and moves, rad/s².
        poses: where the experiments take place; by default those of the RX90B.
        groups: which joints, by name of the direction; all of them if empty.
        presliding_cycles: amplitudes of the slow presliding cycles, rad.
        tones: frequencies of the micro-oscillation, Hz.
        tone_amplitudes: of the micro-oscillations that follow the cycles, rad, summed over the tones. Several, because
            the controller's own Coulomb compensation may break one joint away while another one stays in presliding.
        burst: how long the micro-oscillation lasts, s.
    """

    speeds: int = 28
    lowest_speed: float = 0.004
    highest_share: float = 0.4
    travel: float = 0.6
    acceleration: float = 5.0
    poses: Poses = field(default_factory=Poses.shipped)
    groups: tuple[str, ...] = ()
    presliding_cycles: tuple[float, ...] = (4e-3, 3e-3, 2e-3, 1e-3, 5e-4)
    tones: tuple[float, ...] = (3.0, 9.0, 19.0, 33.0)
    tone_amplitudes: tuple[float, ...] = (2.4e-4, 1.2e-4, 5e-5, 1.6e-5, 6e-6)
    burst: float = 8.0

    def __post_init__(self) -> None:
        for spec in fields(self):
            value = getattr(self, spec.name)
            if isinstance(value, float) and not (math.isfinite(value) and value > 0.0):
                raise IdentificationError(f"{spec.name} is {value}; accepted: a number > 0")
        if self.travel < _MIN_TRAVEL:
            raise IdentificationError(f"travel is {self.travel} rad; accepted: {_MIN_TRAVEL} or more")
        if not LEAST_SPEEDS <= self.speeds <= _MAX_SPEEDS:
            raise IdentificationError(f"{self.speeds} speeds; accepted: {LEAST_SPEEDS} to {_MAX_SPEEDS}")
        if self.highest_share > 1.0:
            raise IdentificationError(f"highest_share is {self.highest_share}; accepted: a number in (0, 1]")
        if len(self.presliding_cycles) != len(self.tone_amplitudes) or not self.tones:
            raise IdentificationError(
                f"{len(self.presliding_cycles)} presliding cycles, {len(self.tone_amplitudes)} amplitudes of the "
                f"micro-oscillation and {len(self.tones)} tones; accepted: as many cycles as amplitudes, and a tone"
            )


@dataclass(frozen=True)
class Experiment:
    """One trajectory, recorded in a bag of its own.

    Attributes:
        name: also the name of the bag.
        kind: what it is for.
        points: the trajectory; begins and ends at rest at the home pose.
        sweeps: how many runs at constant velocity, or presliding cycles and bursts, it holds.
    """

    name: str
    kind: Kind
    points: TrajectoryPoints
    sweeps: int

    @property
    def duration(self) -> float:
        """Return how long the trajectory takes, s."""
        return float(self.points.times[-1])


@dataclass(frozen=True)
class Direction:
    """A direction in the joints' space: one joint, or joints 5 and 6 with or against each other."""

    name: str
    vector: Array = field(compare=False)


def directions(names: Sequence[str]) -> tuple[Direction, ...]:
    """Return the directions whose motions separate the seven elements.

    Element 7 has q5' + q6' as input. Joint 5 alone moves elements 5 and 7, joint 6 alone 6 and 7, both against each
    other 5 and 6 but not 7, both together all three, 7 at twice the speed.
    """
    unit = np.eye(len(names))
    found = [Direction(name, unit[i]) for i, name in enumerate(names)]
    pair = "_".join(names[k].removeprefix("joint_") for k in (4, 5))
    found.append(Direction(f"joints_{pair}_together", unit[4] + unit[5]))
    found.append(Direction(f"joints_{pair}_against", unit[4] - unit[5]))
    return tuple(found)


def make_plan(robot: RobotModel, drives: DriveParameters, options: PlanOptions | None = None) -> tuple[Experiment, ...]:
    """Plan all experiments for an arm.

    Raises:
        IdentificationError: for an option or a pose that does not fit the arm.
    """
    chosen = options or PlanOptions()
    chosen.poses.check(robot)
    known = directions(robot.joint_names)
    names = [direction.name for direction in known]
    for name in chosen.groups:
        if name not in names:
            raise IdentificationError(f"unknown group {quoted(name)}; accepted: {', '.join(names)}")
    picked = [direction for direction in known if not chosen.groups or direction.name in chosen.groups]
    plan = [_sliding(robot, drives, chosen, direction) for direction in picked]
    plan += [_presliding(robot, chosen, direction) for direction in picked if "together" not in direction.name]
    plan.append(_validation(robot, chosen))
    return tuple(plan)


def _sliding(robot: RobotModel, drives: DriveParameters, options: PlanOptions, direction: Direction) -> Experiment:
    motion = Motion(options.poses.home)
    highest = _fastest(robot, options, direction)
    speeds = sweep_speeds(direction.vector, options.lowest_speed, highest, 2 * options.speeds, drives)
    # Many speeds, each in one direction at one pose, rather than few everywhere: the error by ripple in step with the
    # sampling differs between speeds, not between poses, and changes its sign with the direction.
    there_and_back = speeds.reshape(-1, 2) * (1.0, -1.0)
    for number, pose in enumerate(options.poses.sweeps):
        for speed in there_and_back[number :: len(options.poses.sweeps)].ravel():
            _approach(robot, options, motion, _start(robot, options, direction, pose, float(speed)))
            motion.rest(0.1)
            motion.sweep(direction.vector, float(speed), _held(options, speed), options.acceleration)
    _approach(robot, options, motion, options.poses.home)
    return Experiment(f"sliding_{direction.name}", Kind.SLIDING, motion.points(robot.joint_names), len(speeds))


def _held(options: PlanOptions, speed: float) -> float:
    """Return for how long a speed is held, s."""
    return float(np.clip(options.travel / abs(speed), _MIN_HOLD_S, _MAX_HOLD_S))


def _fastest(robot: RobotModel, options: PlanOptions, direction: Direction) -> float:
    """Return the fastest sweep, rad/s: less than the share of the speed limit where the joints' ranges ask for it."""
    speed = options.highest_share * float(robot.max_velocity[direction.vector != 0.0].min())
    while np.any(np.abs(_travel(options, direction, speed)) > robot.upper - robot.lower - 2.0 * _LIMIT_MARGIN):
        speed *= 0.98
    return speed


def _travel(options: PlanOptions, direction: Direction, speed: float) -> Array:
    """Return how far a sweep at a signed speed moves the joints, its ramps included, rad."""
    probe = Motion(np.zeros(direction.vector.size))
    probe.sweep(direction.vector, speed, _held(options, speed), options.acceleration)
    return probe.pose


def _start(robot: RobotModel, options: PlanOptions, direction: Direction, pose: Sequence[float], speed: float) -> Array:
    """Return where a sweep at a signed speed begins, so that its travel is centred on the pose."""
    travel = _travel(options, direction, speed)
    # Near a limit the travel moves away from it.
    low, high = robot.lower + _LIMIT_MARGIN, robot.upper - _LIMIT_MARGIN
    begin = np.asarray(pose) - travel / 2.0
    return np.clip(begin, low + np.maximum(0.0, -travel), high - np.maximum(0.0, travel))


def _presliding(robot: RobotModel, options: PlanOptions, direction: Direction) -> Experiment:
    motion = Motion(options.poses.home)
    pose = np.asarray(options.poses.sweeps[0])
    _approach(robot, options, motion, pose - 0.03 * direction.vector)
    motion.rest(0.2)
    count = 0
    # Sliding first: the deflection of the bristles then does not depend on what was before.
    motion.sweep(direction.vector, 0.05, 0.6, options.acceleration)
    for amplitude, tone_amplitude in zip(options.presliding_cycles, options.tone_amplitudes, strict=True):
        # Each one fades out, which leaves the bristles near zero. Bristles under load would creep, by vibrations that
        # are below the resolution of the encoders.
        motion.oscillate(direction.vector, [amplitude], [1.0], 2.0)
        amplitudes = [tone_amplitude / len(options.tones)] * len(options.tones)
        motion.oscillate(direction.vector, amplitudes, options.tones, options.burst)
        count += 2
    motion.rest(0.2)
    _approach(robot, options, motion, options.poses.home)
    return Experiment(f"presliding_{direction.name}", Kind.PRESLIDING, motion.points(robot.joint_names), count)


def _validation(robot: RobotModel, options: PlanOptions) -> Experiment:
    """Return moves of all joints at once that no other experiment has: fast, slow, with reversals."""
    motion = Motion(options.poses.home)
    for number, pose in enumerate(options.poses.validation):
        share = _VALIDATION_SPEED_SHARES[number % len(_VALIDATION_SPEED_SHARES)]
        motion.move(pose, robot.max_velocity * share, options.acceleration)
        motion.rest(0.15)
    wave = np.array([0.02, -0.015, 0.02, -0.03, 0.03, -0.02])
    motion.oscillate(wave, [1.0], [0.5], 6.0)
    motion.rest(0.2)
    _approach(robot, options, motion, options.poses.home)
    count = len(options.poses.validation) + 1
    return Experiment("validation", Kind.VALIDATION, motion.points(robot.joint_names), count)


def _approach(robot: RobotModel, options: PlanOptions, motion: Motion, pose: Sequence[float] | Array) -> None:
    motion.move(pose, 0.3 * robot.max_velocity, options.acceleration)
