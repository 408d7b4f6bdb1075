"""An arm as plans of motions see it: one of this project from its files, any other one from its URDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_common.base.quoting import listed
from rx90_common.base.rates import Rates
from rx90_common.description.assumed_files import FULL_SPEED_TIME
from rx90_common.description.joint_model import robot_of_urdf
from rx90_common.description.robot import RobotModel
from rx90_common.exchange.topics import motor_names
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.experiments.plan import Experiment, poses_of
from rx90_emulator.loop.setup import Setup

_START_TOLERANCE = 1e-3  # rad
_PERIOD = Rates().position_period
_TORQUE_STRIDE = 10  # set-points from one computed torque to the next


@dataclass(frozen=True, eq=False)
class PlannedArm:
    """An arm of n joints with as many motors.

    Attributes:
        robot: names, ranges, speeds, efforts, kinematics and shapes, tool included.
        rigid: its torques without friction, and its friction elements.
        home: where every run begins and ends, rad, shape (n,).
        limits: of the set-points.
        motor_torque: largest torque of each motor, seen through its gear, Nm, shape (n,); inf if unknown.
        coulomb: assumed friction of each motor, seen through its gear, Nm, shape (n,); 0 if unknown.
        viscous: likewise, times the speed to the power of `exponent`, shape (n,).
        exponent: shape (n,).
        remarks: what is assumed, in words.
    """

    robot: RobotModel
    rigid: RigidArm
    home: Array
    limits: JointLimits
    motor_torque: Array
    coulomb: Array
    viscous: Array
    exponent: Array
    remarks: tuple[str, ...]

    @classmethod
    def from_setup(cls, setup: Setup, home: Sequence[float] | None = None) -> PlannedArm:
        """Return the arm of a setup; home is the given one, else that of the robot's poses, else mid-range."""
        if home is None and setup.files.poses is not None:
            home = poses_of(setup).home.position
        pose, remarks = _home(setup.robot, home)
        controller = setup.controller
        return cls(
            robot=setup.robot,
            rigid=RigidArm.from_setup(setup),
            home=pose,
            limits=controller.limits(setup.robot),
            motor_torque=np.abs(setup.drives.gear) * setup.drives.peak_torque,
            coulomb=np.array(controller.feed_forward.coulomb_torque),
            viscous=np.array(controller.feed_forward.viscous_friction),
            exponent=controller.viscous_exponent,
            remarks=remarks,
        )

    @classmethod
    def from_urdf(
        cls,
        urdf: Path,
        joints: Sequence[str] | None = None,
        tool: Path | None = None,
        home: Sequence[float] | None = None,
        acceleration: float | None = None,
    ) -> PlannedArm:
        """Return an arm that only its URDF describes: no friction, no rotors, each motor on its joint.

        Args:
            urdf: as in `robot_of_urdf`; joints and tool likewise.
            joints: of interest, from base to tip.
            tool: a tool file.
            home: rad, shape (n,); by default mid-range.
            acceleration: limit of all joints, rad/s²; by default each joint's speed limit in 0.5 s.
        """
        robot = robot_of_urdf(urdf, joints, tool)
        names = robot.joint_names
        n = len(names)
        pose, remarks = _home(robot, home)
        fastest = robot.max_velocity / FULL_SPEED_TIME
        if acceleration is not None:
            fastest = np.full(n, acceleration)
        assumed = f"accelerations up to {listed(f'{value:.3g}' for value in fastest)} rad/s^2, no friction, no rotors"
        zero = np.zeros(n)
        return cls(
            robot=robot,
            rigid=RigidArm(names, names, np.eye(n), robot.model, np.zeros((n, n)), zero, np.eye(n)),
            home=pose,
            limits=JointLimits(
                names, robot.lower, robot.upper, robot.max_velocity, fastest, _START_TOLERANCE
            ),
            motor_torque=np.full(n, np.inf),
            coulomb=zero,
            viscous=zero,
            exponent=np.ones(n),
            remarks=(*remarks, assumed),
        )

    def shares(self, motion: Array, rigid_torque: Array) -> dict[str, Array]:
        """Return the used shares of the limits of joints and motors by name, shape (m, n) each.

        Torques are those of the rigid body, rotors, spring and the arm's assumed friction. No file limits the speed of
        a motor: its limit is assumed to be that of its joint alone.

        Args:
            motion: position rad, velocity rad/s and acceleration rad/s² of the joints, shape (3, m, n).
            rigid_torque: torque without friction, Nm, shape (m, n).
        """
        robot = self.robot
        turns = self.rigid.coupling
        position, velocity, acceleration = motion
        motors = velocity @ turns.T
        friction = np.sign(motors) * (self.coulomb + self.viscous * np.abs(motors) ** self.exponent)
        torque = rigid_torque + friction @ turns
        motor_torque = torque @ np.linalg.inv(turns)
        middle = 0.5 * (robot.lower + robot.upper)
        used = {
            "position": (position - middle) / (robot.upper - middle),
            "speed": velocity / robot.max_velocity,
            "motor speed": motors / robot.max_velocity,
            "acceleration": acceleration / self.limits.acceleration,
            "torque": torque / robot.max_effort,
            "motor torque": motor_torque / self.motor_torque,
        }
        return {name: np.abs(share) for name, share in used.items()}

    def names_of(self, limit: str) -> tuple[str, ...]:
        """Return the names of the joints or motors that a limit of `shares` applies to."""
        names = self.robot.joint_names
        return motor_names(len(names)) if limit.startswith("motor") else names

    def check(self, experiment: Experiment) -> dict[str, tuple[float, str]]:
        """Return the largest share of each limit that an experiment uses, and the joint or motor that uses it."""
        points = experiment.points
        generator = TrajectoryGenerator(self.limits, _PERIOD, points.position[0])
        try:
            generator.accept(points, 0, 0)
        except TrajectoryError as error:
            raise IdentificationError(f"{experiment.name}: {error}") from error
        setpoints = generator.setpoints(0, round(experiment.duration / _PERIOD) + 1)
        motion = setpoints.transpose(1, 0, 2)[:, ::_TORQUE_STRIDE]
        largest = {}
        for name, share in self.shares(motion, self.rigid.torque(*motion)).items():
            most = share.max(axis=0)
            number = int(np.argmax(most))
            whose = self.names_of(name)[number]
            largest[name] = (float(most[number]), whose)
            if most[number] > 1.0:
                raise IdentificationError(
                    f"{experiment.name}: {whose} would need {most[number]:.0%} of its {name}; accepted: up to "
                    "100 %; choose other poses or less speed or acceleration"
                )
        return largest


def _home(robot: RobotModel, given: Sequence[float] | None) -> tuple[Array, tuple[str, ...]]:
    if given is None:
        middle = 0.5 * (robot.lower + robot.upper)
        return middle, (
            f"home is the middle of the joints' ranges, {listed(f'{angle:.4g}' for angle in middle)} rad",
        )
    robot.check_position("home", given, IdentificationError)
    return np.array(given, dtype=np.float64), ()
