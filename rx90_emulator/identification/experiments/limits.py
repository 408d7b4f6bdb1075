"""What joints and motors of an arm may do: the shares of it that a motion uses; a plan beyond them is refused."""

from __future__ import annotations

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError, TrajectoryError
from rx90_common.base.rates import Rates
from rx90_common.description.coupling import Coupling
from rx90_common.description.rigid_torque import rigid_torque
from rx90_common.exchange.topics import motor_names
from rx90_controller.trajectory import TrajectoryGenerator
from rx90_emulator.identification.experiments.plan import Experiment
from rx90_emulator.loop.setup import Setup

_PERIOD = Rates().position_period
_TORQUE_STRIDE = 10


def coupled_motors(turning: Coupling) -> tuple[int, ...]:
    """Return the numbers of the motors that turn with, or carry, more than their joint."""
    one = np.eye(len(turning.turns))
    return tuple(np.flatnonzero(((turning.turns != one) | (one != turning.joint_turns.T)).any(axis=1)).tolist())


def motor_torque_limit(setup: Setup) -> Array:
    """Return the torque that each motor gives at most, seen through its gear, Nm, shape (n,)."""
    return np.asarray(np.abs(setup.drives.gear) * setup.drives.peak_torque)


def whose(setup: Setup, limit: str) -> tuple[str, ...]:
    """Return the names of the joints or the motors that a limit of `limit_shares` is of."""
    joints = setup.robot.joint_names
    return motor_names(len(joints)) if limit.startswith("motor_") else joints


def limit_shares(
    setup: Setup, motion: Array, torque: Array, share: float = 1.0, speed: float = 1.0, margin: float = 0.0
) -> dict[str, Array]:
    """Return signed shares of what is allowed, by name, each of the shape of what it is a share of.

    No file says how fast a motor may turn: it is taken to be as fast as its joint alone may be.

    Args:
        setup: ranges, speeds, efforts of the joints, accelerations of the controller, peak torques of the drives.
        motion: position rad, velocity rad/s and acceleration rad/s² of the joints, shape (3, m, n).
        torque: with friction, Nm, shape (k, n).
        share: of accelerations and torques that counts as all of them.
        speed: the same of the speeds.
        margin: that the joints' ranges are narrower by at either end, rad.
    """
    position, velocity, acceleration = motion
    robot, turning = setup.robot, setup.drives.turning
    middle, reach = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower) - margin
    return {
        "position": (position - middle) / reach,
        "speed": velocity / (speed * robot.max_velocity),
        "motor_speed": velocity @ turning.turns.T / (speed * robot.max_velocity),
        "acceleration": acceleration / (share * setup.controller.max_acceleration),
        "torque": torque / (share * robot.max_effort),
        "motor_torque": torque @ turning.joint_turns / (share * motor_torque_limit(setup)),
    }


def friction_torque(setup: Setup, velocity: Array, smooth: float = 0.0) -> tuple[Array, Array]:
    """Return the friction that the controller compensates.

    Args:
        setup: with Coulomb and viscous friction of each motor, seen through its gear, in the controller.
        velocity: of the joints, rad/s, shape (m, n).
        smooth: speed over which Coulomb friction changes its sign, rad/s.

    Returns:
        Joint torques, Nm, shape (m, n), and the derivative of each motor's friction by its speed, shape (m, n), which
        is without Coulomb friction where its sign jumps.
    """
    turns, controller = setup.drives.turning.turns, setup.controller
    motors = velocity @ turns.T
    speed, exponent = np.abs(motors), controller.viscous_exponent
    sign = np.tanh(motors / smooth) if smooth else np.sign(motors)
    slope = controller.viscous * exponent * np.maximum(speed, 1e-6) ** (exponent - 1.0)
    if smooth:
        slope = slope + controller.coulomb * (1.0 - sign**2) / smooth
    torque = sign * controller.coulomb + np.sign(motors) * controller.viscous * speed**exponent
    return np.asarray(torque @ turns), np.asarray(slope)


def check_experiment(experiment: Experiment, setup: Setup) -> tuple[dict[str, Array], Array]:
    """Return the largest shares of the limits that an experiment uses, and its set-points.

    Torques are those of the rigid body, rotors, spring and the friction that the controller compensates.

    Args:
        experiment: whose trajectory the controller's own generator accepts.
        setup: robot, drives and controller.

    Returns:
        Shares by the names of `limit_shares`, each of shape (n,), and set-points, shape (m, 3, n).

    Raises:
        IdentificationError: if it leaves a joint's or a motor's limits, of torque too, naming which, amount and limit.
    """
    robot, points = setup.robot, experiment.points
    generator = TrajectoryGenerator(setup.controller.limits(robot), _PERIOD, points.position[0])
    try:
        generator.accept(points, 0, 0)
    except TrajectoryError as error:
        raise IdentificationError(f"{experiment.name}: {error}") from error
    setpoints = generator.setpoints(0, round(experiment.duration / _PERIOD) + 1)
    motion = setpoints.transpose(1, 0, 2)
    some = motion[:, ::_TORQUE_STRIDE]
    rigid = rigid_torque(robot.model, setup.drives.rotor_matrix, setup.drives.spring_torque, *some)
    signed = limit_shares(setup, motion, rigid + friction_torque(setup, some[1])[0])
    shares = {name: np.abs(share).max(axis=0) for name, share in signed.items()}
    for name, most, unit in (
        ("motor_speed", robot.max_velocity, "rad/s, through its gear"),
        ("torque", robot.max_effort, "Nm"),
        ("motor_torque", motor_torque_limit(setup), "Nm, through its gear"),
    ):
        share, k = shares[name], int(np.argmax(shares[name]))
        if share[k] > 1.0:
            raise IdentificationError(
                f"{experiment.name}: {whose(setup, name)[k]} would need {share[k] * most[k]:.3g} {unit}; accepted: up "
                f"to {most[k]:.3g}; choose other poses or less speed or acceleration"
            )
    return shares, setpoints
