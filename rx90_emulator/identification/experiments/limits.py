"""What joints and motors of an arm may do: the shares of it that a motion uses; a plan beyond them is refused."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_common.base.rates import Rates
from rx90_controller.trajectory import TrajectoryGenerator
from rx90_emulator.identification.experiments.arms import PlannedArm
from rx90_emulator.identification.experiments.plan import Experiment

_PERIOD = Rates().position_period
_TORQUE_STRIDE = 10


def whose(arm: PlannedArm, limit: str) -> tuple[str, ...]:
    """Return the names of the joints or the motors that a limit of `limit_shares` is of."""
    return arm.motors if limit.startswith("motor_") else arm.robot.joint_names


def limit_shares(
    arm: PlannedArm, motion: Array, torque: Array, share: float = 1.0, speed: float = 1.0, margin: float = 0.0
) -> dict[str, Array]:
    """Return signed shares of what is allowed, by name, each of the shape of what it is a share of.

    No file says how fast a motor may turn: it is taken to be as fast as its joint alone may be.

    Args:
        arm: of n joints.
        motion: position rad, velocity rad/s and acceleration rad/s² of the joints, shape (3, m, n).
        torque: with friction, Nm, shape (k, n).
        share: of accelerations and torques that counts as all of them.
        speed: the same of the speeds.
        margin: that the joints' ranges are narrower by at either end, rad.
    """
    position, velocity, acceleration = motion
    robot = arm.robot
    middle, reach = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower) - margin
    return {
        "position": (position - middle) / reach,
        "speed": velocity / (speed * robot.max_velocity),
        "motor_speed": velocity @ arm.turns.T / (speed * robot.max_velocity),
        "acceleration": acceleration / (share * arm.limits.acceleration),
        "torque": torque / (share * robot.max_effort),
        "motor_torque": torque @ arm.carries.T / (share * arm.motor_torque),
    }


def friction_torque(arm: PlannedArm, velocity: Array, smooth: float = 0.0) -> tuple[Array, Array]:
    """Return the friction that is counted with an arm: of one of this project's what the controller compensates.

    Args:
        arm: with Coulomb and viscous friction of each motor, seen through its gear.
        velocity: of the joints, rad/s, shape (m, n).
        smooth: speed over which Coulomb friction changes its sign, rad/s.

    Returns:
        Joint torques, Nm, shape (m, n), and the derivative of each motor's friction by its speed, shape (m, n), which
        is without Coulomb friction where its sign jumps.
    """
    motors = velocity @ arm.turns.T
    speed, exponent = np.abs(motors), arm.exponent
    sign = np.tanh(motors / smooth) if smooth else np.sign(motors)
    slope = arm.viscous * exponent * np.maximum(speed, 1e-6) ** (exponent - 1.0)
    if smooth:
        slope = slope + arm.coulomb * (1.0 - sign**2) / smooth
    torque = sign * arm.coulomb + np.sign(motors) * arm.viscous * speed**exponent
    return np.asarray(torque @ arm.turns), np.asarray(slope)


def check_experiment(experiment: Experiment, arm: PlannedArm) -> tuple[dict[str, Array], Array]:
    """Return the largest shares of the limits that an experiment uses, and its set-points.

    Torques are those of the rigid body, rotors, spring and the friction that is counted with the arm.

    Args:
        experiment: whose trajectory the controller's own generator accepts.
        arm: of n joints.

    Returns:
        Shares by the names of `limit_shares`, each of shape (n,), and set-points, shape (m, 3, n).

    Raises:
        IdentificationError: if it leaves a joint's or a motor's limits, of torque too, naming which, amount and limit.
    """
    robot, points = arm.robot, experiment.points
    generator = TrajectoryGenerator(arm.limits, _PERIOD, points.position[0])
    try:
        generator.accept(points, 0, 0)
    except TrajectoryError as error:
        raise IdentificationError(f"{experiment.name}: {error}") from error
    setpoints = generator.setpoints(0, round(experiment.duration / _PERIOD) + 1)
    motion = setpoints.transpose(1, 0, 2)
    some = motion[:, ::_TORQUE_STRIDE]
    signed = limit_shares(arm, motion, arm.rigid.torque(*some) + friction_torque(arm, some[1])[0])
    shares = {name: np.abs(share).max(axis=0) for name, share in signed.items()}
    for name, most, unit in (
        ("motor_speed", robot.max_velocity, "rad/s, through its gear"),
        ("torque", robot.max_effort, "Nm"),
        ("motor_torque", arm.motor_torque, "Nm, through its gear"),
    ):
        share, k = shares[name], int(np.argmax(shares[name]))
        if share[k] > 1.0:
            raise IdentificationError(
                f"{experiment.name}: {whose(arm, name)[k]} would need {share[k] * most[k]:.3g} {unit}; accepted: up "
                f"to {most[k]:.3g}; choose other poses or less speed or acceleration"
            )
    return shares, setpoints
