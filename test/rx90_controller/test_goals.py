"""Goals of FollowJointTrajectory without ROS: what is refused, how one is followed, its tolerances, and how it ends."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from goal_arm import Arm, GoalError, checked, message, tolerance
from joint_moves import HOME, PERIOD, ZERO, stamp

from rx90_common.base.errors import TrajectoryError
from rx90_controller.servo.states import Off, Switch
from rx90_controller.trajectory.request import ResultCode, State

REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "no joints": ({"joint_names": []}, "'joint_1' is missing; accepted: all of joint_1"),
    "effort": ({"effort": [1.0] * 6}, "point 0: carries effort; accepted:"),
    "more than joints": (
        {"multi_dof_trajectory": SimpleNamespace(joint_names=["base"], points=[])},
        "multi_dof_trajectory is given; accepted: an empty one",
    ),
    "components": (
        {"component_path_tolerance": [SimpleNamespace()]},
        "component_path_tolerance of 1 joint; accepted: none",
    ),
}


@pytest.mark.parametrize(("changed", "words"), REFUSED.values(), ids=REFUSED)
def test_a_bad_goal_is_refused(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        checked(message(**changed))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


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
    assert own.path.tolist() == [0.02] + [none] * 5
    assert own.goal.tolist() == [none, none, 0.01, none, none, 0.004]
    assert own.goal_time == none
    after = checked(message(goal_time_tolerance=stamp(0.25))).tolerances
    assert after.path.tolist() == [none, 0.05] + [none] * 4
    assert after.goal.tolist() == [none, none, 0.01] + [none] * 3
    assert after.goal_time == 0.25
    assert checked(message()).tolerances.goal_time == 0.5


@pytest.mark.parametrize(
    ("goal", "inactive", "code", "words"),
    [
        ({}, True, ResultCode.INVALID_GOAL, "is disabled; accepted"),
        ({"stamp": 0.2}, False, ResultCode.OLD_HEADER_TIMESTAMP, "the last point is at 0.8 s, the controller's"),
        ({"stamp": 11.5}, False, ResultCode.INVALID_GOAL, "start time 11.500 s, the controller's time is 1.000 s; acc"),
        ({"seconds": 0.01}, False, ResultCode.INVALID_GOAL, "point 0: joint_1 cannot go"),
        ({"to": HOME + 2.0 * np.eye(6)[4]}, False, ResultCode.INVALID_GOAL, "joint_5 has the position 2.5 rad"),
    ],
)
def test_what_cannot_be_followed_is_refused(goal: dict[str, Any], inactive: bool, code: ResultCode, words: str) -> None:
    """Not active, all in the past, too far ahead, beyond a limit: refused with its code, and nothing moves."""
    arm = Arm()
    arm.run(1000)
    if inactive:
        arm.loop.state = Off(Switch(on=False))
    with pytest.raises(GoalError) as caught:
        arm.offer("a", message(**goal))
    assert caught.value.code is code
    assert words in str(caught.value)
    assert arm.active is None
    arm.loop.enable(True)
    arm.run(100)
    assert np.all(np.array(arm.setpoints) == [HOME, ZERO, ZERO])


@pytest.mark.parametrize("begins", [0.0, 0.2])
@pytest.mark.parametrize("speed", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("velocities", [[], [0.0] * 6])
def test_a_point_where_the_arm_is_succeeds_at_once(begins: float, speed: float, velocities: list[float]) -> None:
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


DEFAULTED: dict[str, tuple[dict[str, Any], str]] = {
    "an unknown joint": (
        {"path_tolerance": [tolerance("joint_1", 0.1), tolerance("elbow", 0.1)]},
        "path_tolerance: joint 'elbow' is unknown; accepted: joint_1",
    ),
    "a negative tolerance": (
        {"goal_tolerance": [tolerance("joint_1", 0.1, -0.5)]},
        "goal_tolerance: velocity of joint_1 is -0.5 rad/s; accepted: a number > 0, 0 for the default, -1 for none",
    ),
    "a negative goal time": (
        {"goal_time_tolerance": stamp(-0.5), "path_tolerance": [tolerance("joint_1", 0.1)]},
        "goal_time_tolerance is -0.5 s; accepted: a number > 0",
    ),
}


@pytest.mark.parametrize(("changed", "words"), DEFAULTED.values(), ids=DEFAULTED)
def test_a_goal_with_a_wrong_tolerance_has_the_default_ones(changed: dict[str, Any], words: str) -> None:
    """As in joint_trajectory_controller all of them, and a line in the log says so; the goal is followed."""
    request = checked(message(**changed))
    plain = checked(message()).tolerances
    assert request.tolerances.path.tolist() == plain.path.tolist()
    assert request.tolerances.goal.tolist() == plain.goal.tolist()
    assert request.tolerances.goal_time == plain.goal_time
    assert words in request.remark
    assert request.remark.endswith("; the default tolerances hold")
    arm = Arm()
    goal = message(**changed)
    assert arm.loop.receive(goal.trajectory, goal) is not None
    arm.run(1)
    assert words in arm.outputs.error.call_args.args[0]


def test_tolerances_are_read_as_joint_trajectory_controller_reads_them() -> None:
    """Of two for a joint the last counts; infinite is none, what is no number the default, as 0 is."""
    twice = [tolerance("joint_2", 0.3), tolerance("joint_2", 0.2, np.inf), tolerance("joint_3", np.nan)]
    read = checked(message(path_tolerance=twice, goal_tolerance=[tolerance("joint_3", np.nan)]))
    assert read.remark == ""
    assert read.tolerances.path[1:3].tolist() == [0.2, np.inf]
    assert read.tolerances.goal[2] == 0.01


@pytest.mark.parametrize("at", [0, 250])
def test_a_path_tolerance_holds_from_the_first_sample_on(at: int) -> None:
    """Beyond it in any sample: code -4 with joint, amount, limit and time, and a stop along the path."""
    arm = Arm()
    arm.offer("a", message(path_tolerance=[tolerance("joint_4", 0.02)]))
    assert arm.run(at) == []
    arm.off[3] = 0.03
    event = arm.run(1)[0]
    assert event[1:3] == (State.ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED)
    time = f"{at * PERIOD:g} s"
    said = "position error 0.03 rad, accepted up to 0.02 rad"
    assert event.text == f"joint_4: {said} along the path, at {time}, {time} on the trajectory"
    assert arm.run(300) == []
    assert arm.stopped_smoothly()
    assert np.abs(arm.setpoints[-1][0] - HOME).max() < 0.15


def test_the_first_sample_is_held_to_the_path() -> None:
    """Also where it is the last point."""
    arm = Arm()
    arm.off[0] = 0.02
    arm.offer("there", message(to=HOME, seconds=0.0, path_tolerance=[tolerance("joint_1", 0.01)]))
    assert arm.run(1)[0].code is ResultCode.PATH_TOLERANCE_VIOLATED


def test_tolerances_of_velocity_and_acceleration_end_nothing() -> None:
    """As in joint_trajectory_controller with commands of position, along the path as at the goal."""
    arm = Arm()
    narrow = [tolerance("joint_1", 0.0, 0.01, 0.01)]
    arm.offer("a", message(path_tolerance=narrow, goal_tolerance=narrow, goal_time_tolerance=stamp(0.1)))
    arm.off_speed[0] = 0.5
    (event,) = arm.run(700)
    assert event[1:3] == (State.SUCCEEDED, ResultCode.SUCCESSFUL)


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
