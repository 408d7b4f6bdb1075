"""When a trajectory that was sent has ended: a closed one, slowed down, late, replaced, refused, held off its end."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rx90_common.exchange.endpoints import ros_time
from rx90_controller.node.sent_trajectory import SentTrajectory
from rx90_controller.trajectory import TrajectoryPoints

pytestmark = pytest.mark.ros

TIMES = np.array([0.0, 1.0, 3.0, 5.0])  # s: a rest, there and back
PLACES = np.array([0.0, 0.0, 0.4, 0.0])
ENDED = "trajectory ended at 25.000 s; holding"


def message(places: Sequence[float]) -> JointTrajectory:
    return JointTrajectory(joint_names=["a"], points=[JointTrajectoryPoint(positions=[place]) for place in places])


def sent() -> SentTrajectory:
    points = TrajectoryPoints(TIMES, PLACES[:, None], None, None)
    return SentTrajectory(message(PLACES.tolist()), points, 1e-3)


def accepted(begin: float, places: Sequence[float] = tuple(PLACES)) -> JointTrajectory:
    trajectory = message(places)
    trajectory.header.stamp = ros_time(round(begin * 1e9))
    return trajectory


def taken() -> SentTrajectory:
    trajectory = sent()
    trajectory.take_acceptance(accepted(20.0))
    return trajectory


def follow(trajectory: SentTrajectory, until: float, scale: float = 1.0, *, off: float = 0.0) -> float:
    """Show an arm that follows at a share of the speed, by a wall clock as fast; return when it ended or failed, s."""
    now = 20.0
    while now < until and trajectory.end == np.inf and not trajectory.fault:
        place: NDArray[np.float64] = np.interp([(now - 20.0) * scale], TIMES, PLACES) + off
        trajectory.see(now, place, now)
        now += 0.02
    return now


@pytest.mark.parametrize("scale", [1.0, 0.5, 0.08])
def test_a_closed_path_ends_when_the_arm_is_back(scale: float) -> None:
    """Not in its first rest, which is at its end, too, however long speed scaling stretches it."""
    trajectory = taken()
    now = follow(trajectory, 100.0, scale)
    assert trajectory.fault == ""
    assert now - 20.0 == pytest.approx(5.0 / scale, abs=0.2)
    assert trajectory.end == pytest.approx(20.0 + 5.0 / scale, abs=0.1)


def test_a_trajectory_that_comes_late_ends_later() -> None:
    """Time counts from where the controller lets it begin; without a word of it from where the arm was seen first."""
    late = sent()
    late.see(13.0, PLACES[:1], 13.0)
    late.take_acceptance(accepted(20.0))
    assert follow(late, 40.0) == pytest.approx(25.1, abs=0.05)
    unknown = sent()
    assert follow(unknown, 40.0) == pytest.approx(25.1, abs=0.05)
    assert late.end == unknown.end == 25.0


def test_what_happens_to_others_is_nothing() -> None:
    """Refusals of others, and trajectories of others before this one was accepted, do not end it."""
    trajectory = sent()
    trajectory.take_line("trajectory rejected: joint_8 is not there")
    trajectory.take_acceptance(accepted(7.0, [0.3]))
    trajectory.take_acceptance(accepted(20.0))
    trajectory.take_line("trajectory rejected: joint_9 is not there")
    follow(trajectory, 40.0)
    assert (trajectory.end, trajectory.fault) == (25.0, "")


@pytest.mark.parametrize(
    ("line", "begun"),
    [
        ("trajectory rejected: the controller is disabled", False),
        ("joint_5: following error 0.2 rad; torque off, brakes closed, trajectory dropped, until ~/enable ...", True),
        ("trajectory aborted: too far; stopping and holding", True),
        ("the trajectory that waited is dropped: disabled", False),
        ("stopped at 22.000 s; holding", True),
        ("stream begins at 22.000 s", True),
    ],
)
def test_the_controller_says_why_it_does_not_end(line: str, begun: bool) -> None:
    trajectory = taken() if begun else sent()
    trajectory.take_line(line)
    assert trajectory.fault == line


@pytest.mark.parametrize(("places", "word"), [((0.0, 1.0), "another trajectory"), ((), "a stop")])
def test_what_replaces_it_ends_it(places: Sequence[float], word: str) -> None:
    """Also where it would come to the same place."""
    trajectory = taken()
    trajectory.take_acceptance(accepted(22.0, places))
    assert trajectory.fault == f"{word} has replaced the one that was sent"


@pytest.mark.parametrize(("is_accepted", "line", "patience"), [(False, "", 5.0), (True, "", 60.0), (True, ENDED, 5.0)])
def test_an_arm_that_rests_elsewhere_is_not_waited_for_endlessly(is_accepted: bool, line: str, patience: float) -> None:
    """It says how far off; one that a controller may still move is waited for longer."""
    trajectory = taken() if is_accepted else sent()
    trajectory.take_line(line)
    now = follow(trajectory, 200.0, off=0.0019)
    assert now - 25.0 == pytest.approx(patience, abs=0.3)
    assert "the arm rests 0.0019 rad from the trajectory's end (accepted: 0.001)" in trajectory.fault


def test_an_arm_that_does_not_move_has_not_arrived() -> None:
    """A refused closed path whose refusal nobody hears: the arm is at its end all the time."""
    trajectory = sent()
    assert follow(trajectory, 100.0, scale=0.0) == pytest.approx(30.0, abs=0.3)
    assert "and has not been farther" in trajectory.fault


def test_a_motion_that_nobody_saw_has_ended_where_the_controller_says_so() -> None:
    """Without a pace a short closed path is over between two samples."""
    trajectory = taken()
    trajectory.see(19.0, PLACES[:1], 0.0)
    trajectory.take_line(ENDED)
    trajectory.see(26.0, PLACES[:1], 0.1)
    assert (trajectory.end, trajectory.fault) == (25.0, "")
