"""The robot that bags come from: this project's, or any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
from rx90_emulator.identification.arm import RigidArm, joint_model
from rx90_emulator.identification.layout import (
    JOINT_STATES,
    BagLayout,
    arm_layout,
    check_sizes,
    recorded_topic,
    with_signals,
)
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.loop.setup import Setup

_DEFAULT_OPTIONS = RobotOptions()


@dataclass(frozen=True, eq=False)
class RecordedRobot:
    """What is known of the robot that bags come from.

    Attributes:
        arm: rigid-body model and friction elements.
        setup: for the closed loop; None for another robot than this project's.
        options: what the messages hold where it is not as here, signal maps included.
        fallback: elements whose values stand in for parameters that are not identifiable, bristles of another kind
            with their c0, and whose omega_d is taken over; None to refuse bags that leave such parameters.
        fallback_name: their file.
        mapping: what the columns of tables hold, where that is not in the files beside them.
    """

    arm: RigidArm
    setup: Setup | None = None
    options: RobotOptions = _DEFAULT_OPTIONS
    fallback: tuple[FrictionElement, ...] | None = None
    fallback_name: str | None = None
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
        own = options.urdf is None
        for name in ("joints", "rotor_inertia", "spring") if own else ("robot", "tool", "drives"):
            if getattr(options, name) is not None:
                what = "without --urdf; accepted: with --urdf of another robot"
                what = what if own else "with --urdf; accepted: for this project's robot alone"
                raise IdentificationError(f"--{name.replace('_', '-')} {what}")
        if options.urdf is None:
            files = RobotFiles.of_options(options)
            setup = Setup.load(files)
            arm, name = RigidArm.from_setup(setup), options.fallback or files.text("friction")
            check_sizes(options, len(arm.names))
        else:
            setup, name = None, options.fallback or "none"
            model = joint_model(Path(options.urdf), options.joints, massless=massless)
            n = model.njoints - 1
            check_sizes(options, n)
            coupling = None if options.coupling is None else np.reshape(options.coupling, (n, n))
            arm = RigidArm.of_model(model, coupling, options.rotor_inertia, options.spring)
            arm_layout(options.topic or JOINT_STATES, arm.names, options)  # refused before any bag is read
        fallback = None
        if name != "none":
            fallback = FrictionFile.read(resolve_config(name)).select(arm.element_names)
            named = dict(zip(arm.element_names, fallback, strict=True))
            what = "an identification with it as --fallback"
            refuse_parts(named, what, f"{name}: elements.", held=("bristles",))
        return cls(arm, setup, options, fallback, None if fallback is None else name, mapping)

    @property
    def zero(self) -> Array | None:
        """Return the recorded angle of each joint where that of its URDF is 0, rad, shape (n,); None for 0."""
        return None if self.options.zero is None else np.array(self.options.zero, dtype=np.float64)

    @property
    def torque_delay(self) -> float:
        """Return by how much a torque acted later than in the sample period that ends at its stamp, s."""
        return self.options.torque_delay

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
        setup, topic = self.setup, self.options.topic
        if setup is None:
            topic = topic or JOINT_STATES
            topic = recorded_topic(bag, (topic,), self.mapping) if is_table(bag) else topic
            return arm_layout(topic, self.arm.names, self.options, None, self.mapping)
        check_robot(bag, setup.robot.model.name)
        topics = (MOTOR_STATES, JOINT_STATES) if fast else (JOINT_STATES, MOTOR_STATES)
        topic = topic or recorded_topic(bag, topics, self.mapping)
        return arm_layout(topic, self.arm.names, self.options, lambda: setup.drives.gear, self.mapping)
