"""The robot that bags come from, as the command line describes it: this project's, or any other."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
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

_LONGEST_DELAY = 0.05  # s; more is a slip of the unit


@dataclass(frozen=True, eq=False)
class Robot:
    """What is known of the robot.

    Attributes:
        arm: rigid-body model and friction elements.
        setup: for the closed loop; None for another robot than this project's.
        own_layout: of the messages of another robot.
        fallback: elements whose values stand in for what the data do not tell.
        fallback_name: their file.
        record_time: whether the times of recording are taken for the stamps.
    """

    arm: RigidArm
    setup: Setup | None
    own_layout: BagLayout | None
    fallback: tuple[LuGreElement, ...] | None
    fallback_name: str | None
    record_time: bool = False

    def layout(self, bag: Path, *, fast: bool) -> BagLayout:
        """Return what to read of a bag: the motors' states where the rate matters and they are there."""
        return replace(self._layout(bag, fast=fast), record_time=self.record_time)

    def _layout(self, bag: Path, *, fast: bool) -> BagLayout:
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


def number(accepted: str, good: Callable[[float], bool] = lambda _: True) -> Callable[[str], float]:
    """Return a type for argparse: finite numbers for which `good` holds.

    Args:
        accepted: what is, in words, for the refusal.
        good: which finite numbers are.
    """

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and good(value)):
            raise argparse.ArgumentTypeError(f"{text!r}; accepted: {accepted}")
        return value

    return parse


_NOT_ZERO = number("a finite number other than 0", lambda value: value != 0.0)
_FINITE = number("a finite number")


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe the robot."""
    robot = parser.add_argument_group("this project's robot")
    robot.add_argument("--tool", help="tool file, or none (shipped laser head)")
    robot.add_argument("--drives", help="drives file")
    either = parser.add_argument_group("any robot")
    either.add_argument("--fallback", metavar="FILE",
                        help="friction file for omega_d and for what the bags do not tell, or none (shipped for this "
                        "project's robot, none for another)")  # fmt: skip
    either.add_argument("--torque-delay", metavar="S", default=0.0,
                        type=number(f"s, from {-_LONGEST_DELAY:g} to {_LONGEST_DELAY:g}",
                                    lambda value: abs(value) <= _LONGEST_DELAY),
                        help="how much later a recorded torque acted than in the sample period that ends at its stamp, "
                        "s: half a period for torques of the very instant (%(default)g)")  # fmt: skip
    either.add_argument("--record-time", action="store_true",
                        help="take the times at which messages were recorded, not the stamps in "
                        "their headers")  # fmt: skip
    other = parser.add_argument_group(
        "another robot", "n is the number of joints; lists follow --joints. SI units, and gravity along -z of the "
        "URDF's root link."
    )  # fmt: skip
    other.add_argument("--urdf", type=Path, metavar="FILE",
                       help="its URDF with <inertial>, no xacro; turns the options of this group on")  # fmt: skip
    other.add_argument("--topic", help="JointState topic (joint_states)")
    other.add_argument("--joints", nargs="+", metavar="NAME",
                       help="the URDF's joints of interest from base to tip; the others are held at 0 (all movable "
                       "ones)")  # fmt: skip
    other.add_argument("--names", nargs="+", metavar="NAME",
                       help="what the messages call these joints, or their motors with --gear; their order there is "
                       "free, and others may be there, too (as --joints)")  # fmt: skip
    other.add_argument("--gear", nargs="+", type=_NOT_ZERO, metavar="N",
                       help="motor turns per joint turn, negative where they turn against each other; says that "
                       "the messages hold the motors' positions, velocities and efforts (the joints')")  # fmt: skip
    other.add_argument("--coupling", nargs="+", type=_FINITE, metavar="C",
                       help="where motors turn with several joints: turns of each motor per joint turn without the "
                       "gears, row by row, n x n; such a motor has a friction element of its own "
                       "(identity)")  # fmt: skip
    other.add_argument("--torque-constant", nargs="+", type=_NOT_ZERO, metavar="K",
                       help="torque per unit of effort, where effort is a current: Nm/A of the motor with --gear, else "
                       "at the joint (1)")  # fmt: skip
    other.add_argument("--rotor-inertia", nargs="+", metavar="J",
                       type=number("0 or a positive number", lambda value: value >= 0.0),
                       help="of each motor, seen through its gear (times its square), kg m^2 (0)")  # fmt: skip
    other.add_argument("--spring", nargs="+", type=_FINITE, metavar="K",
                       help="gravity-compensation springs, torque -K sin(q) on each joint, Nm (0)")  # fmt: skip


def robot_of(options: argparse.Namespace) -> Robot:
    """Return the robot that the options describe.

    Raises:
        IdentificationError: if they do not fit each other.
        ConfigError: for a file that cannot be used.
    """
    return _own(options) if options.urdf is None else _other(options)


def _own(options: argparse.Namespace) -> Robot:
    for name in ("topic", "joints", "names", "gear", "coupling", "torque_constant", "rotor_inertia", "spring"):
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
    return Robot(arm, setup, None, *_fallback(name, arm), record_time=options.record_time)


def _other(options: argparse.Namespace) -> Robot:
    for name in ("tool", "drives"):
        if getattr(options, name) is not None:
            raise IdentificationError(f"--{name} with --urdf; accepted: for this project's robot alone")
    joints = options.joints
    n = len(RigidArm.from_urdf(options.urdf, joints).names)
    for name, size in (
        ("names", n), ("gear", n), ("torque_constant", n), ("rotor_inertia", n), ("spring", n), ("coupling", n * n),
    ):  # fmt: skip
        values = getattr(options, name)
        if values is not None and len(values) != size:
            raise IdentificationError(
                f"--{name.replace('_', '-')}: {len(values)} values; accepted: {size} for {n} joints"
            )
    coupling = None if options.coupling is None else np.array(options.coupling).reshape(n, n)
    arm = RigidArm.from_urdf(options.urdf, joints, coupling, options.rotor_inertia, options.spring)
    constant = None if options.torque_constant is None else np.array(options.torque_constant)
    messages, topic = tuple(options.names or arm.names), options.topic or "joint_states"
    if options.gear is None:
        layout = BagLayout(topic, messages, arm.names, None, constant)
    else:
        layout = BagLayout.motor_side(topic, messages, arm.names, np.array(options.gear), coupling, constant)
    return Robot(arm, None, layout, *_fallback(options.fallback or "none", arm), record_time=options.record_time)


def _fallback(name: str, arm: RigidArm) -> tuple[tuple[LuGreElement, ...] | None, str | None]:
    if name == "none":
        return None, None
    section = load_yaml(resolve_config(name)).section("elements")
    return tuple(load_element(section.section(element)) for element in arm.element_names), name
