"""The robot that bags come from, as the command line describes it: this project's, or any other."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rx90_bag.reading import BagReader
from rx90_bag.topics import absolute
from rx90_common.config import load_yaml
from rx90_common.share import resolve_config
from rx90_exchange.topics import MOTOR_STATES
from rx90_identification.errors import IdentificationError
from rx90_identification.reading import BagLayout
from rx90_identification.rigid_arm import RigidArm
from rx90_loop.setup import Setup, SetupFiles
from rx90_sim.friction import LuGreElement
from rx90_sim.friction.friction_set import load_element

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Robot:
    """What is known of the robot.

    Attributes:
        arm: rigid-body model and friction elements.
        setup: for the closed loop; None for another robot than this project's.
        own_layout: of the messages of another robot.
        fallback: elements whose values stand in for what the data do not tell.
        fallback_name: their file.
    """

    arm: RigidArm
    setup: Setup | None
    own_layout: BagLayout | None
    fallback: tuple[LuGreElement, ...] | None
    fallback_name: str | None

    def layout(self, bag: Path, *, fast: bool) -> BagLayout:
        """Return what to read of a bag: the motors' states where the rate matters and they are there."""
        if self.own_layout is not None:
            return self.own_layout
        assert self.setup is not None
        motors, joints = BagLayout.rx90_motors(self.setup), BagLayout.rx90_joints(self.setup)
        with BagReader(bag) as reader:
            there = {topic.name for topic in reader.topics}
        choice = [motors, joints] if fast else [joints, motors]
        for layout in choice:
            if absolute(layout.topic) in there:
                return layout
        raise IdentificationError(
            f"{bag}: neither {MOTOR_STATES} nor joint_states; there are {', '.join(sorted(there)) or 'no topics'}"
        )


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe the robot."""
    robot = parser.add_argument_group("this project's robot")
    robot.add_argument("--tool", help="tool file, or none (shipped laser head)")
    robot.add_argument("--drives", help="drives file")
    robot.add_argument("--fallback", metavar="FILE",
                       help="friction file for omega_d and for what the bags do not tell, or none (shipped for this "
                       "project's robot, none for another)")  # fmt: skip
    other = parser.add_argument_group("another robot")
    other.add_argument("--urdf", type=Path, help="its URDF; turns the options of this group on")
    other.add_argument("--topic", default="joint_states", help="JointState topic (%(default)s)")
    other.add_argument("--joints", nargs="+", metavar="NAME", help="joints from base to tip (all movable ones)")
    other.add_argument("--names", nargs="+", metavar="NAME", help="their names in the messages (as --joints)")
    other.add_argument("--gear", nargs="+", type=float, metavar="N",
                       help="motor turns per joint turn; the messages hold motor-side values")  # fmt: skip
    other.add_argument("--coupling", nargs="+", type=float, metavar="C",
                       help="motor turns per joint turn without gears, row by row, n x n (identity)")  # fmt: skip
    other.add_argument("--torque-constant", nargs="+", type=float, metavar="K",
                       help="torque per unit of effort, where effort is a current")  # fmt: skip
    other.add_argument("--rotor-inertia", nargs="+", type=float, metavar="J", help="seen through the gear, kg m^2 (0)")
    other.add_argument("--spring", nargs="+", type=float, metavar="K", help="torque -K sin(q) on each joint, Nm (0)")
    parser.add_argument("--torque-delay", type=float, default=0.0, metavar="S",
                        help="how much later than its stamp a recorded torque acted, s (%(default)s)")  # fmt: skip


def robot_of(options: argparse.Namespace) -> Robot:
    """Return the robot that the options describe.

    Raises:
        IdentificationError: if they do not fit each other.
        ConfigError: for a file that cannot be used.
    """
    return _own(options) if options.urdf is None else _other(options)


def _own(options: argparse.Namespace) -> Robot:
    for name in ("joints", "names", "gear", "coupling", "torque_constant", "rotor_inertia", "spring"):
        if getattr(options, name) is not None:
            raise IdentificationError(
                f"--{name.replace('_', '-')} without --urdf; accepted: with --urdf of another robot"
            )
    files: dict[str, Path | None] = {}
    if options.tool is not None:
        files["tool"] = None if options.tool == "none" else resolve_config(options.tool)
    if options.drives is not None:
        files["drives"] = resolve_config(options.drives)
    setup = Setup.load(SetupFiles(**files))  # type: ignore[arg-type]
    arm = RigidArm.from_setup(setup)
    name = options.fallback or "robot/friction.yaml"
    return Robot(arm, setup, None, *_fallback(name, arm))


def _other(options: argparse.Namespace) -> Robot:
    joints = options.joints
    plain = RigidArm.from_urdf(options.urdf, joints)
    n = len(plain.names)
    for name, size in (
        ("names", n), ("gear", n), ("torque_constant", n), ("rotor_inertia", n), ("spring", n), ("coupling", n * n),
    ):  # fmt: skip
        values = getattr(options, name)
        if values is not None and len(values) != size:
            raise IdentificationError(
                f"--{name.replace('_', '-')}: {len(values)} values; accepted: {size} for {n} joints"
            )
    if options.coupling is not None and options.gear is None:
        raise IdentificationError("--coupling without --gear; accepted: both, for messages with motor-side values")
    coupling = None if options.coupling is None else np.array(options.coupling).reshape(n, n)
    arm = RigidArm.from_urdf(options.urdf, joints, coupling, options.rotor_inertia, options.spring)
    constant = None if options.torque_constant is None else np.array(options.torque_constant)
    messages = tuple(options.names or arm.names)
    if options.gear is None:
        layout = BagLayout(options.topic, messages, arm.names, None, constant)
    else:
        layout = BagLayout.motor_side(options.topic, messages, arm.names, np.array(options.gear), coupling, constant)
    return Robot(arm, None, layout, *_fallback(options.fallback or "none", arm))


def _fallback(name: str, arm: RigidArm) -> tuple[tuple[LuGreElement, ...] | None, str | None]:
    if name == "none":
        return None, None
    section = load_yaml(resolve_config(name)).section("elements")
    return tuple(load_element(section.section(element)) for element in arm.element_names), name
