"""Straight lines: against SciPy and by hand, and where the arm cannot go."""

import itertools
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from rx90_common.base.errors import LineError
from rx90_common.base.share import config_path
from rx90_common.description.branch import SHOULDERS, SIGNS, Branch
from rx90_common.description.inverse import SphericalWristArm
from rx90_common.description.kinematics import forward, path_error
from rx90_common.description.robot import RobotModel
from rx90_controller.lines import plan as planning
from rx90_controller.lines.plan import LinePlan, approach_duration, plan_line
from rx90_controller.lines.task import LineTask, TrapezoidalProfile, load_task
from rx90_emulator.loop.setup import Setup


@pytest.fixture(scope="module")
def task() -> LineTask:
    return load_task(config_path("robots/rx90b/task.yaml"))


def _spline(plan: LinePlan) -> BPoly:
    values = np.stack([plan.position, plan.velocity, plan.acceleration], axis=1)
    return BPoly.from_derivatives(plan.times, list(values))


def test_rest_is_exactly_still(shipped: Setup, task: LineTask) -> None:
    """Velocities and accelerations are exactly zero at rest, and those of joint 4 all the way."""
    plan = plan_line(shipped.robot, task)
    rest = (plan.times < 1.0) | (plan.times > 5.1)
    assert rest.sum() == 4
    assert not plan.velocity[rest].any()
    assert not plan.acceleration[rest].any()
    assert np.array_equal(plan.position[0], plan.position[1])
    assert not plan.velocity[:, 3].any()
    assert not np.ptp(plan.position[:, 3])


@pytest.mark.parametrize("branch", itertools.starmap(Branch, itertools.product(SHOULDERS, SIGNS, SIGNS)), ids=str)
def test_the_branch_asked_for_is_kept(shipped: Setup, branch: Branch) -> None:
    """Where a branch is within limits, the whole line stays in it and runs through the same points."""
    side = LineTask((-0.1, 0.5, 0.6), (0.1, 0.45, 0.6), 0.1, 1.0, (0.0, 2.4, 1.2), (0.0, 2.4, 1.2), branch=branch)
    robot = _wide(shipped.robot)
    plan = plan_line(robot, side)
    q = plan.position
    arm = SphericalWristArm.from_chain(robot.chain)
    assert np.all((q[:, 2] > 0) == (branch.elbow == "positive"))
    assert np.all((np.sin(q[:, 4]) > 0) == (branch.wrist == "positive"))
    assert np.all((arm.forward_reach(robot.chain, q) > 0) == (branch.shoulder == "front"))
    np.testing.assert_allclose(forward(robot.chain, q).position, plan.tip(plan.times), atol=1e-12)


def _wide(robot: RobotModel) -> RobotModel:
    return replace(robot, lower=np.full(6, -7.0), upper=np.full(6, 7.0))


def test_whole_turns_are_chosen_so_that_the_line_fits(shipped: Setup, task: LineTask) -> None:
    """A joint that would leave its range by a whole turn's choice starts a turn earlier instead."""
    shift = np.array([0, 0, 0, 0, 0, 2 * np.pi - 1])
    robot = replace(shipped.robot, lower=shipped.robot.lower + shift, upper=shipped.robot.upper + shift)
    shifted, usual = plan_line(robot, task), plan_line(shipped.robot, task)
    np.testing.assert_allclose(shifted.position[:, 5] - usual.position[:, 5], 2 * np.pi, atol=1e-12)


@pytest.mark.parametrize("length", [1e-6, 1e-4, 0.004, 0.01, 0.0100001])
@pytest.mark.parametrize("rest", [0.0, 1e-4, 0.3])
def test_short_lines_and_short_rests(shipped: Setup, task: LineTask, length: float, rest: float) -> None:
    """Lines too short for the speed or even for a set-point period, and no rest at all, are followed too."""
    end = (task.start[0], task.start[1] + length, task.start[2])
    line = replace(task, end=end, rest_before=rest, rest_after=rest)
    plan = plan_line(shipped.robot, line)
    assert np.all(np.diff(plan.times) > 0)
    assert not plan.velocity[-1].any()
    tip = forward(shipped.robot.chain, _spline(plan)(np.linspace(0, plan.duration, 501))).position
    error = path_error(tip, np.array(line.start), np.array(end))
    assert error.perpendicular.max() < 1e-7
    assert -1e-7 < error.along.min() < error.along.max() < line.length + 1e-7
    np.testing.assert_allclose(forward(shipped.robot.chain, plan.position[-1]).position, end, atol=1e-12)


