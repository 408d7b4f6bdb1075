"""The contract of FollowJointTrajectory without ROS: what is refused, and what a goal says of its tolerances."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from goal_arm import Arm, checked, message, stamp, tolerance, two
from joint_moves import HOME, NAMES, PERIOD, ZERO

from rx90_common.base.errors import ConfigError
from rx90_controller.trajectory.request import GoalError, GoalTolerances, ResultCode


def apart() -> list[SimpleNamespace]:
    """Return two points at the same time, in different places."""
    points = two(1.0, 1.0)
    points[0].positions = [0.0] * 6
    return points


REFUSED: dict[str, tuple[dict[str, Any], ResultCode, str]] = {
    "no joints": ({"joint_names": []}, ResultCode.INVALID_JOINTS, "'joint_1' is missing; accepted: all of joint_1"),
    "wrong joints": ({"joint_names": ["a", *NAMES[1:]]}, ResultCode.INVALID_JOINTS, "unknown joint 'a'; accepted:"),
    "one too many": ({"joint_names": [*NAMES, "b"]}, ResultCode.INVALID_JOINTS, "unknown joint 'b'; accepted:"),
    "repeated": ({"joint_names": [*NAMES[:5], "joint_1"]}, ResultCode.INVALID_JOINTS, "'joint_1' stands 2 times"),
    "a subset": ({"joint_names": list(NAMES[:5])}, ResultCode.INVALID_JOINTS, "'joint_6' is missing; accepted: all"),
    "no points": ({"points": []}, ResultCode.INVALID_GOAL, "no points; accepted: at least one"),
    "end velocity": ({"velocities": [0, 0.1, 0, 0, 0, 0]}, ResultCode.INVALID_GOAL, "joint_2 ends at 0.1 rad/s"),
    "equal times": ({"points": apart()}, ResultCode.INVALID_GOAL, "point 1: time_from_start 1 s after 1 s"),
    "falling times": ({"points": two(1.0, 0.5)}, ResultCode.INVALID_GOAL, "point 1: time_from_start 0.5 s after 1 s"),
    "a time before the start": ({"points": two(-1.0, 0.5)}, ResultCode.INVALID_GOAL, "time_from_start -1 s; accepted"),
    "no positions": ({"positions": []}, ResultCode.INVALID_GOAL, "no positions; accepted: positions of all"),
    "few positions": ({"positions": [0.0] * 5}, ResultCode.INVALID_GOAL, "5 positions; accepted: 6"),
    "many velocities": ({"velocities": [0.0] * 7}, ResultCode.INVALID_GOAL, "7 velocities; accepted: 6"),
    "few accelerations": ({"accelerations": [0.0]}, ResultCode.INVALID_GOAL, "1 accelerations; accepted: 6"),
    "effort": ({"effort": [1.0] * 6}, ResultCode.INVALID_GOAL, "point 0: carries effort; accepted:"),
    "not a number": ({"positions": [0.0] * 5 + [np.nan]}, ResultCode.INVALID_GOAL, "of joint_6 is nan; accepted"),
    "more than joints": (
        {"multi_dof_trajectory": SimpleNamespace(joint_names=["base"], points=[])},
        ResultCode.INVALID_GOAL,
        "multi_dof_trajectory is given; accepted: an empty one",
    ),
    "components": (
        {"component_path_tolerance": [SimpleNamespace()]},
        ResultCode.INVALID_GOAL,
        "component_path_tolerance of 1 joints; accepted: none",
    ),
    "tolerance of an unknown joint": (
        {"path_tolerance": [tolerance("elbow", 0.1)]},
        ResultCode.INVALID_JOINTS,
        "path_tolerance: joint 'elbow' is unknown; accepted: joint_1",
    ),
    "tolerance twice": (
        {"goal_tolerance": [tolerance("joint_1", 0.1)] * 2},
        ResultCode.INVALID_JOINTS,
        "goal_tolerance: joint 'joint_1' stands twice; accepted:",
    ),
    "negative tolerance": (
        {"goal_tolerance": [tolerance("joint_1", 0.1, -0.5)]},
        ResultCode.INVALID_GOAL,
        "goal_tolerance: velocity of joint_1 is -0.5 rad/s; accepted: a finite number > 0, 0 for the default, -1 for",
    ),
    "infinite tolerance": (
        {"path_tolerance": [tolerance("joint_1", 0.1, 0.0, np.inf)]},
        ResultCode.INVALID_GOAL,
        "path_tolerance: acceleration of joint_1 is inf rad/s^2; accepted: a finite",
    ),
    "negative goal time": (
        {"goal_time_tolerance": stamp(-0.5)},
        ResultCode.INVALID_GOAL,
        "goal_time_tolerance is -0.5 s; accepted: a finite number > 0",
    ),
}


@pytest.mark.parametrize(("changed", "code", "words"), REFUSED.values(), ids=REFUSED)
def test_a_bad_goal_is_refused_with_its_code(changed: dict[str, Any], code: ResultCode, words: str) -> None:
    """Each fault of a goal gives the code of the action and one line with the value and what is accepted."""
    with pytest.raises(GoalError) as caught:
        checked(message(**changed))
    assert caught.value.code is code
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_take_what_is_refused_without_them() -> None:
    """A subset of the joints and a velocity at the end are taken where they are allowed; no joints never are."""
    some = message(joint_names=["joint_4", "joint_2"], positions=[0.4, 0.2], velocities=[0.5, 0.0])
    allowed = {"allow_partial_joints_goal": True, "allow_nonzero_velocity_at_trajectory_end": True}
    points = checked(some, **allowed).points
    assert points.named.tolist() == [False, True, False, True, False, False]
    assert points.position[0, [1, 3]].tolist() == [0.2, 0.4]
    assert points.velocity[0, [1, 3]].tolist() == [0.0, 0.5]
    for missing in allowed:
        with pytest.raises(GoalError):
            checked(some, **{name: value for name, value in allowed.items() if name != missing})
    with pytest.raises(GoalError, match="no joints; accepted: joint_1"):
        checked(message(joint_names=[]), **allowed)


def test_tolerances_are_the_defaults_unless_the_goal_says_otherwise() -> None:
    """0 is the default, -1 none, another number the goal's own; the next goal begins from the defaults again."""
    own = checked(
        message(
            path_tolerance=[tolerance("joint_2", -1.0, 0.3), tolerance("joint_1", 0.02, 0.0, 5.0)],
            goal_tolerance=[tolerance("joint_3", 0.0, -1.0), tolerance("joint_6", 0.004)],
            goal_time_tolerance=stamp(-1.0),
        )
    ).tolerances
    none = np.inf
    path = [[0.02, none] + [none] * 4, [none, 0.3] + [none] * 4, [5.0] + [none] * 5]
    goal = [[none, none, 0.01, none, none, 0.004], [0.02, 0.02, none, 0.02, 0.02, 0.02], [none] * 6]
    assert own.path.tolist() == path
    assert own.goal.tolist() == goal
    assert own.goal_time == none
    after = checked(message(goal_time_tolerance=stamp(0.25))).tolerances
    assert after.path.tolist() == [[none, 0.05] + [none] * 4, [none] * 6, [none] * 6]
    assert after.goal.tolist() == [[none, none, 0.01] + [none] * 3, [0.02] * 6, [none] * 6]
    assert after.goal_time == 0.25
    assert checked(message()).tolerances.goal_time == 0.5


