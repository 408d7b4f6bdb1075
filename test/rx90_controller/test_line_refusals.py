"""Lines that cannot be travelled are refused in one line that says where and why."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rx90_common.base.errors import ConfigError, LineError, Rx90Error
from rx90_common.base.share import config_path
from rx90_common.description.kinematics import forward
from rx90_controller.lines.plan import Approach, plan_line
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.setup import Setup

REFERENCE = "robots/rx90b/task.yaml"
DOWN = (0.0, np.pi, 0.0)
# The beam along y; the wrist is so far behind the spot.
SIDEWAYS, WRIST = (-np.pi / 2, 0.0, 0.0), 0.285


def _line(start: tuple[float, ...], end: tuple[float, ...], **more: Any) -> LineTask:
    values: dict[str, Any] = {"speed": 0.1, "acceleration": 1.0, "start_rpy": DOWN, "end_rpy": DOWN} | more
    return LineTask(start, end, **values)


def _refusal(shipped: Setup, line: LineTask) -> tuple[str, float]:
    """Return the message and the distance it names."""
    with pytest.raises(LineError) as refusal:
        plan_line(shipped.robot, line)
    message = str(refusal.value)
    assert "\n" not in message
    assert "accepted: " in message
    found = re.search(r"at (\d+\.\d+) m from its start \((\d+)%\)", message)
    assert found is not None, message
    assert float(found[1]) / line.length == pytest.approx(int(found[2]) / 100, abs=0.006)
    return message, float(found[1])


def test_out_of_reach_names_where_the_arm_ends(shipped: Setup) -> None:
    """Straight outwards with the tool down, the wrist leaves its sphere of 0.9 m where Pythagoras has it."""
    message, distance = _refusal(shipped, _line((0.6, 0.0, 0.2), (1.6, 0.0, 0.2), singularity_margin=1e-3))
    # The wrist is 0.285 m above the spot, axis 2 at 0.42 m.
    assert distance == pytest.approx(np.sqrt(0.9**2 - (0.485 - 0.42) ** 2) - 0.6, abs=1.1e-3)
    assert "out of reach" in message


def test_out_of_reach_from_the_first_point(shipped: Setup) -> None:
    """A line that starts beyond the arm's reach is refused at 0 m."""
    message, distance = _refusal(shipped, _line((1.5, 0.0, 0.2), (0.7, 0.0, 0.2)))
    assert distance == 0.0
    assert "out of reach" in message


def test_elbow_singularity_is_met_before_the_end_of_reach(shipped: Setup) -> None:
    """With a margin of 0.3 the same outward line is refused where the elbow angle's sine falls below 0.3."""
    message, distance = _refusal(shipped, _line((0.6, 0.0, 0.2), (1.6, 0.0, 0.2), singularity_margin=0.3))
    stretched = 2 * 0.45 * np.cos(np.arcsin(0.3) / 2)
    assert distance == pytest.approx(np.sqrt(stretched**2 - 0.065**2) - 0.6, abs=1.1e-3)
    assert "elbow singularity" in message


def test_wrist_singularity_in_the_middle_of_a_line(shipped: Setup) -> None:
    """Raising the forearm until it points along the tool is refused at the wrist, not at a joint speed."""
    outward = (0.0, np.pi / 2, 0.0)
    message, distance = _refusal(shipped, _line((0.9, 0.0, 0.6), (0.9, 0.0, 1.1), start_rpy=outward, end_rpy=outward))
    assert "wrist singularity" in message
    assert 0.0 < distance < 0.5


def test_shoulder_singularity_above_axis_1(shipped: Setup) -> None:
    """A wrist that would pass 20 mm from axis 1 is refused at the shoulder, 45 mm before the axis."""
    line = _line((0.3, WRIST + 0.02, 1.0), (-0.3, WRIST + 0.02, 1.0), start_rpy=SIDEWAYS, end_rpy=SIDEWAYS)
    robot = replace(shipped.robot, lower=np.full(6, -7.0), upper=np.full(6, 7.0))
    with pytest.raises(LineError, match="shoulder singularity") as refusal:
        plan_line(robot, line)
    at = float(re.search(r"at (\d+\.\d+) m", str(refusal.value))[1])  # type: ignore[index]
    assert 0.3 - at == pytest.approx(np.sqrt(0.045**2 - 0.02**2), abs=1.1e-3)


