"""An arm as plans of motions see it: one of this project from its files, any other one from its URDF.

A motion may use a share of the limits of joints and motors; a plan beyond them is refused.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_common.base.quoting import counted, listed, plain, quoted
from rx90_common.base.rates import Rates
from rx90_common.description.chain import RigidChain
from rx90_common.description.robot import MOUNT_LINK, TCP_LINK, RobotModel, attach, joint_of, load_tool
from rx90_common.exchange.topics import motor_names
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator
from rx90_emulator.identification.arm import RigidArm, joint_model, movable_joints
from rx90_emulator.identification.experiments.plan import Experiment, Poses, check_pose
from rx90_emulator.identification.output.assumed_files import FULL_SPEED_TIME
from rx90_emulator.loop.setup import Setup

_START_TOLERANCE = 1e-3  # rad
_PERIOD = Rates().position_period
_TORQUE_STRIDE = 10  # set-points from one computed torque to the next
_TURN = math.pi  # rad, the range of a continuous joint without limits, either way


@dataclass(frozen=True, eq=False)
class PlannedArm:
    """An arm of n joints with as many motors.

    Attributes:
        robot: names, ranges, speeds, efforts, kinematics and shapes, tool included.
        rigid: its torques without friction, and its friction elements.
        home: where every run begins and ends, rad, shape (n,).
        chosen_home: how it was chosen, in words.
        limits: of the set-points.
        motors: their names.
        turns: speeds of motors, seen through their gears, per speeds of joints, shape (n, n).
        motor_torque: largest torque of each motor, seen through its gear, Nm, shape (n,); inf if unknown.
        coulomb: assumed friction of each motor, seen through its gear, Nm, shape (n,); 0 if unknown.
        viscous: likewise, times the speed to the power of `exponent`, shape (n,).
        exponent: shape (n,).
        friction: expected Coulomb and viscous values of the elements, Nm and Nms/rad, shape (n_el,) each; 0 if unknown.
        remarks: further notes for the user, in words.
    """

    robot: RobotModel
    rigid: RigidArm
    home: Array
    chosen_home: str
    limits: JointLimits
    motors: tuple[str, ...]
    turns: Array
    motor_torque: Array
    coulomb: Array
    viscous: Array
    exponent: Array
    friction: tuple[Array, Array]
    remarks: tuple[str, ...] = ()

    @classmethod
    def from_setup(cls, setup: Setup, home: Sequence[float] | None = None) -> PlannedArm:
        """Return the arm of a setup; home is the given one, else that of the robot's poses, else `middle_of_ranges`."""
        controller = setup.controller
        elements = setup.friction.elements
        robot = setup.robot
        poses = None if home is not None or setup.files is None or setup.files.poses is None else Poses.of(setup)
        coulomb = np.array([0.5 * (one.tau_c.positive + one.tau_c.negative) for one in elements])
        return cls(
            robot,
            RigidArm.from_setup(setup),
            *_home(robot, home if poses is None else poses.home.position, "the robot's poses" if poses else "as given"),
            controller.limits(robot),
            motor_names(len(robot.joint_names)),
            setup.drives.turning.turns,
            np.abs(setup.drives.gear) * setup.drives.peak_torque,
            controller.coulomb,
            controller.viscous,
            controller.viscous_exponent,
            (coulomb, np.array([one.c2 for one in elements])),
        )

    @classmethod
    def from_urdf(
        cls,
        urdf: Path,
        joints: Sequence[str] | None = None,
        tool: Path | None = None,
        home: Sequence[float] | None = None,
        acceleration: Sequence[float] | None = None,
    ) -> PlannedArm:
        """Return an arm that only its URDF describes: no friction, no rotors, each motor on its joint.

        Args:
            urdf: as in `robot_of_urdf`; joints and tool likewise.
            joints: of interest, from base to tip.
            tool: a tool file.
            home: rad, shape (n,); by default `middle_of_ranges`.
            acceleration: limits, rad/s², one for all joints or one each; by default the joint's speed limit in 0.5 s.
        """
        robot = robot_of_urdf(urdf, joints, tool)
        names = robot.joint_names
        n = len(robot.joint_names)
        most = robot.max_velocity / FULL_SPEED_TIME
        if acceleration is not None:
            if len(acceleration) not in (1, n):
                raise IdentificationError(f"--acceleration: {counted(len(acceleration), 'value')}; accepted: 1, or {n}")
            most = np.broadcast_to(np.array(acceleration, dtype=np.float64), (n,)).copy()
        limits = JointLimits(names, robot.lower, robot.upper, robot.max_velocity, most, _START_TOLERANCE)
        one = np.eye(n)
        zero = np.zeros(n)
        rigid = RigidArm(names, names, one, robot.model, np.zeros((n, n)), zero, one)
        remarks = [
            f"accelerations up to {', '.join(f'{value:.3g}' for value in most)} rad/s^2; torques are those of the "
            "URDF's bodies alone, without friction"
        ]
        if held := [name for name in movable_joints(urdf) if name not in names]:
            remarks.append(f"held at 0: {listed(held)}")
        return cls(
            robot, rigid, *_home(robot, home, "as given"), limits, names, one, np.full(n, np.inf), zero, zero,
            np.ones(n), (zero, zero), tuple(remarks),
        )  # fmt: skip

    @property
    def carries(self) -> Array:
        """Return torques of motors, seen through their gears, per torques of joints, shape (n, n)."""
        return np.asarray(np.linalg.inv(self.turns).T)

    def limit_shares(
        self, motion: Array, torque: Array, share: float = 1.0, speed: float = 1.0, margin: float = 0.0
    ) -> dict[str, Array]:
        """Return signed shares of the limits by name, each with the shape of the limited quantity.

        No file limits the speed of a motor: its limit is assumed to be that of its joint alone.

        Args:
            motion: position rad, velocity rad/s and acceleration rad/s² of the joints, shape (3, m, n).
            torque: with friction, Nm, shape (k, n).
            share: factor on the limits of accelerations and torques.
            speed: factor on the limits of speeds.
            margin: distance from the ends of the joints' ranges, rad.
        """
        position, velocity, acceleration = motion
        robot = self.robot
        middle = 0.5 * (robot.lower + robot.upper)
        reach = 0.5 * (robot.upper - robot.lower) - margin
        return {
            "position": (position - middle) / reach,
            "speed": velocity / (speed * robot.max_velocity),
            "motor_speed": velocity @ self.turns.T / (speed * robot.max_velocity),
            "acceleration": acceleration / (share * self.limits.acceleration),
            "torque": torque / (share * robot.max_effort),
            "motor_torque": torque @ self.carries.T / (share * self.motor_torque),
        }

    def whose(self, limit: str) -> tuple[str, ...]:
        """Return the names of the joints or motors that a limit of `limit_shares` applies to."""
        return self.motors if limit.startswith("motor_") else self.robot.joint_names

    def friction_torque(self, velocity: Array, smooth: float = 0.0) -> tuple[Array, Array]:
        """Return the assumed friction; for an arm of this project that which the controller compensates.

        Args:
            velocity: of the joints, rad/s, shape (m, n).
            smooth: speed over which Coulomb friction changes its sign, rad/s.

        Returns:
            Joint torques, Nm, shape (m, n), and the derivative of each motor's friction by its speed, shape (m, n),
            without Coulomb friction, whose sign jumps.
        """
        motors = velocity @ self.turns.T
        speed = np.abs(motors)
        exponent = self.exponent
        sign = np.tanh(motors / smooth) if smooth else np.sign(motors)
        slope = self.viscous * exponent * np.maximum(speed, 1e-6) ** (exponent - 1.0)
        if smooth:
            slope = slope + self.coulomb * (1.0 - sign**2) / smooth
        torque = sign * self.coulomb + np.sign(motors) * self.viscous * speed**exponent
        return np.asarray(torque @ self.turns), np.asarray(slope)

    def check(self, experiment: Experiment) -> tuple[dict[str, Array], Array]:
        """Return the largest shares of the limits that an experiment uses, and its set-points.

        Torques are those of the rigid body, rotors, spring and the arm's assumed friction.

        Args:
            experiment: whose trajectory the controller's own generator accepts.

        Returns:
            Shares by the names of `limit_shares`, each of shape (n,), and set-points, shape (m, 3, n).
        """
        points = experiment.points
        generator = TrajectoryGenerator(self.limits, _PERIOD, points.position[0])
        try:
            generator.accept(points, 0, 0)
        except TrajectoryError as error:
            raise IdentificationError(f"{experiment.name}: {error}") from error
        setpoints = generator.setpoints(0, round(experiment.duration / _PERIOD) + 1)
        motion = setpoints.transpose(1, 0, 2)
        some = motion[:, ::_TORQUE_STRIDE]
        signed = self.limit_shares(motion, self.rigid.torque(*some) + self.friction_torque(some[1])[0])
        shares = {name: np.abs(share).max(axis=0) for name, share in signed.items()}
        for name, most, unit in (
            ("motor_speed", self.robot.max_velocity, "rad/s, through its gear"),
            ("torque", self.robot.max_effort, "Nm"),
            ("motor_torque", self.motor_torque, "Nm, through its gear"),
        ):
            share = shares[name]
            k = int(np.argmax(shares[name]))
            if share[k] > 1.0:
                raise IdentificationError(
                    f"{experiment.name}: {self.whose(name)[k]} would need {share[k] * most[k]:.3g} {unit}; accepted: "
                    f"up to {most[k]:.3g}; choose other poses or less speed or acceleration"
                )
        return shares, setpoints

    @property
    def coupled(self) -> tuple[int, ...]:
        """Return the numbers of the motors that turn with, or carry, more than their joint."""
        one = np.eye(len(self.turns))
        return tuple(np.flatnonzero(((self.turns != one) | (self.carries != one)).any(axis=1)).tolist())


