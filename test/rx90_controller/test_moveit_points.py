"""What MoveIt sends when it plans at its limits (config/), and whether the controller takes it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.interpolate import BPoly

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.share import config_path
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.generator import TrajectoryGenerator
from rx90_emulator.loop.setup import Setup
from tools import moveit_files

SAMPLING = 0.1  # s: of Pilz' planner and of MoveIt's time-optimal parameterization


@pytest.fixture(params=["shipped", "tx40"])
def setup(request: pytest.FixtureRequest) -> Setup:
    """Return each shipped robot."""
    found: Setup = request.getfixturevalue(request.param)
    return found


def period(setup: Setup) -> float:
    """Return that of the position loop, s."""
    return setup.rates.period * setup.rates.ratio


def taken(setup: Setup, points: TrajectoryPoints) -> bool:
    """Tell whether the controller takes a trajectory."""
    generator = TrajectoryGenerator(setup.controller.limits(setup.robot), period(setup), points.position[0])
    try:
        generator.accept(points, 0, None)
    except TrajectoryError:
        return False
    return True


def samples(duration: float) -> Array:
    """Return the times at which MoveIt samples a motion: every 0.1 s and at the end."""
    return np.append(np.arange(0.0, duration - 1e-5, SAMPLING), duration)


def trapezoid(way: float, velocity: float, acceleration: float) -> tuple[Array, Array, Array, Array]:
    """Return times, way, velocity and acceleration of a point-to-point motion, as sampled by Pilz' PTP."""
    top = min(velocity, np.sqrt(way * acceleration))
    ramp = top / acceleration
    duration = way / top + ramp
    t = samples(duration)
    up, down = np.minimum(t, ramp), np.maximum(t - duration + ramp, 0.0)
    v = acceleration * (up - down)
    s = acceleration * (up**2 / 2.0 - down**2 / 2.0) + top * np.maximum(t - ramp, 0.0)
    a = acceleration * ((t < ramp).astype(float) - (t > duration - ramp))
    v[-1] = a[-1] = 0.0
    return t, s, v, a


def moves(velocity: Array, acceleration: Array) -> list[TrajectoryPoints]:
    """Return point-to-point motions of each joint alone, short and long ones, at these limits."""
    found = []
    for joint, way in ((j, w) for j in range(6) for w in (0.02, 0.3, 1.1, 3.3)):
        t, s, v, a = trapezoid(way, velocity[joint], acceleration[joint])
        tables = [np.outer(values, np.eye(6)[joint]) for values in (s, v, a)]
        tables[0] -= np.eye(6)[joint] * way / 2.0
        found.append(TrajectoryPoints(t, *tables))
    return found


def test_the_controller_takes_point_to_point_motions_at_moveit_s_limits(setup: Setup) -> None:
    """PTP at the limits of joint_limits.yaml is taken; at the controller's own some motions are not."""
    assert setup.files is not None
    text = (setup.files.urdf.parent / "moveit" / "joint_limits.yaml").read_text(encoding="utf-8")
    limits = yaml.safe_load(text)["joint_limits"].values()
    velocity, acceleration = (
        np.array([joint[f"max_{what}"] for joint in limits]) for what in ("velocity", "acceleration")
    )
    assert all(taken(setup, points) for points in moves(velocity, acceleration))
    own = moves(setup.robot.max_velocity, setup.controller.max_acceleration)
    assert not all(taken(setup, points) for points in own)


def test_the_controller_takes_lines_at_moveit_s_limits(setup: Setup) -> None:
    """LIN at the limits of config/moveit is taken, though its velocities lag, if its last step is a tick or longer."""
    assert setup.files is not None
    text = Path(config_path("moveit/pilz_cartesian_limits.yaml")).read_text(encoding="utf-8")
    limits = yaml.safe_load(text)["cartesian_limits"]
    task = load_task(setup.files.required("task"))
    start, end = np.array(task.start), np.array(task.end)
    for share in np.linspace(0.41, 0.99, 6):
        line = replace(
            task,
            end=tuple(start + share * (end - start)),
            speed=limits["max_trans_vel"],
            acceleration=limits["max_trans_acc"],
            rest_before=0.0,
            rest_after=0.0,
        )
        plan = plan_line(setup.robot, line)
        t = samples(plan.duration)
        assert t[-1] - t[-2] >= period(setup), share
        q = plan.setpoints(t)[:, 0]
        velocity = np.diff(q, axis=0, prepend=q[:1]) / SAMPLING
        velocity[-1] = 0.0
        acceleration = np.diff(velocity, axis=0, prepend=velocity[:1]) / SAMPLING
        acceleration[-1] = 0.0
        assert taken(setup, TrajectoryPoints(t, q, velocity, acceleration)), share


def test_half_the_acceleration_is_enough_for_every_switch() -> None:
    """Between samples of a profile that switches its acceleration a quintic exceeds it by 81 %, and v by 0.068 a T."""
    most, faster = 0.0, 0.0
    for before, after in itertools.product((1.0, 0.0, -1.0), repeat=2):
        for switch in np.linspace(0.0, 1.0, 41):
            v = before * switch + after * (1.0 - switch)
            s = before * switch * (1.0 - switch / 2.0) + after * (1.0 - switch) ** 2 / 2.0
            # At the ends of a motion the acceleration is sent as 0.
            for ends in itertools.product({before, 0.0}, {after, 0.0}):
                quintic = BPoly.from_derivatives([0.0, 1.0], [[0.0, 0.0, ends[0]], [s, v, ends[1]]])
                t = np.linspace(0.0, 1.0, 101)
                most = max(most, abs(quintic(t, 2)).max())
                if ends == (before, after):
                    of_profile = np.where(t < switch, before * t, before * switch + after * (t - switch)).max()
                    faster = max(faster, quintic(t, 1).max() - of_profile)
    assert 1.80 < most < 1.81 < 1.0 / moveit_files.ACCELERATION_SHARE
    assert 0.0675 < faster < 0.0685
