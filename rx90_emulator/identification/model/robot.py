"""The robot that bags come from: this project's, or any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rx90_common.bags.mapping import LogMapping, is_table
from rx90_common.bags.recorded import check_robot
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.topics import MOTOR_STATES
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.friction_set import refuse_parts
from rx90_emulator.identification.model.arm_layout import NO_OPTIONS, MessageOptions, arm_layout, with_signals
from rx90_emulator.identification.model.options import RobotOptions
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.records.layout import JOINT_STATES, BagLayout, recorded_topic
from rx90_emulator.loop.setup import Setup


@dataclass(frozen=True, eq=False)
class RecordedRobot:
    """What is known of the robot that bags come from.

    Attributes:
        arm: rigid-body model and friction elements.
        setup: for the closed loop; None for another robot than this project's.
        own_layout: of the messages of another robot.
        options: what the messages of this project's robot hold where it is not as here.
        mapping: what the columns of tables hold, where that is not in the files beside them.
        fallback: elements whose values stand in for parameters that are not identifiable, bristles of another kind
            with their c0, and whose omega_d is taken over; None to refuse bags that leave such parameters.
        fallback_name: their file.
        torque_delay: by how much a torque acted later than in the sample period that ends at its stamp, s.
        record_time: whether the times of recording replace the stamps in the headers.
        zero: recorded angle of each joint where that of its URDF is 0, rad, shape (n,); None for 0.
    """

    arm: RigidArm
    setup: Setup | None
    own_layout: BagLayout | None
    fallback: tuple[FrictionElement, ...] | None
    fallback_name: str | None
    torque_delay: float = 0.0
    record_time: bool = False
    zero: Array | None = None
    options: MessageOptions = NO_OPTIONS
    mapping: LogMapping | None = None

    @classmethod
    def load(cls, options: RobotOptions, logs: Sequence[Path] = (), *, massless: bool = False) -> RecordedRobot:
        """Return the robot that the options describe.

        Args:
            options: of the command.
            logs: bags and tables of the robot; what maps beside tables say of the arm counts as the options do.
            massless: whether links without <inertial> are accepted, because only kinematics are wanted.

        Raises:
            IdentificationError: if they do not fit each other.
            ConfigError: for a file that cannot be used.
        """
        options, mapping = with_signals(options, logs)
        robot = _own(options) if options.urdf is None else _other(options, Path(options.urdf), massless=massless)
        robot = replace(robot, mapping=mapping)
        if options.zero is None:
            return robot
        n = len(robot.arm.names)
        if len(options.zero) != n:
            raise IdentificationError(f"--zero: {len(options.zero)} values; accepted: {n} for {n} joints")
        return replace(robot, zero=np.array(options.zero, dtype=np.float64))

    @property
    def plant_period(self) -> float | None:
        """Return the tick of this project's plant, s; None for another robot."""
        return None if self.setup is None else self.setup.rates.period

    def layout(self, bag: Path, *, fast: bool) -> BagLayout:
        """Return what to read of a bag: the motors' states where the rate matters and they are there.

        Raises:
            BagError: if the bag cannot be read, or is another robot's.
            IdentificationError: if it holds neither motor nor joint states.
        """
        if self.own_layout is not None:
            topic = (
                recorded_topic(bag, (self.own_layout.topic,), self.mapping) if is_table(bag) else self.own_layout.topic
            )
            return replace(
                self.own_layout, topic=topic, record_time=self.record_time, zero=self.zero, mapping=self.mapping
            )
        assert self.setup is not None
        setup = self.setup
        check_robot(bag, setup.robot.model.name)
        topics = (MOTOR_STATES, JOINT_STATES) if fast else (JOINT_STATES, MOTOR_STATES)
        topic = self.options.topic or recorded_topic(bag, topics, self.mapping)
        return arm_layout(topic, setup.robot.joint_names, self.options, lambda: setup.drives.gear, self.mapping)


def _own(options: RobotOptions) -> RecordedRobot:
    for name in ("joints", "rotor_inertia", "spring"):
        if getattr(options, name) is not None:
            raise IdentificationError(
                f"--{name.replace('_', '-')} without --urdf; accepted: with --urdf of another robot"
            )
    files = RobotFiles.of_options(options)
    setup = Setup.load(files)
    arm = RigidArm.from_setup(setup)
    name = options.fallback or files.text("friction")
    return RecordedRobot(arm, setup, None, *_fallback(name, arm), options.torque_delay, options.record_time,
                         options=options)  # fmt: skip


def _other(options: RobotOptions, urdf: Path, *, massless: bool) -> RecordedRobot:
    for name in ("robot", "tool", "drives"):
        if getattr(options, name) is not None:
            raise IdentificationError(f"--{name} with --urdf; accepted: for this project's robot alone")
    n = len(RigidArm.from_urdf(urdf, options.joints, massless=massless).names)
    for name, size in (
        ("names", n), ("gear", n), ("torque_constant", n), ("rotor_inertia", n), ("spring", n), ("coupling", n * n),
    ):  # fmt: skip
        values = getattr(options, name)
        if values is not None and len(values) != size:
            raise IdentificationError(
                f"--{name.replace('_', '-')}: {len(values)} values; accepted: {size} for {n} joints"
            )
    coupling = None if options.coupling is None else np.array(options.coupling).reshape(n, n)
    motors = coupling, options.rotor_inertia, options.spring
    arm = RigidArm.from_urdf(urdf, options.joints, *motors, massless=massless)
    constant = None if options.torque_constant is None else np.array(options.torque_constant)
    messages, topic = tuple(options.names or arm.names), options.topic or JOINT_STATES
    gear = None if options.gear is None else np.array(options.gear)
    layout = BagLayout.of(topic, messages, arm.names, gear, coupling, constant)
    fallback = _fallback(options.fallback or "none", arm)
    return RecordedRobot(arm, None, layout, *fallback, options.torque_delay, options.record_time)


def _fallback(name: str, arm: RigidArm) -> tuple[tuple[FrictionElement, ...] | None, str | None]:
    if name == "none":
        return None, None
    elements = FrictionFile.read(resolve_config(name)).select(arm.element_names)
    refuse_parts(
        dict(zip(arm.element_names, elements, strict=True)),
        "an identification with it as --fallback",
        f"{name}: elements.",
        held=("bristles",),
    )
    return elements, name
