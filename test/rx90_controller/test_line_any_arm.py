"""Straight lines of arms without a closed form: by Pinocchio's kinematics, SciPy's integrator and least squares."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from grip_arm import JOINTS, POSTURE, write_urdf
from pinocchio_chain import tip_pose
from scipy.integrate import solve_ivp
from scipy.interpolate import BPoly
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array
from rx90_common.base.errors import LineError
from rx90_common.base.share import config_path
from rx90_common.description.joint_model import robot_of_urdf
from rx90_common.description.robot import RobotModel
from rx90_controller.lines.plan import LinePlan, describe_line, plan_line
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.setup import Setup

WAY = np.array([0.12, 0.25, -0.1])  # m
TURN = pin.rpy.rpyToMatrix(0.2, -0.3, 0.4)


def _line(robot: RobotModel, way: Array = WAY, turn: Array | None = None, **more: object) -> LineTask:
    """Return a line from the tool's pose at POSTURE, by Pinocchio, which the tool is turned on."""
    posture = np.array(POSTURE[: len(robot.joint_names)])
    place, rotation = _pose(robot, posture)
    ends = tuple(tuple(pin.rpy.matrixToRpy(one)) for one in (rotation, rotation if turn is None else turn @ rotation))
    return LineTask(
        tuple(place),
        tuple(place + way),
        0.2,
        1.0,
        *ends,
        start_posture=tuple(posture),
        **more,  # type: ignore[arg-type]
    )


def _pose(robot: RobotModel, q: Array) -> tuple[Array, Array]:
    pose = tip_pose(robot, q)
    return pose[:3, 3], pose[:3, :3]


def _asked(task: LineTask, times: Array) -> tuple[Array, list[Array]]:
    ramp, whole = task.speed / task.acceleration, task.length / task.speed
    t = np.clip(times - task.rest_before, 0.0, whole + ramp)
    up, down = np.minimum(t, ramp), np.maximum(t - whole, 0.0)
    way = 0.5 * task.acceleration * up**2 + task.speed * np.maximum(t - ramp, 0.0)
    way -= 0.5 * task.acceleration * down**2
    share = way / task.length
    first, last = (pin.rpy.rpyToMatrix(*rpy) for rpy in (task.start_rpy, task.end_rpy))
    turn = pin.log3(last @ first.T)
    places = np.array(task.start) + share[:, None] * np.subtract(task.end, task.start)
    return places, [pin.exp3(one * turn) @ first for one in share]


def _between_knots(plan: LinePlan, count: int) -> tuple[Array, Array]:
    times = np.linspace(0.0, plan.duration, count)
    knots = np.stack([plan.position, plan.velocity, plan.acceleration], axis=1)
    return times, BPoly.from_derivatives(plan.times, list(knots))(times)


