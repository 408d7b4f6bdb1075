"""Arms that are not this project's, and their bags, without the code under test: Pinocchio, SciPy and rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from bag_making import ROS1, joint_state, write_ros1, write_ros2
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from rx90_common.rigid_torque import rigid_torque

Array = NDArray[np.float64]

_LINK = """<link name="{name}_link"><inertial><origin xyz="0.05 0.02 0.2"/><mass value="{mass}"/>
  <inertia ixx="{i}" iyy="{i}" izz="{j}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}" type="{kind}"><origin xyz="0 0 {offset}"/><parent link="{parent}"/><child link="{name}_link"/>
  <axis xyz="{axis}"/>{limit}</joint>"""
_LIMIT = '<limit lower="-3" upper="3" velocity="3" effort="{effort}"/>'


def urdf_text(joints: Sequence[str], axes: Sequence[str], masses: Sequence[float], kind: str = "revolute") -> str:
    """Return a serial chain; its effort limits are 0, because many a robot's are."""
    links, parent = [], "base"
    for name, axis, mass in zip(joints, axes, masses, strict=True):
        limit = _LIMIT.format(effort=0) if kind == "revolute" else ""
        offset = 0.1 if parent == "base" else 0.4
        links.append(_LINK.format(name=name, mass=mass, i=0.02 * mass, j=0.005 * mass, kind=kind, parent=parent,
                                  axis=axis, limit=limit, offset=offset))  # fmt: skip
        parent = f"{name}_link"
    return f'<robot name="arm"><link name="base"/>{"".join(links)}</robot>'


def write_urdf(
    folder: Path, joints: Sequence[str], axes: Sequence[str], masses: Sequence[float], kind: str = "revolute"
) -> Path:
    file = folder / "arm.urdf"
    file.write_text(urdf_text(joints, axes, masses, kind), encoding="utf-8")
    return file


def some_rows(record: Any, kept: Any) -> Any:
    return replace(record, **{name: getattr(record, name)[kept] for name in ("time", "position", "velocity", "torque")})


@dataclass(frozen=True)
class Curve:
    """Steady friction of one element: sign(v) (tau_c + (tau_s - tau_c) exp(-(|v| / omega_s)^delta)) + c2 v."""

    tau_c_positive: float
    tau_c_negative: float
    tau_s_positive: float
    tau_s_negative: float
    omega_s: float
    delta: float
    c2: float

    def __call__(self, velocity: Array) -> Array:
        forward = velocity > 0.0
        coulomb = np.where(forward, self.tau_c_positive, self.tau_c_negative)
        static = np.where(forward, self.tau_s_positive, self.tau_s_negative)
        decay = np.exp(-((np.abs(velocity) / self.omega_s) ** self.delta))
        return np.asarray(np.sign(velocity) * (coulomb + (static - coulomb) * decay) + self.c2 * velocity)

    def scaled(self, factor: float) -> Curve:
        torques = {name: factor * value for name, value in vars(self).items() if name not in ("omega_s", "delta")}
        return replace(self, **torques)


@dataclass(frozen=True)
class Program:
    """Sweeps: at each pose along each direction of joint velocities there and back at each speed, rad/s."""

    directions: Sequence[Sequence[float]]
    poses: Sequence[Sequence[float]]
    speeds: Sequence[float]
    rate: float

    def motion(self) -> tuple[Array, Array]:
        parts = []
        for pose in self.poses:
            for direction in np.array(self.directions):
                for speed in self.speeds:
                    parts.append(self._there_and_back(np.array(pose), direction, speed))
        position, velocity = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return position, velocity

    def _there_and_back(self, pose: Array, direction: Array, speed: float) -> tuple[Array, Array]:
        hold = round(max(0.9, 0.02 / speed) * self.rate)
        ramp = np.arange(round(0.05 * self.rate)) / round(0.05 * self.rate)
        rest = np.zeros(len(ramp))
        pulse = np.concatenate([ramp, np.ones(hold), 1.0 - ramp, rest])
        shape = speed * np.concatenate([rest, pulse, -pulse])
        travel = np.concatenate([[0.0], np.cumsum(0.5 * (shape[1:] + shape[:-1]))]) / self.rate
        return pose + travel[:, None] * direction, shape[:, None] * direction