def test_defaults_are_those_of_the_original() -> None:
    """Without parameters there is no tolerance but 0.01 rad/s at the goal, and a goal may take for ever."""
    plain = GoalTolerances.of_parameters(NAMES)
    assert np.all(plain.path == np.inf)
    assert np.all(plain.goal[[0, 2]] == np.inf)
    assert np.all(plain.goal[1] == 0.01)
    assert plain.goal_time == np.inf
    for bad in ({"constraints.goal_time": -1.0}, {"constraints.joint_1.trajectory": np.nan}):
        with pytest.raises(ConfigError, match=r"^constraints.* accepted: "):
            GoalTolerances.of_parameters(NAMES, bad)


@pytest.mark.parametrize(
    ("goal", "inactive", "code", "words"),
    [
        ({}, True, ResultCode.INVALID_GOAL, "is disabled; accepted"),
        (
            {"stamp": 0.2},
            False,
            ResultCode.OLD_HEADER_TIMESTAMP,
            "the last point is at 0.8 s, the controller's",
        ),
        (
            {"stamp": 11.5},
            False,
            ResultCode.INVALID_GOAL,
            "start time 11.500 s, the controller's time is 1.000 s; accepted",
        ),
        ({"seconds": 0.01}, False, ResultCode.INVALID_GOAL, "point 0: joint_1 gets a set-point velocity"),
        ({"to": HOME + 2.0 * np.eye(6)[4]}, False, ResultCode.INVALID_GOAL, "joint_5 has the position 2.5 rad"),
    ],
)
def test_what_cannot_be_followed_now_is_refused(
    goal: dict[str, Any], inactive: bool, code: ResultCode, words: str
) -> None:
    """Not active, all in the past, too far ahead, beyond a limit: refused with its code, and nothing moves."""
    arm = Arm()
    arm.run(1000)
    arm.loop.enabled = not inactive
    with pytest.raises(GoalError) as caught:
        arm.offer("a", message(**goal))
    assert caught.value.code is code
    assert words in str(caught.value)
    assert arm.active is None
    arm.loop.enabled = True
    arm.run(100)
    assert np.all(np.array(arm.setpoints) == [HOME, ZERO, ZERO])


