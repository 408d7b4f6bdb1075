"""Drives and controller for an identified arm without data on them: assumed, in proportion to the arm.

An identification determines links, rotors and friction. The other values that the simulation needs are chosen such that
it moves the arm without limiting it: motors with the URDF's efforts, brakes and end stops about as stiff as those of
the RX90B for their inertia, gains that are stable for the inertia of every pose, and the arm itself as the model of the
feed-forward.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.description.coupling import Coupling
from rx90_common.description.robot import RobotModel
from rx90_common.rigid_torque import configurations

_POSES = 200
_GEAR = 100.0
_COUNTS = 65536
_OBSERVER_HZ = 400.0
_TORQUE_CONSTANT = 0.1  # Nm/A
_BRAKE_HZ = 50.0
_STOP_HZ = 10.0
_HALF_CRITICAL = 0.5
# 1/s, of all velocity loops together in the arm's lightest pose; the observer has 2500
_FASTEST = 1000.0
_HIGHEST_KV = 400.0  # 1/s
FULL_SPEED_TIME = 0.5
"""Time, s, in which a joint reaches its speed limit with the default acceleration."""
_SOURCE = "nothing is known of it: chosen in proportion to the arm's inertia and to the efforts of its URDF"


def assumed_files(
    robot: RobotModel,
    model: Any,
    turning: Coupling,
    rotors: Array,
    known: Mapping[tuple[str, str], Any],
    acceleration: Array | float = 0.0,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the contents of a drives and of a controller file.

    Args:
        robot: ranges, speeds and efforts.
        model: Pinocchio's, with the bodies that count.
        turning: which joints each motor turns with.
        rotors: of the motors, seen through their gears, kg m^2, shape (n,).
        known: blocks and keys of the drives file with other values, such as ("transmission", "gear"): the motors then
            give the same torques at the joints.
        acceleration: of the joints in the recorded motions, rad/s^2, shape (n,), or 0.
    """
    mean, nominal, least, most = _inertias(robot, model, turning, rotors)
    n = len(rotors)
    effort = np.abs(turning.joint_turns.T) @ robot.max_effort
    kv = min(_HIGHEST_KV, _FASTEST / most)

    def of_motors(block: str, key: str, usual: float) -> Array:
        return np.array(known[block, key].value if (block, key) in known else [usual] * n)

    gear = of_motors("transmission", "gear", _GEAR)
    constant = of_motors("motor", "torque_constant", _TORQUE_CONSTANT)
    current = effort / np.abs(gear * constant)
    # A light link could reach thousands of rad/s^2: the accelerations of plans and recorded motions are enough.
    fastest = np.maximum(robot.max_velocity / FULL_SPEED_TIME, acceleration)
    fastest = np.minimum(fastest, 0.5 * effort / mean)

    def held(frequency: float) -> dict[str, list[float]]:
        pole = 2.0 * math.pi * frequency
        return {
            "stiffness": _six(pole * pole * least),
            "damping": _six(2.0 * _HALF_CRITICAL * pole * least),
        }

    drives: dict[str, dict[str, Any]] = {
        "transmission": {
            "gear": _six(gear), "rotor_inertia": _six(rotors),
            "coupling": turning.turns.tolist(),
        },
        "motor": {"torque_constant": _six(constant), "peak_current": _six(current)},
        "encoder": {"counts_per_revolution": _COUNTS, "velocity_bandwidth": _OBSERVER_HZ},
        "brake": {"torque": _six(1.5 * effort), **held(_BRAKE_HZ)},
        "spring": {"torque": [0.0] * n},
        "end_stops": held(_STOP_HZ),
    }  # fmt: skip
    controller: dict[str, dict[str, Any]] = {
        "servo": {
            "inertia": _six(nominal), "kp": _six(np.full(n, kv / 4.0)), "kv": _six(np.full(n, kv)),
            "ki": _six(np.full(n, kv**3 / 80.0)),
            "integrator_limit": _six(effort),
        },
        "feed_forward": {
            "velocity": True, "acceleration": True, "coulomb": True, "viscous": True,
            "inverse_dynamics": True, "friction_model": True,
            "coulomb_torque": [0.0] * n, "coulomb_velocity": 0.01, "viscous_friction": [0.0] * n,
        },
        "current_loop": {"bandwidth": 800.0, "slew_rate": _six(2000.0 * current)},
        "supervision": {"following_error": [0.1] * n, "over_speed": 1.2},
        "trajectory": {"start_tolerance": 1e-3, "max_acceleration": _six(fastest)},
    }  # fmt: skip
    return _marked(drives), _marked(controller)


def _marked(content: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {
        name: {"provenance": "assumed", "source": _SOURCE, **block}
        for name, block in content.items()
    }


def _six(values: Array) -> list[float]:
    """Return plain numbers of six digits."""
    return [float(f"{value:.6g}") for value in values]


def _inertias(
    robot: RobotModel, model: Any, turning: Coupling, rotors: Array
) -> tuple[Array, Array, Array, float]:
    """Return inertias of the motors, seen through their gears, kg m^2, shape (n,) each.

    Mean over poses with the other joints at rest, that for the controller, and the least in any pose with the other
    joints free; and the largest ratio of that for the controller to the inertia in a motion of several motors.
    """
    data = model.createData()
    back = turning.joint_turns
    masses = []
    shares = np.random.default_rng(0).uniform(size=(_POSES, len(rotors)))
    for pose in configurations(model, robot.lower + shares * (robot.upper - robot.lower)):
        upper = np.triu(pin.crba(model, data, pose))
        masses.append(back.T @ (upper + np.triu(upper, 1).T) @ back + np.diag(rotors))
    inverses = np.linalg.inv(masses)
    mean = np.mean(np.diagonal(masses, axis1=1, axis2=2), axis=0)
    least = np.min(1.0 / np.diagonal(inverses, axis1=1, axis2=2), axis=0)
    nominal = np.sqrt(mean * least)
    root = np.sqrt(nominal)
    most = float(np.linalg.eigvalsh(root[:, None] * inverses * root)[:, -1].max())
    return mean, nominal, least, most
