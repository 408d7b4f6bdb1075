"""How a goal is followed without ROS, and how it ends."""

from __future__ import annotations

import numpy as np
import pytest
from goal_arm import Arm, message, tolerance, two
from joint_moves import HOME, PERIOD, ZERO

from rx90_controller.trajectory.request import GoalError, ResultCode, State


def test_a_goal_that_is_followed_succeeds_at_its_last_point() -> None:
    """From waiting to running to succeeded, with code 0; then the last point is held and no goal is active."""
    arm = Arm()
    assert arm.offer("a", message(stamp=0.1)) is None
    arm.run(100)
    assert arm.active == "a"
    assert arm.feedback is None
    assert arm.run(600) == []
    event = arm.run(1)[0]
    assert event == ("a", State.SUCCEEDED, 0, "goal reached at 0.7 s, 0 s after the last point", 701)
    assert arm.active is None
    assert arm.feedback is None
    assert arm.run(500) == []
    assert np.all(arm.setpoints[-1] == [HOME + 0.2, ZERO, ZERO])


def test_feedback_says_what_is_wanted_and_what_is() -> None:
    """Desired, actual and error at the last tick, in time of the trajectory and of the clock, which scaling parts."""
    arm = Arm()
    arm.off[1], arm.off_speed[1] = 0.01, 0.1
    arm.trajectory.set_speed_scaling(0.5, 0)
    arm.offer("a", message())
    arm.run(301)
    feedback = arm.feedback
    assert feedback is not None
    assert feedback.tick == 300
    assert feedback.desired[0] == pytest.approx(HOME + 0.2 * (3 * 0.25**2 - 2 * 0.25**3))
    assert feedback.error[0] == pytest.approx(arm.off)
    assert feedback.error[1] == pytest.approx(arm.off_speed)
    assert feedback.actual[:2] == pytest.approx(feedback.desired[:2] - feedback.error[:2])
    # The measured acceleration is the difference of the velocities over a tick.
    assert feedback.actual[2] == pytest.approx(feedback.desired[2], abs=0.05)
    assert (feedback.desired_time, feedback.actual_time) == pytest.approx((0.15, 0.3))


@pytest.mark.parametrize("at", [1, 123, 300, 599])
def test_a_cancelled_goal_stops_along_the_path(at: int) -> None:
    """CANCELED at once; the arm comes to rest on the straight way between the poses, and holds."""
    arm, way = Arm(), np.array([0.2, 0.1, -0.1, 0.3, 0.2, 0.4])
    arm.offer("a", message(HOME + way))
    arm.run(at)
    event = arm.cancel()
    assert event is not None
    assert event.key == "a"
    assert event[1:3] == (State.CANCELED, ResultCode.SUCCESSFUL)
    assert event.text.startswith(f"cancelled; stopping from {at * PERIOD:g} s on, at rest at ")
    assert arm.cancel() is None
    assert arm.run(300) == []
    assert arm.stopped_smoothly()
    share = (np.array(arm.setpoints)[:, 0] - HOME) / way
    assert np.abs(share - share[:, :1]).max() < 1e-9
    assert arm.outputs.info.call_args.args[0].startswith("stopped at ")


def test_a_new_goal_pre_empts_the_one_before() -> None:
    """The one before ends with code -1; a refused one leaves it and its set-points as they are."""
    arm = Arm()
    arm.offer("a", message())
    arm.run(200)
    with pytest.raises(GoalError) as caught:
        arm.offer("b", message(HOME + 9.0))
    assert caught.value.code is ResultCode.INVALID_GOAL
    assert arm.active == "a"
    event = arm.offer("c", message(HOME - 0.1, 0.9))
    assert event is not None
    assert event == ("a", State.ABORTED, ResultCode.INVALID_GOAL, "pre-empted by a new goal, at 0.2 s", 200)
    ended = arm.run(1000)
    assert [(each.key, each.state) for each in ended] == [("c", State.SUCCEEDED)]
    assert arm.stopped_smoothly()
    assert np.all(arm.setpoints[-1][0] == HOME - 0.1)


def test_what_ends_the_following_ends_the_goal() -> None:
    """Brakes, a reset or a deactivation: code -1 with the reason; what the arm does is left to who says so."""
    arm = Arm()
    assert arm.drop("the torque is off") is None
    arm.offer("a", message())
    arm.run(100)
    event = arm.drop("the torque is off")
    assert event == ("a", State.ABORTED, ResultCode.INVALID_GOAL, "the torque is off, at 0.1 s", 100)
    arm.run(600)
    assert np.all(arm.setpoints[-1][0] == HOME + 0.2)


def test_a_goal_held_on_its_path_goes_on_and_succeeds() -> None:
    """Scaled to 0 in mid-motion no time passes on the trajectory; scaled up again it ends as it would have."""
    arm = Arm()
    arm.offer("a", message())
    arm.run(200)
    arm.trajectory.set_speed_scaling(0.0, arm.tick)
    assert arm.run(3000) == []
    held = arm.feedback
    assert held is not None
    assert held.desired_time < 0.3
    arm.trajectory.set_speed_scaling(1.0, arm.tick)
    assert [each.state for each in arm.run(800)] == [State.SUCCEEDED]
    assert arm.stopped_smoothly()


def test_a_goal_may_start_where_the_path_is_now() -> None:
    """With allow_trajectory_replacement a first point at the start may lie elsewhere; without, it may not."""
    both = two(0.0, 0.8)
    for allowed in (False, True):
        arm = Arm(allow_trajectory_replacement=allowed)
        arm.offer("a", message())
        arm.run(300)
        goal = message(points=both)
        if allowed:
            arm.offer("b", goal)
            assert [each.state for each in arm.run(900)] == [State.SUCCEEDED]
            assert arm.stopped_smoothly()
        else:
            with pytest.raises(GoalError, match=r"starts at .* accepted: within"):
                arm.offer("b", goal)


def test_the_same_calls_give_the_same_numbers() -> None:
    """Set-points, events and feedback are the same to the last bit from run to run."""
    runs = []
    for _ in range(2):
        arm = Arm()
        arm.offer("a", message(stamp=0.05, path_tolerance=[tolerance("joint_6", 0.04)]))
        arm.run(150)
        arm.trajectory.set_speed_scaling(0.37, arm.tick)
        arm.run(150)
        arm.off[5] = 0.05
        events = arm.run(300)
        runs.append((np.array(arm.setpoints), events))
    assert np.array_equal(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1]
    assert len(runs[0][1]) == 1