@pytest.mark.parametrize("acceleration", [1e9, 0.5])
def test_approach_uses_its_limits_and_no_more(
    shipped: Setup, acceleration: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planning, "APPROACH_ACCELERATION", acceleration)
    robot = shipped.robot
    start, end = np.zeros(6), np.array([0.5, -0.8, 1.2, 0.0, 0.3, -2.0])
    duration = approach_duration(robot, start, end)
    rest = np.zeros((2, 6))
    values = np.stack([[start, end], rest, rest], axis=1)
    move = BPoly.from_derivatives([0.0, duration], list(values))
    times = np.linspace(0.0, duration, 10_001)
    use = max(
        np.abs(move.derivative(1)(times) / (0.25 * robot.max_velocity)).max(),
        np.abs(move.derivative(2)(times) / acceleration).max(),
    )
    assert use == pytest.approx(1.0, rel=1e-6)


@given(st.floats(1e-4, 3.0), st.floats(1e-3, 2.0), st.floats(1e-2, 20.0), st.floats(0.0, 1.0))
def test_speed_by_distance_is_speed_by_time(length: float, speed: float, acceleration: float, share: float) -> None:
    profile = TrapezoidalProfile(length, speed, acceleration)
    motion = profile.sample(np.array([share * profile.duration]))
    # Near rest the distance carries its square root's rounding into the speed.
    tolerance = 1e-6 * profile.peak_speed
    assert profile.speed_at(motion.distance)[0] == pytest.approx(motion.speed[0], abs=tolerance)


DOWN = (0.0, np.pi, 0.0)
# The beam along y; the wrist is so far behind the spot.
SIDEWAYS, WRIST = (-np.pi / 2, 0.0, 0.0), 0.285


def _line(start: tuple[float, ...], end: tuple[float, ...], **more: Any) -> LineTask:
    values: dict[str, Any] = {"speed": 0.1, "acceleration": 1.0, "start_rpy": DOWN, "end_rpy": DOWN} | more
    return LineTask(start, end, **values)


def _refusal(shipped: Setup, line: LineTask) -> tuple[str, float]:
    with pytest.raises(LineError) as refusal:
        plan_line(shipped.robot, line)
    message = str(refusal.value)
    assert "\n" not in message
    assert "accepted: " in message
    found = re.search(r"at (\d+\.\d+) m from its start \((\d+)%\)", message)
    assert found is not None, message
    assert float(found[1]) / line.length == pytest.approx(int(found[2]) / 100, abs=0.006)
    return message, float(found[1])


@pytest.mark.parametrize(
    ("margin", "radius", "said"),
    [(1e-3, 0.9, "out of reach"), (0.3, 2 * 0.45 * np.cos(np.arcsin(0.3) / 2), "elbow singularity")],
)
def test_a_line_outwards_ends_where_pythagoras_has_it(shipped: Setup, margin: float, radius: float, said: str) -> None:
    """The wrist leaves the sphere of its reach, or that on which the elbow angle's sine falls below the margin."""
    message, distance = _refusal(shipped, _line((0.6, 0.0, 0.2), (1.6, 0.0, 0.2), singularity_margin=margin))
    # The wrist is 0.285 m above the spot, axis 2 at 0.42 m.
    assert distance == pytest.approx(np.sqrt(radius**2 - (0.485 - 0.42) ** 2) - 0.6, abs=1.1e-3)
    assert said in message