@pytest.fixture(scope="module")
def seven(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return robot_of_urdf(write_urdf(tmp_path_factory.mktemp("seven")), JOINTS)


@pytest.fixture(scope="module")
def plan(seven: RobotModel) -> LinePlan:
    return plan_line(seven, _line(seven, turn=TURN))


@pytest.fixture(scope="module", params=["seven joints", "closed form", "closed form, the tool turns"])
def planned(request: pytest.FixtureRequest, seven: RobotModel, plan: LinePlan, shipped: Setup) -> Any:
    if request.param == "seven joints":
        return seven, plan
    line = load_task(config_path("robots/rx90b/task.yaml"))
    turning = replace(line, start=(0.5, -0.2, 0.4), end=(0.55, 0.15, 0.3), speed=0.25, acceleration=3.0,
                      start_rpy=(0.0, 2.7, 0.1), end_rpy=(0.6, 2.2, -0.4), rest_before=0.1234567)  # fmt: skip
    return shipped.robot, plan_line(shipped.robot, turning if "turns" in request.param else line)


def test_place_and_orientation_are_kept_between_the_knots(planned: tuple[RobotModel, LinePlan]) -> None:
    """By Pinocchio, SciPy's quintics through the knots keep 0.1 µm and 1 µrad of the line all the way, in time."""
    robot, plan = planned
    times, angles = _between_knots(plan, 1501)
    places, rotations = _asked(plan.task, times)
    for q, place, rotation in zip(angles, places, rotations, strict=True):
        there, turned = _pose(robot, q)
        assert np.linalg.norm(there - place) < 1.01e-7
        assert np.linalg.norm(pin.log3(turned.T @ rotation)) < 1e-6
    assert plan.tip_error <= 1e-7


def test_knots_carry_the_derivatives_of_exact_positions(planned: tuple[RobotModel, LinePlan]) -> None:
    """Away from the corners of the profile, velocities and accelerations are differences of exact positions."""
    _, plan = planned
    task, h = plan.task, 1e-4
    profile = task.profile()
    inner = np.abs(plan.times[:, None] - task.rest_before - np.array(profile.corners)).min(axis=1) > 2.5 * h
    t = plan.times[inner]
    exact = [plan.path.at(profile.sample(t + k * h - task.rest_before).distance)[0] for k in (-2, -1, 0, 1, 2)]
    velocity = (exact[0] - 8 * exact[1] + 8 * exact[3] - exact[4]) / (12 * h)
    acceleration = (-exact[0] + 16 * exact[1] - 30 * exact[2] + 16 * exact[3] - exact[4]) / (12 * h * h)
    assert inner.sum() > 20
    np.testing.assert_allclose(plan.velocity[inner], velocity, atol=1e-9)
    np.testing.assert_allclose(plan.acceleration[inner], acceleration, atol=1e-5)


def test_seven_joints_move_with_the_least_speed(seven: RobotModel, plan: LinePlan) -> None:
    """To 1e-9 rad the path of the pseudo-inverse of Pinocchio's Jacobian, by SciPy; another posture, another path."""
    task, data = plan.task, seven.model.createData()
    frame = seven.model.getFrameId(seven.tcp_frame)
    first, last = (pin.rpy.rpyToMatrix(*rpy) for rpy in (task.start_rpy, task.end_rpy))
    twist = np.concatenate([np.subtract(task.end, task.start), pin.log3(last @ first.T)]) / task.length

    def slope(_: float, q: Array) -> Array:
        j = pin.computeFrameJacobian(seven.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(np.linalg.pinv(j) @ twist)

    distance = plan.path.distance
    found = solve_ivp(slope, (0.0, distance[-1]), POSTURE, "DOP853", distance, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(plan.path.position, found.y.T, atol=1e-9)
    j = pin.computeFrameJacobian(seven.model, data, np.array(POSTURE), frame, pin.LOCAL_WORLD_ALIGNED)
    aside = np.array(POSTURE) + 0.3 * np.linalg.svd(j)[2][-1]
    other = plan_line(seven, replace(task, start_posture=tuple(aside)))
    assert np.abs(other.position[0] - plan.position[0]).max() > 0.05
    assert "no motion in the null space" in describe_line(plan)


def test_five_joints_keep_place_and_direction_of_the_tool(tmp_path: Path) -> None:
    """By SciPy's least squares on Pinocchio's kinematics, for place and z axis alone, the angles are those."""
    robot = robot_of_urdf(write_urdf(tmp_path, 5), JOINTS[:5])
    plan = plan_line(robot, _line(robot, 0.4 * WAY))
    knots = np.arange(len(plan.times))[:: len(plan.times) // 6]
    places, rotations = _asked(plan.task, plan.times[knots])
    for k, place, rotation in zip(knots, places, rotations, strict=True):

        def missed(q: Array, place: Array = place, axis: Array = rotation[:, 2]) -> Array:
            there, turned = _pose(robot, q)
            return np.concatenate([there - place, turned[:, 2] - axis])

        found = least_squares(
            missed, plan.position[k] + 1e-2 * np.cos(np.arange(5)), xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        np.testing.assert_allclose(found.x, plan.position[k], atol=1e-8)
        np.testing.assert_allclose(missed(plan.position[k]), 0.0, atol=1e-11)
    assert "turns about its z axis" in describe_line(plan)
    assert not plan.velocity[-1].any()


def _refusal(robot: RobotModel, task: LineTask) -> tuple[str, float]:
    with pytest.raises(LineError) as refusal:
        plan_line(robot, task)
    message = str(refusal.value)
    place = re.search(r"at (\d+\.\d+) m from its start", message)
    assert place is not None, message
    return message, float(place[1])


def test_a_line_into_the_singularity_or_beyond_the_reach_is_refused(seven: RobotModel) -> None:
    """Where the least singular value, by NumPy, falls below 0.05; a start out of reach tells what is missing."""
    outwards = np.array([0.9, 0.2, 0.1])
    message, place = _refusal(seven, _line(seven, outwards))
    assert "arm singularity" in message
    wide = plan_line(seven, _line(seven, outwards * (place - 2e-3) / np.linalg.norm(outwards)))
    data, frame = seven.model.createData(), seven.model.getFrameId(seven.tcp_frame)
    j = pin.computeFrameJacobian(seven.model, data, wide.position[-1], frame, pin.LOCAL_WORLD_ALIGNED)
    assert 0.05 < np.linalg.svd(j, compute_uv=False)[-1] < 0.053
    far = replace(_line(seven), start=(5.0, 0.0, 0.5), end=(5.0, 0.1, 0.5))
    message, place = _refusal(seven, far)
    missed = re.search(r"out of reach, Newton's steps end ([\d.]+) m and", message)
    assert missed is not None, message
    assert place == 0.0
    reach = float(np.abs(np.linalg.norm(seven.chain.origin, axis=1)).sum() + np.linalg.norm(seven.chain.tcp_position))
    assert float(missed[1]) > 4.0 - reach


@pytest.mark.parametrize(
    ("joints", "change", "said"),
    [
        (4, {}, "a line of an arm of 4 joints; accepted: of 5 to 7"),
        (7, {"start_posture": (0.1, 0.2)}, "start_posture has 2 numbers; accepted: 7, one per joint"),
    ],
)
def test_what_no_line_is_for_is_refused(tmp_path: Path, joints: int, change: dict[str, object], said: str) -> None:
    robot = robot_of_urdf(write_urdf(tmp_path, joints), JOINTS[:joints])
    with pytest.raises(LineError, match=re.escape(said)):
        plan_line(robot, replace(_line(robot), **change))  # type: ignore[arg-type]


def test_the_command_plans_from_a_posture(shipped: Setup, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`rx90 line --start-posture` without --start begins in that posture, of an arm without a closed form or a task."""
    text = shipped.files.urdf.read_text(encoding="utf-8")
    last = '<origin xyz="0 0 0.085"/>\n    <parent link="link_5"/>'
    assert text.count(last) == 1
    file = tmp_path / "aside.urdf"
    file.write_text(text.replace(last, last.replace("0 0 0.085", "0.03 0.01 0.085")), encoding="utf-8")
    posture = (0.1, 0.4, 0.9, 0.3, 0.8, -0.2)
    place, _ = _pose(robot_of_urdf(file), np.array(posture))
    end = " ".join(f"{value:.6f}" for value in np.add(place, (0.02, 0.03, 0.01)))
    words = f"--urdf {file} --tool none --start-posture {' '.join(map(str, posture))} --end {end} --dry-run"
    assert run("rx90 line", words.split()) == 0
    rows = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()}
    starts = [float(rows[f"joint_{k}"][0]) for k in range(1, 7)]
    assert starts == pytest.approx(np.degrees(posture), abs=0.01)
