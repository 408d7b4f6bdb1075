"""What MoveIt sends when it plans at its limits (config/), and whether the controller takes it."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.interpolate import CubicSpline

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError, TrajectoryError
from rx90_common.base.share import config_path
from rx90_common.description.kinematics import forward
from rx90_controller.lines.plan import LinePlan, plan_line
from rx90_controller.lines.task import load_task
from rx90_controller.trajectory import TrajectoryPoints
from rx90_controller.trajectory.generator import TrajectoryGenerator
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.loop.setup import Setup

QUANTITIES = ("velocity", "acceleration")
SAMPLING = 0.1  # s: of Pilz' planner and of MoveIt's time-optimal parameterization


@pytest.fixture(params=["shipped", "tx40"])
def setup(request: pytest.FixtureRequest) -> Setup:
    return request.getfixturevalue(request.param)


def joint_limits(setup: Setup) -> tuple[Array, Array]:
    text = (setup.files.urdf.parent / "moveit" / "joint_limits.yaml").read_text(encoding="utf-8")
    limits = list(yaml.safe_load(text)["joint_limits"].values())
    velocity, acceleration = (np.array([joint[f"max_{what}"] for joint in limits]) for what in QUANTITIES)
    return velocity, acceleration


def generator_at(setup: Setup, position: Array) -> TrajectoryGenerator:
    return TrajectoryGenerator(setup.controller.limits(setup.robot), setup.rates.position_period, position)


def why(setup: Setup, points: TrajectoryPoints) -> str:
    generator = generator_at(setup, points.position[0])
    try:
        generator.accept(points, 0, None)
    except TrajectoryError as error:
        return str(error)
    return ""


def samples(duration: float) -> Array:
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
    found = []
    for joint, way in ((j, w) for j in range(6) for w in (0.02, 0.3, 1.1, 3.3)):
        t, s, v, a = trapezoid(way, velocity[joint], acceleration[joint])
        tables = [np.outer(values, np.eye(6)[joint]) for values in (s, v, a)]
        tables[0] -= np.eye(6)[joint] * way / 2.0
        found.append(TrajectoryPoints(t, *tables))
    return found


def test_the_controller_takes_point_to_point_motions_at_moveit_s_limits(setup: Setup) -> None:
    """PTP at the limits of joint_limits.yaml is taken; at the controller's own some motions are not."""
    velocity, acceleration = joint_limits(setup)
    for points in moves(velocity, acceleration):
        assert not why(setup, points)
        assert not why(setup, points.smoothed())
    own = moves(setup.robot.max_velocity, setup.controller.max_acceleration)
    assert any(why(setup, points) for points in own)


def pilz_line(plan: LinePlan) -> TrajectoryPoints:
    """Return a line as Pilz' LIN sends it: backward differences as velocities, and theirs as accelerations."""
    begin, end = plan.motion
    t = samples(end - begin)
    q = plan.setpoints(t + begin)[:, 0]
    velocity, acceleration = np.zeros_like(q), np.zeros_like(q)
    velocity[1:-1] = np.diff(q[:-1], axis=0) / SAMPLING
    acceleration[1:-1] = np.diff(velocity[:-1], axis=0) / SAMPLING
    return TrajectoryPoints(t, q, velocity, acceleration)


def sent_by_pilz(line: TrajectoryPoints, velocity: Array, acceleration: Array) -> bool:
    """Return whether a line passes Pilz' own check: mean velocities of its steps, and their changes."""
    span = np.diff(line.times)[:, None]
    mean = np.diff(line.position, axis=0, prepend=line.position[:1])[1:] / span
    change = np.diff(mean, axis=0, prepend=np.zeros((1, 6))) / ((SAMPLING + span) / 2.0)
    return bool((np.abs(mean) <= velocity).all() and (np.abs(change) <= acceleration).all())


def lines(setup: Setup) -> list[LinePlan]:
    text = Path(config_path("moveit/pilz_cartesian_limits.yaml")).read_text(encoding="utf-8")
    limits = yaml.safe_load(text)["cartesian_limits"]
    task, generator, plans = load_task(setup.files.required("task")), np.random.default_rng(7), []
    while len(plans) < 12:
        start = np.array(task.start) + generator.uniform(-0.15, 0.15, 3)
        way = generator.normal(size=3)
        speed = generator.uniform(0.2, 1.0) * limits["max_trans_vel"]
        line = replace(
            task,
            start=tuple(start),
            end=tuple(start + way / np.linalg.norm(way) * generator.uniform(0.03, 0.4)),
            speed=speed,
            acceleration=limits["max_trans_acc"],
        )
        with suppress(LineError):
            plan = plan_line(setup.robot, line)
            plans += [plan] * sent_by_pilz(pilz_line(plan), *joint_limits(setup))
    return plans


def test_lines_of_moveit_are_taken_with_velocities_from_their_positions(setup: Setup) -> None:
    """LIN carries velocities that lag: many lines are refused with them, naming the parameter, and none without."""
    plans = lines(setup)
    refused = [why(setup, pilz_line(plan)) for plan in plans]
    assert sum(map(bool, refused)) > 1
    assert all("or velocities_from_positions, where" in reason for reason in refused if reason)
    for plan in plans:
        sent = pilz_line(plan)
        generator = generator_at(setup, sent.position[0])
        generator.join(sent.smoothed(), 0, None, anywhere=False)
        path = generator.setpoints(0, round(sent.times[-1] / setup.rates.position_period) + 2)
        oracle = CubicSpline(sent.times, sent.position, bc_type="clamped")
        ticks = np.arange(len(path) - 2) * setup.rates.position_period
        assert np.abs(path[:-2, 0] - oracle(ticks)).max() < 1e-12
        assert np.abs(path[-1, 0] - sent.position[-1]).max() == 0.0
        assert not path[[0, -1], 1].any()
        given = interpolate(sent.times, sent.position, sent.velocity, sent.acceleration).sample(ticks)[:, 0]
        assert off_the_line(setup, plan, path[:-2, 0]) < min(1e-4, off_the_line(setup, plan, given))


def off_the_line(setup: Setup, plan: LinePlan, joints: Array) -> float:
    start, end = np.array(plan.task.start), np.array(plan.task.end)
    along = (end - start) / np.linalg.norm(end - start)
    away = forward(setup.robot.chain, joints).position - start
    return float(np.linalg.norm(away - np.outer(away @ along, along), axis=1).max())