def test_wrist_singularity_in_the_middle_of_a_line(shipped: Setup) -> None:
    """Raising the forearm until it points along the tool is refused at the wrist, not at a joint speed."""
    outward = (0.0, np.pi / 2, 0.0)
    message, distance = _refusal(shipped, _line((0.9, 0.0, 0.6), (0.9, 0.0, 1.1), start_rpy=outward, end_rpy=outward))
    assert "wrist singularity" in message
    assert 0.0 < distance < 0.5


def test_shoulder_singularity_above_axis_1(shipped: Setup) -> None:
    """A wrist that would pass 20 mm from axis 1 is refused at the shoulder, 45 mm before the axis."""
    line = _line((0.3, WRIST + 0.02, 1.0), (-0.3, WRIST + 0.02, 1.0), start_rpy=SIDEWAYS, end_rpy=SIDEWAYS)
    with pytest.raises(LineError, match="shoulder singularity") as refusal:
        plan_line(_wide(shipped.robot), line)
    at = float(re.search(r"at (\d+\.\d+) m", str(refusal.value))[1])  # type: ignore[index]
    assert 0.3 - at == pytest.approx(np.sqrt(0.045**2 - 0.02**2), abs=1.1e-3)


def test_a_thin_margin_does_not_let_a_line_through_a_singularity(shipped: Setup) -> None:
    """A tool that turns through the straight wrist between two examined points is caught by the jump."""
    before, after = (forward(shipped.robot.chain, np.array([0.0, 0.4, 1.0, 0.0, q5, 0.0])) for q5 in (0.6, -0.57))
    turn = [Rotation.from_matrix(pose.rotation).as_euler("xyz") for pose in (before, after)]
    turns = {"start_rpy": tuple(turn[0]), "end_rpy": tuple(turn[1])}
    line = _line(tuple(before.position), tuple(after.position), **turns, singularity_margin=1e-3)
    message, distance = _refusal(shipped, line)
    assert re.search(r"joint_4 jumps by -?3\.14\d rad to another branch", message), message
    assert 0.0 < distance < line.length


def test_joint_limit_names_joint_and_range(shipped: Setup) -> None:
    """Behind the robot joint 1 meets its limit where the line is seen at 160 degrees from axis 1."""
    message, distance = _refusal(shipped, _line((-0.5, 0.4, 0.5), (-0.5, -0.2, 0.5)))
    said = re.search(r"joint_1 at ([\d.]+) rad; accepted: \[-2\.7925, 2\.7925\]$", message)
    assert said is not None, message
    assert 2.7925 < float(said[1]) < 2.7925 + 2.5e-3  # a millimetre at the wrist's radius of 0.5 m
    assert distance == pytest.approx(0.4 - 0.5 * np.tan(np.radians(20)), abs=1.1e-3)


def test_joint_speed_names_joint_and_a_speed_that_would_do(shipped: Setup) -> None:
    """Too fast a line names the joint; the line speed it offers is then accepted, and 1 % more is not."""
    fast = _line((0.5, -0.2, 0.3), (0.5, 0.2, 0.3), speed=5.0, acceleration=100.0)
    message, distance = _refusal(shipped, fast)
    assert re.search(r"joint_\d would turn at .* rad/s; accepted: <= ", message)
    assert 0.0 < distance <= 0.4
    slow = float(re.search(r"about ([\d.]+) m/s", message)[1])  # type: ignore[index]
    plan_line(shipped.robot, replace(fast, speed=0.99 * slow))
    with pytest.raises(LineError, match="would turn"):
        plan_line(shipped.robot, replace(fast, speed=1.01 * slow))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"end": (0.6, -0.3, 0.2)}, "two different points"),
        ({"start": (0.6, float("nan"), 0.2)}, "start is .*three finite numbers"),
        ({"end": (0.6, 9e9, 0.2)}, r"length is 9e\+09 m; accepted: up to 10 m"),
        ({"speed": 1e-9}, r"takes 4e\+08 s at speed 1e-09 m/s .*; accepted: up to 3600 s"),
    ],
)
def test_values_that_make_no_line_are_refused(task: LineTask, change: dict[str, Any], expected: str) -> None:
    with pytest.raises(LineError, match=expected):
        replace(task, **change)