@pytest.mark.parametrize("begins", [0.0, 0.2])
@pytest.mark.parametrize("speed", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("velocities", [[], [0.0] * 6])
def test_a_point_at_the_start_where_the_arm_is_succeeds_at_once(
    begins: float, speed: float, velocities: list[float]
) -> None:
    """What planners return for "already there", one point at time 0, is reached in its first tick; nothing moves."""
    for options in ({}, {"allow_trajectory_replacement": True}):
        arm = Arm(**options)
        arm.trajectory.set_speed_scaling(speed, 0)
        there = message(to=HOME + 1e-6, seconds=0.0, stamp=begins, velocities=velocities)
        assert arm.offer("there", there) is None
        events = arm.run(300)
        assert [(event.key, event.state.name) for event in events] == [("there", "SUCCEEDED")]
        assert events[0].tick == round(begins / PERIOD) + 1
        moved = np.array(arm.setpoints)
        assert np.abs(moved[:, 0] - HOME).max() < 1.1e-6
        assert not moved[:, 1:].any()


def test_a_point_at_the_start_elsewhere_or_over_is_refused() -> None:
    """A motion cannot take no time: elsewhere, while the arm moves, and once its start is over, it is refused."""
    arm = Arm()
    elsewhere = message(to=HOME + 0.2, seconds=0.0)
    with pytest.raises(
        GoalError, match=r"joint_1 starts at 0\.3 rad, the set-point there is 0\.1 rad; accepted: within"
    ):
        arm.offer("elsewhere", elsewhere)
    arm.offer("moves", message())
    arm.run(300)
    with pytest.raises(GoalError, match=r"starts at 0 rad/s, the set-point there moves at"):
        arm.offer("stop", message(to=arm.trajectory.setpoints(arm.tick)[0, 0], seconds=0.0))
    with pytest.raises(GoalError, match=r"the last point is at 0\.1 s") as caught:
        arm.offer("over", message(seconds=0.0, stamp=0.1))
    assert caught.value.code is ResultCode.OLD_HEADER_TIMESTAMP
    assert [event.state.name for event in arm.run(600)] == ["SUCCEEDED"]
