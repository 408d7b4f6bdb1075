"""The tolerances of a goal without ROS: along its path, at its end, and in its time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from goal_arm import Arm, message, stamp, tolerance
from joint_moves import HOME, NAMES, PERIOD

from rx90_controller.trajectory.request import GoalOptions, GoalTolerances, ResultCode, State, check_request


@pytest.mark.parametrize(
    ("goal", "row", "amount", "said"),
    [
        ({"path_tolerance": [tolerance("joint_4", 0.02)]}, 0, 0.03, "position error 0.03 rad, accepted up to 0.02 rad"),
        (
            {"path_tolerance": [tolerance("joint_4", 0.0, 0.3)]},
            1,
            -0.4,
            "velocity error -0.4 rad/s, accepted up to 0.3 rad/s",
        ),
    ],
)
@pytest.mark.parametrize("at", [0, 250])
def test_a_path_tolerance_holds_from_the_first_sample_on(
    goal: dict[str, Any], row: int, amount: float, said: str, at: int
) -> None:
    """Beyond it in any sample: code -4 with joint, amount, limit and time, and a stop along the path."""
    arm = Arm()
    arm.offer("a", message(**goal))
    assert arm.run(at) == []
    (arm.off, arm.off_speed)[row][3] = amount
    event = arm.run(1)[0]
    assert event[1:3] == (State.ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED)
    time = f"{at * PERIOD:g} s"
    assert event.text == f"joint_4: {said} along the path, at {time}, {time} on the trajectory"
    assert arm.run(300) == []
    assert arm.stopped_smoothly()
    assert np.abs(arm.setpoints[-1][0] - HOME).max() < 0.15


def test_an_acceleration_beyond_its_tolerance_is_found() -> None:
    """A jump of the measured velocity over a tick is an acceleration."""
    arm = Arm()
    arm.offer("a", message(path_tolerance=[tolerance("joint_1", 0.0, 0.0, 8.0)]))
    assert arm.run(100) == []
    arm.off_speed[0] = 0.02
    event = arm.run(1)[0]
    assert event.code is ResultCode.PATH_TOLERANCE_VIOLATED
    assert event.text.startswith("joint_1: acceleration error 19.99 rad/s^2, accepted up to 8 rad/s^2 along")


def test_what_is_furthest_beyond_its_tolerance_is_named() -> None:
    """Of several violations the largest in terms of its limit is told; a value that is none counts as the largest."""
    for wrong, joint in ((0.5, "joint_2"), (np.nan, "joint_5")):
        arm = Arm()
        arm.offer("a", message(path_tolerance=[tolerance("joint_5", 0.4), tolerance("joint_2", 0.1)]))
        arm.off[1], arm.off[4] = 0.5, wrong
        assert arm.run(1)[0].text.startswith(f"{joint}: position error")


def test_a_goal_is_reached_once_its_tolerances_hold() -> None:
    """Past the last point it settles, and succeeds within goal_time; path tolerances no longer count."""
    arm = Arm()
    arm.offer("a", message(goal_time_tolerance=stamp(0.2)))
    arm.run(600)
    arm.off[2], arm.off[1] = 0.011, 0.06
    assert arm.run(150) == []
    assert arm.active == "a"
    arm.off[2] = 0.009
    assert arm.run(1)[0].text == "goal reached at 0.75 s, 0.15 s after the last point"


def test_a_goal_that_is_not_reached_in_time_is_aborted() -> None:
    """After goal_time: code -5 with joint, amount, limit and time; exactly goal_time is still in time."""
    arm = Arm()
    arm.offer("a", message(goal_time_tolerance=stamp(0.2)))
    arm.off[2] = 0.011
    assert arm.run(801) == []
    event = arm.run(1)[0]
    assert event[1:3] == (State.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED)
    assert event.text == (
        "joint_3: position error 0.011 rad, accepted up to 0.01 rad at the goal, 0.201 s after the last point, "
        "at 0.801 s, 0.801 s on the trajectory"
    )
    arm.run(100)
    assert arm.stopped_smoothly()
    assert np.all(arm.setpoints[-1][0] == HOME + 0.2)


def test_without_goal_time_a_goal_settles_for_ever() -> None:
    """With goal_time 0 in defaults and goal, the stopped-velocity tolerance alone decides, however long it takes."""
    arm = Arm()
    goal = message()
    tolerances = GoalTolerances.of_parameters(NAMES)
    arm.offer("a", check_request(goal.trajectory, tolerances, GoalOptions(), 1000, goal))
    arm.off_speed[0] = 0.011
    assert arm.run(5000) == []
    arm.off_speed[0] = 0.009
    assert arm.run(1)[0].state is State.SUCCEEDED


def test_tolerances_of_a_goal_end_with_it() -> None:
    """A goal without tolerances of its own has the defaults, whatever the one before had."""
    arm = Arm()
    arm.offer("a", message(path_tolerance=[tolerance("joint_2", -1.0)]))
    arm.off[1] = 0.06
    assert arm.run(300) == []
    arm.offer("b", message())
    event = arm.run(1)[0]
    assert event.key == "b"
    assert event.code is ResultCode.PATH_TOLERANCE_VIOLATED
