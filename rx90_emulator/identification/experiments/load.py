"""The shares of the limits of joints and motors that a planned motion uses; a motion beyond them is refused."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters
from rx90_common.description.rigid_torque import rigid_torque
from rx90_common.description.robot import RobotModel
from rx90_common.description.wrist import coupling_matrix
from rx90_common.exchange.topics import MOTOR_NAMES
from rx90_controller.law.parameters import CS7BParameters
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.identification.experiments.plan import Experiment

_PERIOD = Rates().position_period
_TORQUE_STRIDE = 10


@dataclass(frozen=True)
class Load:
    """Shares of the limits that an experiment uses, each of shape (6,).

    Attributes:
        speed: of the joints' speed limits.
        torque: of the torque that the URDF allows: rigid body, rotors, spring and the friction that the controller
            compensates.
        motor_speed: of the speed at which a motor turns when its joint alone moves at its limit.
        motor_torque: of the drives' peak torques.
    """

    speed: Array
    torque: Array
    motor_speed: Array
    motor_torque: Array


@dataclass(frozen=True, eq=False)
class Motors:
    """What motors turn and carry, seen through their gears: with a coupled wrist not what their joints do.

    Attributes:
        turns: speeds of motors per speeds of joints, shape (6, 6).
        speed: at which each turns at most, rad/s, shape (6,). No file has it: a motor is taken to be as fast as its
            joint alone may be.
        torque: that each gives at most, Nm, shape (6,).
    """

    turns: Array
    speed: Array
    torque: Array

    @classmethod
    def of(cls, robot: RobotModel, drives: DriveParameters) -> Motors:
        """Return the motors of an arm."""
        return cls(coupling_matrix(), robot.max_velocity, np.abs(drives.gear) * drives.peak_torque)

    @cached_property
    def carries(self) -> Array:
        """Return torques of motors per torques of joints, shape (6, 6)."""
        return np.asarray(np.linalg.inv(self.turns).T)

    @property
    def shared(self) -> tuple[int, ...]:
        """Return the numbers of the motors that turn with, or carry, more than their joint."""
        return tuple(np.flatnonzero((self.turns != np.eye(6)).any(axis=1) | (self.carries != np.eye(6)).any(axis=1)))


def check_load(experiment: Experiment, robot: RobotModel, drives: DriveParameters, controller: CS7BParameters) -> Load:
    """Return the shares of the limits that an experiment uses.

    Raises:
        IdentificationError: if it leaves a joint's or a motor's limits, of torque too, naming which, amount and limit.
    """
    setpoints = planned_setpoints(experiment, controller.limits(robot))
    torque = _expected_torque(setpoints[::_TORQUE_STRIDE], robot, drives, controller)
    velocity, motors = setpoints[:, 1], Motors.of(robot, drives)
    load = Load(
        _most(velocity, robot.max_velocity),
        _most(torque, robot.max_effort),
        _most(velocity @ motors.turns.T, motors.speed),
        _most(torque @ motors.carries.T, motors.torque),
    )
    for share, names, most, unit in (
        (load.motor_speed, MOTOR_NAMES, motors.speed, "rad/s, through its gear"),
        (load.torque, robot.joint_names, robot.max_effort, "Nm"),
        (load.motor_torque, MOTOR_NAMES, motors.torque, "Nm, through its gear"),
    ):
        k = int(np.argmax(share))
        if share[k] > 1.0:
            raise IdentificationError(
                f"{experiment.name}: {names[k]} would need {share[k] * most[k]:.3g} {unit}; accepted: up to "
                f"{most[k]:.3g}; choose other poses or less speed or acceleration"
            )
    return load


def _most(values: Array, limit: Array) -> Array:
    return np.asarray(np.abs(values).max(axis=0) / limit)


def planned_setpoints(experiment: Experiment, limits: JointLimits) -> Array:
    """Return what the controller's own generator makes of the trajectory, shape (m, 3, 6).

    Raises:
        IdentificationError: if it refuses the trajectory.
    """
    points: TrajectoryPoints = experiment.points
    generator = TrajectoryGenerator(limits, _PERIOD, points.position[0])
    try:
        generator.accept(points, 0, 0)
    except TrajectoryError as error:
        raise IdentificationError(f"{experiment.name}: {error}") from error
    return generator.setpoints(0, round(experiment.duration / _PERIOD) + 1)


def friction_torque(velocity: Array, controller: CS7BParameters, smooth: float = 0.0) -> tuple[Array, Array]:
    """Return the friction that the controller compensates.

    Args:
        velocity: of the joints, rad/s, shape (m, 6).
        controller: Coulomb and viscous friction of each motor, seen through its gear.
        smooth: speed over which Coulomb friction changes its sign, rad/s.

    Returns:
        Joint torques, Nm, shape (m, 6), and the derivative of each motor's friction by its speed, shape (m, 6), which
        is without Coulomb friction where its sign jumps.
    """
    motors = velocity @ coupling_matrix().T
    speed, exponent = np.abs(motors), controller.viscous_exponent
    sign = np.tanh(motors / smooth) if smooth else np.sign(motors)
    slope = controller.viscous * exponent * np.maximum(speed, 1e-6) ** (exponent - 1.0)
    if smooth:
        slope = slope + controller.coulomb * (1.0 - sign**2) / smooth
    torque = sign * controller.coulomb + np.sign(motors) * controller.viscous * speed**exponent
    return np.asarray(torque @ coupling_matrix()), np.asarray(slope)


def _expected_torque(setpoints: Array, robot: RobotModel, drives: DriveParameters, controller: CS7BParameters) -> Array:
    rigid = rigid_torque(robot.model, drives.rotor_matrix, drives.spring_torque, *setpoints.transpose(1, 0, 2))
    return np.asarray(rigid + friction_torque(setpoints[:, 1], controller)[0])