def middle_of_ranges(robot: RobotModel) -> Array:
    """Return the middle of each joint's range, rad, shape (n,): the home of an arm without a given one."""
    return np.asarray(0.5 * (robot.lower + robot.upper))


def _home(robot: RobotModel, given: Sequence[float] | None, whose: str) -> tuple[Array, str]:
    """Return home, checked, and how it was chosen."""
    if given is None:
        return middle_of_ranges(robot), "the middle of the joints' ranges, assumed"
    if len(given) != len(robot.joint_names):
        raise IdentificationError(
            f"--home: {counted(len(given), 'value')}; accepted: {len(robot.joint_names)}, one per joint"
        )
    check_pose("home", given, robot)
    return np.array(given, dtype=np.float64), whose


def robot_of_urdf(urdf: Path, joints: Sequence[str] | None = None, tool: Path | None = None) -> RobotModel:
    """Read a serial arm from the URDF of any robot.

    Joints that are not of interest are fixed at 0, by default those that are not revolute or mimic another one. A
    continuous joint without a range may turn by half a turn either way. The tool is fixed to the link `tool0`, or to
    the last link if there is none. Without a tool the tool centre point is that link's frame.

    Args:
        urdf: the robot's description.
        joints: of interest, from base to tip; by default all revolute ones with a drive of their own.
        tool: a tool file.
    """
    there = movable_joints(urdf)  # refuses a file that is no URDF
    root = ET.fromstring(urdf.read_text(encoding="utf-8"))
    sliding = {joint.get("name") for joint in root.findall("joint") if joint.get("type") == "prismatic"}
    names = [str(name) for name in joint_model(urdf, joints or [one for one in there if one not in sliding]).names][1:]
    for joint in root.findall("joint"):
        name = str(joint.get("name"))
        kind = joint.get("type")
        if name not in names:
            joint.set("type", "fixed")
        elif kind == "continuous":
            limit = joint.find("limit")
            if limit is None:
                raise IdentificationError(f"{plain(urdf)}: joint {quoted(name)} limit is missing; accepted: velocity "
                                          "and effort")  # fmt: skip
            joint.set("type", "revolute")
            if not float(limit.get("lower", 0.0)) < float(limit.get("upper", 0.0)):
                limit.set("lower", str(-_TURN))
                limit.set("upper", str(_TURN))
    model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    for number, name in enumerate(names, 1):
        if model.parents[number] != number - 1:
            raise IdentificationError(f"{plain(urdf)}: joint {quoted(name)} is not moved by the joint before it; "
                                      "accepted: --joints of one arm, from base to tip")  # fmt: skip
    links = [frame.name for frame in model.frames if frame.type == pin.BODY and joint_of(frame) == len(names)]
    tip = MOUNT_LINK if MOUNT_LINK in links else links[-1]
    if tool is not None:
        if tip != MOUNT_LINK:
            ET.SubElement(root, "link", name=MOUNT_LINK)
            mount = ET.SubElement(root, "joint", name=f"{MOUNT_LINK}_fixed", type="fixed")
            ET.SubElement(mount, "parent", link=tip)
            ET.SubElement(mount, "child", link=MOUNT_LINK)
        attach(root, load_tool(tool), urdf)
        tip = TCP_LINK
    text = ET.tostring(root, encoding="unicode")
    model = pin.buildModelFromXML(text)
    _check_bodies(model, urdf)
    values = model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit, model.effortLimit
    lower, upper, velocity, effort = (np.array(each, dtype=np.float64) for each in values)
    for name, low, high, fastest, most in zip(names, lower, upper, velocity, effort, strict=True):
        if not (low < high and fastest > 0.0 and most > 0.0):
            raise IdentificationError(
                f"{plain(urdf)}: joint {quoted(name)} limit has lower {low:g}, upper {high:g}, velocity {fastest:g}, "
                f"effort {most:g}; accepted: lower < upper, velocity and effort > 0"
            )
    return RobotModel(tuple(names), text, model, lower, upper, velocity, effort, _chain(model, tip), tip, ())


