"""`constraints.*` hold for trajectories on the topic as joint_trajectory_controller (Jazzy) has it: one line, and hold.

The motors of the rig stand still, so the error of a joint is its set-point: the cubic of the trajectory.
"""

from __future__ import annotations

from collections.abc import Callable
from unittest import mock

import numpy as np
import pytest
from servo_rig import Rig

from rx90_controller.trajectory.request import GoalTolerances

RATIO = 4  # ticks for each of the position loop, which come every millisecond


def ticks_to(error: float, target: float = 0.1) -> int:
    """Return the first millisecond at which a cubic to `target`, rad, in a second is further than `error`."""
    t = np.arange(1001) * 1e-3
    return int(np.argmax(target * (3 * t**2 - 2 * t**3) > error))


@pytest.fixture
def held(rig: Rig) -> Callable[..., Rig]:
    """Return what gives the rig, at rest, with these constraints."""

    def make(constraints: dict[str, float] | None = None) -> Rig:
        rig.loop.tolerances = GoalTolerances.of_parameters(rig.names, constraints)
        rig.loop.hold(rig.states(0))
        rig.around.lines.clear()
        return rig

    return make


def aborted(rig: Rig) -> list[str]:
    """Return the lines on trajectories that were given up."""
    return [line for line in rig.around.lines if line.startswith("trajectory aborted")]


def test_a_joint_off_the_path_is_told_once_and_the_arm_stops_and_holds(held: Callable[..., Rig]) -> None:
    """At the first set-point beyond: one line with joint, error, tolerance and time; rest within the accelerations."""
    rig = held({"constraints.joint_3.trajectory": 0.02, "constraints.joint_4.trajectory": 0.09})
    tick = ticks_to(0.02)
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO * tick)
    assert aborted(rig) == []
    rig.run(RATIO * tick, RATIO)
    error = 0.1 * (3 * (tick * 1e-3) ** 2 - 2 * (tick * 1e-3) ** 3)
    assert aborted(rig) == [
        f"trajectory aborted: joint_3: position error {error:.4g} rad, accepted up to 0.02 rad along the path, at "
        f"{tick * 1e-3:.6g} s, {tick * 1e-3:.6g} s on the trajectory; stopping and holding"
    ]
    motion = rig.cs7b.trajectory.setpoints(tick, 3000)
    assert (np.abs(np.diff(motion[:, 1], axis=0)) <= rig.cs7b.trajectory.limits.acceleration * 1e-3 + 1e-12).all()
    assert motion[-1, 0].max() < 0.1
    assert not motion[-1, 1:].any()
    assert all(rig.run(RATIO * (tick + 1), RATIO * 1500))
    assert len(aborted(rig)) == 1
    rig.loop.receive(rig.trajectory(0.0))
    assert "accepted" in rig.around.lines[-1]


def test_a_goal_that_is_not_reached_in_time_is_told_once(held: Callable[..., Rig]) -> None:
    """`goal` and `goal_time`: a tick beyond the time after the last point; within the tolerance nothing is said."""
    rig = held({"constraints.joint_2.goal": 0.05, "constraints.goal_time": 0.2})
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO * 1201)
    assert aborted(rig) == []
    rig.run(RATIO * 1201, RATIO * 500)
    assert aborted(rig) == [
        "trajectory aborted: joint_2: position error 0.1 rad, accepted up to 0.05 rad at the goal, 0.201 s after the "
        "last point, at 1.201 s, 1.201 s on the trajectory; stopping and holding"
    ]
    rig.loop.receive(rig.trajectory(0.04))
    rig.run(RATIO * 1701, RATIO * 2000)
    assert len(aborted(rig)) == 1


def test_by_default_nothing_is_given_up(held: Callable[..., Rig]) -> None:
    """Without constraints an arm that does not follow is the supervision's concern alone, as before."""
    rig = held()
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO * 3000)
    assert aborted(rig) == []


@pytest.mark.parametrize("stops", [False, True])
def test_what_runs_is_held_to_the_path_while_the_next_one_waits(held: Callable[..., Rig], stops: bool) -> None:
    """Also before the start of what came last, a trajectory or a stop, which is dropped then."""
    rig = held({"constraints.joint_1.trajectory": 0.02})
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO)
    stamp = (1, 500_000_000)
    rig.loop.receive(rig.empty(stamp=stamp) if stops else rig.trajectory(0.0, stamp=stamp))
    rig.run(RATIO, RATIO * 2500)
    assert len(aborted(rig)) == 1
    assert f", at {ticks_to(0.02) * 1e-3:.6g} s" in aborted(rig)[0]
    assert rig.cs7b.setpoint[0].min() > 0.015


def test_what_is_held_to_constraints(held: Callable[..., Rig]) -> None:
    """The newest trajectory to those of its time; a refused one changes nothing; a goal has its own; off: none."""
    rig = held({"constraints.joint_1.trajectory": 0.02})
    rig.loop.receive(rig.trajectory(0.1))
    rig.loop.receive(rig.trajectory(9.0))
    rig.loop.tolerances = GoalTolerances.of_parameters(rig.names, {"constraints.joint_1.trajectory": 0.05})
    rig.run(0, RATIO * 500)
    assert "accepted up to 0.02 rad" in aborted(rig)[0]
    rig.loop.hold(rig.states(0))
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO * 700)
    assert "accepted up to 0.05 rad" in aborted(rig)[1]
    rig.loop.hold(rig.states(0))
    rig.loop.receive(rig.trajectory(0.1))
    goal(rig)
    rig.run(0, RATIO * 1500)
    assert len(aborted(rig)) == 2


def test_nothing_is_told_of_a_trajectory_that_is_over(held: Callable[..., Rig]) -> None:
    """Dropped by an arm without torque, or reached: an arm that is pushed away later is not its concern."""
    rig = held({"constraints.joint_1.goal": 0.02, "constraints.goal_time": 0.2})
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO)
    rig.loop.enable(False)
    rig.loop.enable(True)
    rig.run(RATIO, RATIO)
    rig.position = np.full(6, 3.0)
    rig.run(2 * RATIO, RATIO * 401)
    assert np.abs(rig.cs7b.setpoint[0] - rig.cs7b.measured()[0]).max() > 0.02
    rig.position = np.zeros(6)
    rig.loop.receive(rig.trajectory(0.01))
    rig.run(403 * RATIO, RATIO * 1001)
    rig.position = np.full(6, 3.0)
    rig.run(1404 * RATIO, RATIO * 400)
    assert aborted(rig) == []


def test_one_that_waited_for_the_first_states_is_held_to_them_too(rig: Rig) -> None:
    """From its start on; until there are states there is nothing to compare."""
    rig.loop.tolerances = GoalTolerances.of_parameters(rig.names, {"constraints.joint_1.trajectory": 0.02})
    rig.loop.receive(rig.trajectory(0.1))
    rig.loop.hold(rig.states(0))
    rig.run(0, RATIO * 1000)
    assert len(aborted(rig)) == 1


def goal(rig: Rig) -> None:
    """Offer a goal without tolerances that moves all joints to 0.1 rad in a second."""
    rig.loop.offer(rig.goal(rig.trajectory(0.1), mock.Mock()))