def drive_torque(model: Any, matrix: Array, curves: Sequence[Curve], motion: tuple[Array, Array], rate: float) -> Array:
    """Return the joints' torques, (m, n), some at rest, too; `matrix` leads to the elements, (n_el, n)."""
    position, velocity = motion
    acceleration = np.gradient(velocity, 1.0 / rate, axis=0)
    n = position.shape[1]
    rigid = rigid_torque(model, np.zeros((n, n)), np.zeros(n), position, velocity, acceleration)
    inputs = velocity @ matrix.T
    friction = np.column_stack([curve(inputs[:, e]) for e, curve in enumerate(curves)])
    resting = 0.3 * np.array([curve.tau_c_positive for curve in curves])
    return np.asarray(rigid + np.where(inputs == 0.0, resting, friction) @ matrix)


def write(
    path: Path,
    topic: str,
    names: Sequence[str],
    rate: float,
    fields: tuple[Array, Array | None, Array],
    storage: str = "mcap",
    header: bool = True,
) -> Path:
    """Write JointState messages, fields of shape (m, k), to a file for "ros1", else a folder; no header: stamps 0."""
    store = {"store": ROS1} if storage == "ros1" else {}
    rows = []
    for k in range(len(fields[0])):
        stamp = 5 * 10**9 + round(k * 1e9 / rate)
        values = [() if field is None else field[k] for field in fields]
        rows.append((topic, stamp + 300_000, joint_state(stamp if header else 0, list(names), *values, **store)))
    return write_ros1(path, rows) if storage == "ros1" else write_ros2(path, rows, storage)


def write_fallback(path: Path, elements: Sequence[str]) -> Path:
    both = {"positive": 1.0, "negative": 1.0}
    values = {"tau_c": both, "tau_s": both, "omega_s": 0.1, "delta": 1.0, "c0": 12345.0, "c1": 10.0, "c2": 1.0}
    path.write_text(yaml.safe_dump({"elements": dict.fromkeys(elements, values)}), encoding="utf-8")
    return path


def micro_oscillation(inertia: float, curve: Curve, c0: float, c1: float, rate: float) -> tuple[Array, Array, Array]:
    """Return position, velocity and torque of a joint without weight: 2.5 s of four tones at once.

    The LuGre equations under a given torque, by SciPy:  J dv/dt = u - c0 z - c1 dz/dt - c2 v,
    dz/dt = v - c0 |v| z / g(v).
    """
    tones = (3.0, 8.0, 14.0, 22.0)

    def torque(t: Array | float) -> Array:
        t = np.asarray(t)
        wave = sum(np.sin(2.0 * np.pi * f * t) for f in tones)
        return np.asarray(0.15 * curve.tau_c_positive * wave * np.clip(t / 0.3, 0.0, 1.0))

    def slope(t: float, state: Array) -> list[float]:
        _, v, z = state
        coulomb, static = ((curve.tau_c_positive, curve.tau_s_positive) if v > 0.0
                           else (curve.tau_c_negative, curve.tau_s_negative))  # fmt: skip
        g = coulomb + (static - coulomb) * np.exp(-((abs(v) / curve.omega_s) ** curve.delta))
        dz = v - c0 * abs(v) * z / g
        return [v, (float(torque(t)) - c0 * z - c1 * dz - curve.c2 * v) / inertia, dz]

    time = np.arange(round(2.5 * rate)) / rate
    found = solve_ivp(slope, (0.0, time[-1]), [0.0, 0.0, 0.0], "RK45", time, rtol=1e-6, atol=1e-10, max_step=2e-3)
    return found.y[0], found.y[1], torque(time)