def _check_bodies(model: Any, urdf: Path) -> None:
    """Refuse negative masses and moments of inertia; other robots' files are not checked for consistent ones."""
    for name, body in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        least = float(np.linalg.eigvalsh(body.inertia)[0])
        if body.mass < 0.0 or least < -1e-9:  # rounding
            raise IdentificationError(
                f"{plain(urdf)}: what joint {quoted(str(name))} moves has {body.mass:g} kg and a principal moment of "
                f"inertia of {least:g} kg m^2; accepted: none below 0"
            )


def _chain(model: Any, tip: str) -> RigidChain:
    """Return the kinematics of Pinocchio's model, without its bodies."""
    data = model.createData()
    n = model.nv
    pin.computeJointJacobians(model, data, np.zeros(n))
    pin.updateFramePlacements(model, data)
    position = np.array([data.oMi[k].translation for k in range(1, n + 1)])
    last = data.oMf[model.getFrameId(tip)]
    axis = np.reshape(data.J, (6, n))[3:].T.copy()  # which for one joint has one dimension
    nothing = np.zeros(n)
    return RigidChain(
        np.diff(position, axis=0, prepend=np.zeros((1, 3))), axis / np.linalg.norm(axis, axis=1, keepdims=True),
        nothing, np.zeros((n, 3)), np.zeros((n, 6)), model.gravity.linear.copy(),
        last.translation - position[-1], np.ascontiguousarray(last.rotation),
    )  # fmt: skip
