"""The plan of sweeps, micro-oscillations and a validation: motions, speeds, poses and durations."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from rx90_common.base.arrays import Array
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import IdentificationError
from rx90_common.base.models import FileModel, Names, read_model
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import Rates
from rx90_common.description.coupling import Coupling
from rx90_common.description.drives import DriveParameters
from rx90_common.description.poses import Poses
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles
from rx90_common.process.files import file_stem, write_text
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.motion import Motion
from rx90_emulator.loop.setup import Setup


class Kind(str, Enum):
    """Purpose of an experiment."""

    SLIDING = "sliding"
    PRESLIDING = "presliding"
    EXCITATION = "excitation"
    VALIDATION = "validation"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class Experiment:
    """One trajectory, recorded in a bag of its own.

    Attributes:
        name: also the name of the bag.
        kind: its purpose.
        points: the trajectory; begins and ends at rest at the home pose.
        sweeps: number of its runs at constant velocity, presliding cycles and bursts, or periods.
    """

    name: str
    kind: Kind
    points: TrajectoryPoints
    sweeps: int

    @property
    def duration(self) -> float:
        """Return how long the trajectory takes, s."""
        return float(self.points.times[-1])


def poses_of(setup: Setup) -> Poses:
    """Return the poses of a robot, checked to be within its limits."""
    poses = Poses.load(setup.files.required("poses"))
    poses.check(setup.robot)
    return poses


@dataclass(frozen=True)
class PlanOptions:
    """The options of a plan.

    Attributes:
        speeds: number of speeds in each direction, spaced logarithmically.
        travel: longest travel of a sweep at its speed, rad. Speeds near omega_s determine the curve's shape; if they
            last 4 s instead of 0.7 s, the torque's noise changes omega_s and delta less than half as much.
        poses: of the experiments; by default those of the RX90B.
        groups: of joints, by name of the direction; all of them if empty.
        presliding_cycles: amplitudes of the slow presliding cycles, rad.
        tone_amplitudes: of the micro-oscillation that follows each cycle, rad, summed over the tones. Several, because
            the controller's own Coulomb compensation may break one joint away while another one stays in presliding.
        burst: duration of a micro-oscillation, s.
    """

    speeds: int = 28
    travel: float = 0.6
    poses: Poses = field(default_factory=lambda: Poses.load(RobotFiles().required("poses")))
    groups: tuple[str, ...] = ()
    presliding_cycles: tuple[float, ...] = (4e-3, 3e-3, 2e-3, 1e-3, 5e-4)
    tone_amplitudes: tuple[float, ...] = (2.4e-4, 1.2e-4, 5e-5, 1.6e-5, 6e-6)
    burst: float = 8.0


_QUICK: Mapping[str, Any] = MappingProxyType(
    {
        "speeds": 8,
        "travel": 0.016,
        "presliding_cycles": (2e-3,),
        "tone_amplitudes": (4e-5,),
        "burst": 3.0,
    }
)


def plan_experiments(
    setup: Setup, groups: Sequence[str] = (), *, quick: bool = False
) -> tuple[Experiment, ...]:
    """Return the experiments for an arm.

    Args:
        setup: robot and drives, read from files; one of the files contains the poses.
        groups: names of directions; all of them if empty.
        quick: whether fewer speeds, one pose and one micro-oscillation suffice.

    Raises:
        IdentificationError: for an unknown group.
        ConfigError: if the robot has no poses.
    """
    poses = poses_of(setup)
    options = dict(_QUICK) if quick else {}
    if quick:
        poses = poses.replaced(sweeps={"positions": poses.sweeps.positions[:1]})
    return make_plan(
        setup.robot, setup.drives, PlanOptions(poses=poses, groups=tuple(groups), **options)
    )


def directions(names: Sequence[str], turning: Coupling) -> dict[str, Array]:
    """Return joint velocities, shape (n,), by name: directions whose motions separate the friction elements.

    Element 7 of the RX family has q5' + q6' as input. Joint 5 alone moves elements 5 and 7, joint 6 alone 6 and 7, both
    against each other 5 and 6 but not 7, both together all three, 7 at twice the speed.
    """
    unit = np.eye(len(names))
    vectors = dict(zip(names, unit, strict=True))
    for motor in turning.sums:
        first, *others = np.flatnonzero(turning.turns[motor]).tolist()
        together = "_".join(names[k].removeprefix("joint_") for k in (first, *others))
        signs = np.sign(turning.turns[motor])
        vectors[f"joints_{together}_together"] = signs * signs[first]
        vectors[f"joints_{together}_against"] = 2.0 * unit[first] - signs * signs[first]
    return vectors


_SAMPLING_PERIOD = Rates().position_period  # s, that of joint_states too
_MAX_LOG_SHIFT = 0.1  # of the logarithm of a speed
_SPEED_CANDIDATES = 401
_BEAT_DENOMINATORS = (1, 2, 3, 4)
# distance from a beat, times the denominator, beyond which the ripple averages out
_AVERAGED_OUT = 0.25


def sweep_speeds(
    direction: Array, lowest: float, highest: float, count: int, drives: DriveParameters
) -> Array:
    """Return the speeds of a direction's sweeps, logarithmically spaced and shifted to where the encoders beat least.

    Args:
        direction: joint velocities at speed 1, shape (n,).
        lowest: approximate slowest speed, rad/s.
        highest: limit of the fastest speed, rad/s.
        count: number of speeds.
        drives: gears and encoders.

    Returns:
        Speeds, rad/s, increasing, shape (count,).
    """
    turns = drives.gear * (drives.turning.turns @ direction)
    steps = np.abs(turns) * drives.encoder_counts / (2.0 * math.pi) * _SAMPLING_PERIOD
    steps = steps[steps > 0.0]
    spacing = math.log(highest / lowest) / (count - 1)
    shift = np.linspace(-1.0, 0.0, _SPEED_CANDIDATES) * min(_MAX_LOG_SHIFT, 0.9 * spacing)
    quietest = []
    for nominal in np.geomspace(lowest, highest, count):
        speeds = nominal * np.exp(shift)
        phase = np.outer(speeds, steps)
        distances = [np.abs(d * phase - np.round(d * phase)) for d in _BEAT_DENOMINATORS]
        least = np.minimum(np.min(distances, axis=(0, 2)), _AVERAGED_OUT)
        # Of equally good speeds the nearest to the nominal one, which is the last.
        quietest.append(float(speeds[np.flatnonzero(least >= least.max() - 1e-12)[-1]]))
    return np.array(quietest)


# rad/s of the slowest sweep; of the joint's speed limit of the fastest
_LOWEST_SPEED = 0.004
_HIGHEST_SHARE = 0.4
_ACCELERATION = 5.0  # rad/s², of sweeps and moves
_TONES = (3.0, 9.0, 19.0, 33.0)  # Hz, of a micro-oscillation
# s at a speed: the servo loops need 0.25 s to settle
_MIN_HOLD_S = 0.7
_MAX_HOLD_S = 4.0
_VALIDATION_SPEED_SHARES = (0.3, 0.12, 0.04)  # of the joints' speeds, in turn
_VALIDATION_WAVE = (0.02, -0.015, 0.02, -0.03, 0.03, -0.02, 0.025)  # rad, of the joints, 0.5 Hz
_LIMIT_MARGIN = 0.02  # rad, from a sweep to the joints' limits


def make_plan(
    robot: RobotModel, drives: DriveParameters, options: PlanOptions | None = None
) -> tuple[Experiment, ...]:
    """Plan all experiments for an arm."""
    options = options or PlanOptions()
    options.poses.check(robot)
    vectors = directions(robot.joint_names, drives.turning)
    for name in options.groups:
        if name not in vectors:
            raise IdentificationError(
                f"unknown group {quoted(name)}; accepted: {', '.join(vectors)}"
            )
    groups = [name for name in vectors if not options.groups or name in options.groups]
    plan = [_sweeps(robot, drives, options, name, vectors[name]) for name in groups]
    plan += [
        _oscillations(robot, options, name, vectors[name])
        for name in groups
        if "together" not in name
    ]
    plan.append(_validation(robot, options))
    return tuple(plan)


def _experiment(
    robot: RobotModel, name: str, kind: Kind, motion: Motion, sweeps: int, options: PlanOptions
) -> Experiment:
    _approach(robot, motion, options.poses.home.position)
    return Experiment(file_stem(name), kind, motion.points(robot.joint_names), sweeps)


def _sweeps(
    robot: RobotModel, drives: DriveParameters, options: PlanOptions, name: str, direction: Array
) -> Experiment:
    """Return the sweeps of a direction: many speeds, each in one direction at one pose, rather than few everywhere.

    The error by ripple that is synchronous with the sampling differs between speeds, not between poses, and changes its
    sign with the direction.
    """
    fastest = _HIGHEST_SHARE * float(robot.max_velocity[direction != 0.0].min())
    low = robot.lower + _LIMIT_MARGIN
    high = robot.upper - _LIMIT_MARGIN
    while np.any(
        np.abs(_sweep(Motion(np.zeros(direction.size)), direction, fastest, options)) > high - low
    ):
        fastest *= 0.98
    speeds = sweep_speeds(direction, _LOWEST_SPEED, fastest, 2 * options.speeds, drives)
    there_and_back = speeds.reshape(-1, 2) * (1.0, -1.0)
    motion = Motion(options.poses.home.position)
    poses = options.poses.sweeps.positions
    for number, pose in enumerate(poses):
        for speed in there_and_back[number :: len(poses)].ravel().tolist():
            # The travel is centred on the pose; near a limit it moves away from it.
            way = _sweep(Motion(np.zeros(direction.size)), direction, speed, options)
            first = low + np.maximum(0.0, -way)
            last = high - np.maximum(0.0, way)
            start = np.clip(np.asarray(pose) - way / 2.0, first, last)
            _approach(robot, motion, start)
            motion.rest(0.1)
            _sweep(motion, direction, speed, options)
    return _experiment(robot, f"sliding_{name}", Kind.SLIDING, motion, len(speeds), options)


def _sweep(motion: Motion, direction: Array, speed: float, options: PlanOptions) -> Array:
    """Add a sweep to a motion and return its end, rad, shape (n,)."""
    held = float(np.clip(options.travel / abs(speed), _MIN_HOLD_S, _MAX_HOLD_S))
    motion.sweep(direction, speed, held, _ACCELERATION)
    return motion.pose


def _oscillations(
    robot: RobotModel, options: PlanOptions, name: str, direction: Array
) -> Experiment:
    """Return presliding cycles and micro-oscillations of a direction."""
    motion = Motion(options.poses.home.position)
    _approach(robot, motion, np.asarray(options.poses.sweeps.positions[0]) - 0.03 * direction)
    motion.rest(0.2)
    # Sliding first: the deflection of the bristles then does not depend on the earlier motion.
    motion.sweep(direction, 0.05, 0.6, _ACCELERATION)
    for amplitude, tone_amplitude in zip(
        options.presliding_cycles, options.tone_amplitudes, strict=True
    ):
        # Each one fades out, which leaves the bristles near zero. Bristles under load would creep, due to vibrations
        # below the resolution of the encoders.
        motion.oscillate(direction, [amplitude], [1.0], 2.0)
        motion.oscillate(
            direction, [tone_amplitude / len(_TONES)] * len(_TONES), _TONES, options.burst
        )
    motion.rest(0.2)
    count = 2 * len(options.tone_amplitudes)
    return _experiment(robot, f"presliding_{name}", Kind.PRESLIDING, motion, count, options)


def _validation(robot: RobotModel, options: PlanOptions) -> Experiment:
    """Return moves of all joints at once that no other experiment contains: fast, slow, with reversals."""
    motion = Motion(options.poses.home.position)
    poses = options.poses.validation.positions
    for number, pose in enumerate(poses):
        share = _VALIDATION_SPEED_SHARES[number % len(_VALIDATION_SPEED_SHARES)]
        motion.move(pose, robot.max_velocity * share, _ACCELERATION)
        motion.rest(0.15)
    motion.oscillate(np.array(_VALIDATION_WAVE[: len(robot.joint_names)]), [1.0], [0.5], 6.0)
    motion.rest(0.2)
    return _experiment(robot, "validation", Kind.VALIDATION, motion, len(poses) + 1, options)


def _approach(robot: RobotModel, motion: Motion, pose: ArrayLike) -> None:
    motion.move(pose, 0.3 * robot.max_velocity, _ACCELERATION)


INDEX = "experiments.yaml"


class ExperimentsFile(FileModel):
    """The bags of a series of experiments by use, as rx90 experiment writes it: names in the same folder."""

    sliding: Annotated[Names, Field(description="Sweeps at constant velocity.")]
    presliding: Annotated[Names, Field(description="Micro-oscillations.")]
    excitation: Annotated[Names, Field(description="Excitation runs.")] = ()
    validation: Annotated[Names, Field(description="Runs for the validation.")]


_WITH_SET_POINTS = ("motor_states", "rx90_controller/reference", "robot_description")
TOPICS = {
    Kind.SLIDING: ("joint_states", "robot_description"),
    Kind.PRESLIDING: ("motor_states", "robot_description"),
    Kind.EXCITATION: _WITH_SET_POINTS,
    Kind.VALIDATION: _WITH_SET_POINTS,
}
"""Recorded topics: sweeps do not need the base rate, which keeps their bags small.

