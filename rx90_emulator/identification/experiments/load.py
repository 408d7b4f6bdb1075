"""The shares of the arm's limits that a planned motion uses; a motion beyond them is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_common.base.rates import Rates
from rx90_common.description.drives import DriveParameters
from rx90_common.description.rigid_torque import rigid_torque
from rx90_common.description.robot import RobotModel
from rx90_common.description.wrist import coupling_matrix
from rx90_controller.law.parameters import CS7BParameters
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.identification.experiments.plan import Experiment

_PERIOD = Rates().position_period
_TORQUE_STRIDE = 10


@dataclass(frozen=True)
class Load:
    """Shares of the limits that an experiment uses, each of shape (6,).

    Attributes:
        speed: of the speed limits.
        torque: of the torque that the URDF allows: rigid body, rotors, spring and the friction that the controller
            compensates.
    """

    speed: Array
    torque: Array


def check_load(experiment: Experiment, robot: RobotModel, drives: DriveParameters, controller: CS7BParameters) -> Load:
    """Return the shares of the limits that an experiment uses.

    Raises:
        IdentificationError: if it leaves a joint's limits, of torque too, naming joint, amount and limit.
    """
    setpoints = planned_setpoints(experiment, controller.limits(robot))
    speed = np.abs(setpoints[:, 1]).max(axis=0) / robot.max_velocity
    torque = _expected_torque(setpoints[::_TORQUE_STRIDE], robot, drives, controller)
    share = np.abs(torque).max(axis=0) / robot.max_effort
    joint = int(np.argmax(share))
    if share[joint] > 1.0:
        raise IdentificationError(
            f"{experiment.name}: {robot.joint_names[joint]} would need "
            f"{share[joint] * robot.max_effort[joint]:.3g} Nm; accepted: up to {robot.max_effort[joint]:.3g} Nm; "
            "choose other poses or less speed or acceleration"
        )
    return Load(speed, share)


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
