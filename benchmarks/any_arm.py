"""Robot folders of made-up arms with 1 to 7 joints and any coupling, and the speed of their closed loop on one core.

    python -m benchmarks.any_arm

The arm of seven joints moves all of them at once, for a minute, with all that the shipped RX90B has on; the RX90B does
likewise, and both take turns. Times are processor times of the one thread that works.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.report import in_turns, merge, print_times, timed
from rx90_common.base.config import yaml_text
from rx90_common.description.coupling import Coupling
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup, load_setup

_MASS = (8.0, 7.0, 5.0, 4.0, 2.5, 1.8, 1.0)
_LENGTH = 0.25  # m, of each link


def write_arm(folder: Path, joints: int, coupling: Sequence[Sequence[float]] | None = None) -> Path:
    """Write a robot folder: links of different masses, axes about z, y, y, z, y, z, y that none of them is along.

    Args:
        folder: to make.
        joints: 1 to 7.
        coupling: as drives.yaml has it; None to leave it out.
    """
    folder.mkdir(parents=True, exist_ok=True)
    masses = _MASS[-joints:]
    (folder / "robot.urdf").write_text(_urdf(masses), encoding="utf-8")
    inertia = [0.05 + 1.5 * sum(masses[i:]) * (_LENGTH * (joints - i)) ** 2 for i in range(joints)]
    peak = [3.0 * 9.81 * sum(masses[i:]) * _LENGTH * (joints - i) + 20.0 for i in range(joints)]
    turning = Coupling(np.array(coupling, np.float64)) if coupling else Coupling.usual(joints)
    names = turning.element_names(joint_names(joints))
    gear = [(-1.0) ** i * (50.0 + 10.0 * i) for i in range(joints)]
    transmission = {"gear": gear, "rotor_inertia": [0.1 * value for value in inertia]}
    if coupling:
        transmission["coupling"] = [list(map(float, row)) for row in coupling]
    content = {
        "drives.yaml": {
            "transmission": transmission,
            "motor": {"torque_constant": [0.3] * joints, "peak_current": [p / 0.3 / 50.0 for p in peak]},
            "encoder": {"counts_per_revolution": 65536, "velocity_bandwidth": 400.0},
            "brake": {
                "torque": peak, "stiffness": [2e4 * i for i in inertia], "damping": [40.0 * i for i in inertia]
            },
            "spring": {"torque": [2.0 * (i == 1) for i in range(joints)]},
            "end_stops": {"stiffness": [1e3 * i for i in inertia], "damping": [20.0 * i for i in inertia]},
        },
        "friction.yaml": {
            "elements": {
                name: {
                    "tau_c": 2.0 - 0.1 * k, "tau_s": 2.5 - 0.1 * k, "omega_s": 0.05, "delta": 1.0,
                    "c0": 4000.0 - 100.0 * k, "c1": 4.0, "c2": 1.0 + 0.2 * k, "omega_d": 1.0,
                }
                for k, name in enumerate(names)
            }
        },
        "controller.yaml": {
            "servo": {
                "inertia": [1.1 * i for i in inertia], "kp": [50.0] * joints, "kv": [200.0] * joints,
                "ki": [1e5] * joints, "integrator_limit": peak,
            },
            "feed_forward": {
                "velocity": True, "acceleration": True, "coulomb": True, "viscous": True,
                "coulomb_torque": [2.0] * joints, "coulomb_velocity": 0.01, "viscous_friction": [1.0] * joints,
            },
            "current_loop": {"bandwidth": 800.0, "slew_rate": [3e5] * joints},
            "supervision": {"following_error": [0.2] * joints, "over_speed": 1.5},
            "trajectory": {"start_tolerance": 1e-3, "max_acceleration": [20.0] * joints},
        },
    }  # fmt: skip
    for name, values in content.items():
        (folder / name).write_text(yaml_text(values), encoding="utf-8")
    return folder


def joint_names(joints: int) -> tuple[str, ...]:
    """Return the names of the joints."""
    return tuple(f"arm_{i}" for i in range(1, joints + 1))


def _urdf(masses: Sequence[float]) -> str:
    axes = ("0.1 0.2 1", "0.1 1 0.1", "0.2 1 0", "0.1 0 1", "0 1 0.2", "0.3 0.1 1", "0 1 0")
    axes = axes[-len(masses) :]
    parts = ['<robot name="any_arm"><link name="base"/>']
    for i, (mass, axis) in enumerate(zip(masses, axes, strict=True), 1):
        parent, place = ("base", "0 0 0.3") if i == 1 else (f"link_{i - 1}", f"0.05 0.02 {_LENGTH}")
        moment = mass * _LENGTH**2 / 12.0
        parts.append(
            f'<joint name="arm_{i}" type="revolute"><origin xyz="{place}" rpy="0.1 {0.2 * i:g} -0.1"/>'
            f'<parent link="{parent}"/><child link="link_{i}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.5" upper="2.5" velocity="3.0" effort="100"/></joint>'
            f'<link name="link_{i}"><inertial><origin xyz="0.02 0.01 {_LENGTH / 2.0}" rpy="0.1 0 0"/>'
            f'<mass value="{mass}"/><inertia ixx="{1.1 * moment}" iyy="{moment}" izz="{0.4 * moment}" '
            f'ixy="{0.02 * moment}" ixz="{-0.03 * moment}" iyz="{0.01 * moment}"/></inertial></link>'
        )
    return "".join([*parts, "</robot>"])


_DURATION, _WAY = 60, 0.3  # s, rad in a second
_SEVEN, _RX90B = "seven joints", "RX90B"


def _swing(setup: Setup) -> Callable[[], float]:
    """Return a function that moves all joints to and fro and gives the time of a tick, s."""
    joints = len(setup.robot.joint_names)
    times = np.arange(_DURATION + 1.0)
    position = np.outer(times % 2.0, np.full(joints, _WAY))
    points = TrajectoryPoints(times, position, np.zeros_like(position), np.zeros_like(position))
    return timed(lambda: simulate(setup, points), setup.rates.ticks_of(float(_DURATION)))


def main() -> int:
    """Measure, print the table and merge the figures."""
    with tempfile.TemporaryDirectory() as folder:
        seven = load_setup(robot=write_arm(Path(folder) / "arm", 7))
        period = seven.rates.period
        times = in_turns({_SEVEN: _swing(seven), _RX90B: _swing(Setup.load())}, rounds=7)
    median = print_times("closed loop at 4 kHz", times, _RX90B, period)
    merge({"seven_joints_real_time_factor": period / median[_SEVEN]})
    return 0


if __name__ == "__main__":
    sys.exit(main())