Excitation runs and the validation do: each period of the set-points begins with a jump of torque that grows with the
acceleration, and samples synchronous with the set-points always fall on that jump."""


@dataclass(frozen=True)
class IdentificationBags:
    """Bags by use: sweeps, micro-oscillations, runs for the validation, and excitation runs."""

    sliding: tuple[Path, ...]
    presliding: tuple[Path, ...] = ()
    validation: tuple[Path, ...] = ()
    excitation: tuple[Path, ...] = ()

    @classmethod
    def of(
        cls,
        sliding: Iterable[Path | str],
        presliding: Iterable[Path | str] = (),
        validation: Iterable[Path | str] = (),
    ) -> IdentificationBags:
        """Return bags given by their names."""
        return cls(
            tuple(map(Path, sliding)), tuple(map(Path, presliding)), tuple(map(Path, validation))
        )


def write_index(folder: Path, done: Sequence[Experiment]) -> None:
    """Write the uses of the bags recorded so far; after each experiment, so that a series may be interrupted."""
    bags = {
        str(kind): [experiment.name for experiment in done if experiment.kind is kind]
        for kind in Kind
    }
    if not bags["excitation"]:
        del bags["excitation"]
    write_text(folder / INDEX, yaml_text(bags))


def read_index(folder: Path) -> IdentificationBags:
    """Return the bags of a series."""
    if not os.path.lexists(folder / INDEX):
        raise IdentificationError(
            f"{folder}: no {INDEX}; accepted: a folder that rx90 experiment wrote, or bags by their use"
        )
    index = read_model(ExperimentsFile, folder / INDEX)
    uses = (index.sliding, index.presliding, index.validation, index.excitation)
    for name in sum(uses, ()):
        if not (folder / name).exists():
            raise IdentificationError(f"{folder / INDEX} names {plain(name)}, which is not there")
    return IdentificationBags(*(tuple(folder / name for name in names) for names in uses))