def test_a_thin_margin_does_not_let_a_line_through_a_singularity(shipped: Setup) -> None:
    """A tool that turns through the straight wrist between two examined points is caught by the jump."""
    before, after = (forward(shipped.robot.chain, np.array([0.0, 0.4, 1.0, 0.0, q5, 0.0])) for q5 in (0.6, -0.57))
    turn = [Rotation.from_matrix(pose.rotation).as_euler("xyz") for pose in (before, after)]
    line = _line(
        tuple(before.position),
        tuple(after.position),
        start_rpy=tuple(turn[0]),
        end_rpy=tuple(turn[1]),
        singularity_margin=1e-3,
    )
    message, distance = _refusal(shipped, line)
    assert re.search(r"joint_4 jumps by -?3\.14\d rad to another branch", message), message
    assert 0.0 < distance < line.length


def test_joint_limit_names_joint_and_range(shipped: Setup) -> None:
    """Behind the robot joint 1 meets its limit where the line is seen at 160 degrees from axis 1."""
    message, distance = _refusal(shipped, _line((-0.5, 0.4, 0.5), (-0.5, -0.2, 0.5)))
    assert "joint_1 at 2.79" in message
    assert "[-2.7925, 2.7925]" in message
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
        ({"speed": 0.0}, "speed is 0 m/s"),
        ({"speed": -0.1}, "speed is -0.1 m/s"),
        ({"acceleration": 0.0}, "acceleration is 0 m/s"),
        ({"start": (0.6, float("nan"), 0.2)}, "start is .*three finite numbers"),
        ({"rest_before": -1.0}, "rest_before is -1 s"),
        ({"singularity_margin": 0.0}, "singularity_margin is 0"),
        ({"end": (0.6, 9e9, 0.2)}, r"length is 9e\+09 m; accepted: up to 10 m"),
        ({"speed": 1e-9}, r"takes 4e\+08 s at speed 1e-09 m/s .*; accepted: up to 3600 s"),
        ({"acceleration": 5e-324}, "takes inf s"),
    ],
)
def test_values_that_make_no_line_are_refused(change: dict[str, Any], expected: str) -> None:
    """A task that is not a line is refused when it is made, by the name and value of what is wrong."""
    with pytest.raises(LineError, match=expected):
        replace(load_task(config_path(REFERENCE)), **change)


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        (("line", "speed"), 0, r"line\.speed is 0; accepted: a number > 0"),
        (("line", "speed"), "fast", r"line\.speed is 'fast'"),
        (("line", "start"), [0.6, 0.0], r"line\.start is .*3 numbers"),
        (("line", "velocity"), 1.0, r"line\.velocity is not a known key"),
        (("posture", "wrist"), "up", r"posture\.wrist is 'up'; accepted: one of positive, negative"),
        (("lines",), {}, "lines is not a known key"),
    ],
)
def test_a_bad_task_file_is_refused_naming_file_and_key(
    edited_yaml: Callable[..., Path], path: tuple[str, ...], value: object, expected: str
) -> None:
    """One fault in the task file gives one line with the file, the key and the value."""
    file = edited_yaml(config_path(REFERENCE), path, value)
    with pytest.raises(Rx90Error, match=expected) as refusal:
        load_task(file)
    assert isinstance(refusal.value, LineError | ConfigError)
    assert str(refusal.value).startswith(str(file))


@pytest.mark.parametrize(("speed", "acceleration"), [(0.0, 1.0), (1.1, 1.0), (0.5, 0.0), (0.5, float("nan"))])
def test_approach_limits_are_checked(speed: float, acceleration: float) -> None:
    """A share outside (0, 1] or a useless acceleration is refused."""
    with pytest.raises(LineError, match="accepted:"):
        Approach(speed, acceleration)
