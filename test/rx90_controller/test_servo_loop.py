"""The controller in operation, without ROS; where motors stand still, the error is the set-point, a cubic."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from joint_moves import trajectory
from servo_rig import Rig
from unchecked import unchecked

from rx90_controller.trajectory.request import Constraints, Feedback, GoalTolerances, JoinedAhead, TrajectoryRequest
from rx90_emulator.loop.setup import Setup

RATIO = 4  # ticks for each of the position loop, which come every millisecond


def test_a_trajectory_waits_for_the_first_states(rig: Rig) -> None:
    """The newest one is followed from their tick on; the executor tells of it: a terminal may hold up ticks."""
    rig.loop.receive(rig.trajectory(0.2))
    rig.loop.receive(rig.trajectory(0.1))
    waits = "a trajectory waits for the simulation's first tick"
    assert rig.around.lines == [waits, f"{waits}, in place of the one that waited"]
    rig.loop.begin()
    rig.around.report = lambda: None
    rig.loop.hold(rig.states(400))
    assert rig.around.lines[2:] == ["subscribers"]
    rig.loop.report()
    assert rig.around.lines[3:] == ["ready", "trajectory accepted: 1 point, 1.000 s from 0.100 s"]
    rig.run(400, 4004)
    assert rig.cs7b.reference()[0] == pytest.approx([0.1] * 6)
    rig.loop.hold(rig.states(0))
    rig.loop.report()
    assert rig.around.lines.count("ready") == 1
    assert not any("dropped" in line for line in rig.around.lines)


def test_set_points_are_published_in_ticks_of_the_position_loop(rig: Rig) -> None:
    """Of eight ticks two run the position loop, and each of these is published with its own stamp."""
    rig.loop.hold(rig.states(8))
    assert rig.run(8, 8) == [True] * 8
    assert rig.around.published == [8 * rig.period, 12 * rig.period]
    rig.loop.step(16 * rig.period, rig.states(16))
    assert len(rig.around.published) == 2  # the simulation waits for the command: it comes first
    rig.loop.after_command(16 * rig.period)
    rig.loop.after_command(16 * rig.period)
    assert rig.around.published[2:] == [16 * rig.period]


def test_a_goal_joined_while_torque_goes_off_and_on_moves_the_arm(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tick that follows releases the arm: the goal begins after it, and succeeds at its last point."""
    rig.loop.hold(rig.states(0))
    rig.run(0, 8)
    compute = JoinedAhead.compute

    def meanwhile(joined: JoinedAhead) -> None:
        compute(joined)
        rig.loop.enable(False)
        rig.loop.enable(True)

    monkeypatch.setattr(JoinedAhead, "compute", meanwhile)
    sender, times = Sender(), np.arange(1, 41) * 0.025
    points = [[0.1 * (3 * t**2 - 2 * t**3)] * 6 for t in times]
    rig.loop.offer(rig.goal(trajectory(times, points), sender))
    rig.run(8, 4)
    assert rig.cs7b.trajectory.moving(rig.cs7b.position_tick)
    assert sender.ends == []


def test_a_joint_beyond_a_limit_switches_off_until_enabled(rig: Rig) -> None:
    """The supervision takes the torque away for good, drops the motion and says why, once; `enable` brings it back."""
    rig.loop.hold(rig.states(0))
    rig.loop.receive(rig.trajectory(0.5))
    assert rig.run(0, 2) == [True] * 2
    rig.position = np.array([0.0, 0.301 * 85.0, 0.0, 0.0, 0.0, 0.0])  # the gear of joint 2 is 85
    assert rig.run(2, 400) == [True] * 2 + [False] * 398
    line = rig.around.lines[-1]
    assert line.startswith("joint_2: following error -0.301 rad at 0.001 s; accepted: up to 0.3 rad; torque off")
    assert sum("following error" in each for each in rig.around.lines) == 1
    assert rig.around.published[-1] == 4 * rig.period  # what has led to it can be seen
    assert rig.loop.state.switch.fault is not None
    rig.loop.receive(rig.trajectory(0.2))
    assert rig.loop.servo.rejected == 1
    rig.position = 2.0 * rig.position  # the set-points follow the arm
    assert rig.run(402, 1) == [False]
    rig.loop.enable(True)
    assert rig.run(403, 8) == [True] * 8
    assert rig.loop.state.switch.fault is None
    assert rig.cs7b.reference()[0][1] == pytest.approx(0.602)
    assert not rig.cs7b.trajectory.moving(rig.cs7b.position_tick)


@pytest.mark.parametrize("named", [False, True])
def test_an_empty_trajectory_stops_within_the_accelerations_and_holds(rig: Rig, named: bool) -> None:
    """Position and velocity of the set-points go on without a jump, then the place is held; two lines tell it."""
    rig.loop.hold(rig.states(0))
    rig.around.lines.clear()
    rig.loop.receive(rig.trajectory(0.2))
    rig.run(0, 1600)
    rig.loop.receive(trajectory([], [], start=0.42, names=rig.names[::-1] if named else ()))
    generator, most = rig.cs7b.trajectory, rig.cs7b.trajectory.limits.acceleration
    got = generator.setpoints(400, 800)
    assert (np.abs(np.diff(got[:, 1], axis=0)) <= most * 1e-3 + 1e-12).all()
    assert got[20, 1] == pytest.approx([6 * 0.2 * 0.42 * 0.58] * 6)  # the cubic it was on
    rest = got[20, 0] + got[20, 1] ** 2 / (2 * most)
    assert got[-1, 0] == pytest.approx(rest)
    end = 0.42 + np.ceil(1e3 * (got[20, 1] / most).max()) / 1e3
    assert rig.around.lines[1:] == [f"empty trajectory: stopping from 0.420 s on, at rest at {end:.3f} s"]
    assert rig.around.taken[1:] == [(0, 420_000_000, "")]
    rig.run(1600, 4000)
    assert rig.around.lines[2:] == [f"stopped at {end:.3f} s; holding"]


class Sender:
    def __init__(self) -> None:
        self.feedback: list[Feedback] = []
        self.ends: list[TrajectoryRequest] = []
        self.on_feedback, self.on_result = self.feedback.append, self.ends.append


@pytest.fixture
def held(rig: Rig) -> Callable[..., Rig]:
    def make(constraints: dict[str, Any]) -> Rig:
        rig.loop.tolerances = GoalTolerances.of_parameters(rig.names, Constraints.model_validate(constraints))
        rig.loop.hold(rig.states(0))
        rig.around.lines.clear()
        return rig

    return make


def aborted(rig: Rig) -> list[str]:
    return [line for line in rig.around.lines if line.startswith("trajectory aborted")]


@pytest.mark.parametrize("stops", [False, True])
def test_what_runs_is_held_to_the_path_while_the_next_one_waits(held: Callable[..., Rig], stops: bool) -> None:
    """Also before the start of what came last, a trajectory or a stop, which is dropped then."""
    rig = held({"joint_1": {"trajectory": 0.02}})
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO)
    rig.loop.receive(trajectory([], [], start=1.5) if stops else rig.trajectory(0.0, start=1.5))
    rig.run(RATIO, RATIO * 2500)
    assert len(aborted(rig)) == 1
    t = np.arange(1001) * 1e-3
    late = t[np.argmax(0.1 * (3 * t**2 - 2 * t**3) > 0.02)]  # when the cubic is further than the tolerance
    assert f", at {late:.6g} s" in aborted(rig)[0]
    assert rig.cs7b.setpoint[0].min() > 0.015


def test_what_is_held_to_constraints(held: Callable[..., Rig]) -> None:
    """The newest trajectory to those of its time; a refused one changes nothing; a goal has its own; off: none."""
    rig = held({"joint_1": {"trajectory": 0.02}})
    rig.loop.receive(rig.trajectory(0.1))
    rig.loop.receive(rig.trajectory(9.0))
    wider = Constraints.model_validate({"joint_1": {"trajectory": 0.05}})
    rig.loop.tolerances = GoalTolerances.of_parameters(rig.names, wider)
    rig.run(0, RATIO * 500)
    assert "accepted up to 0.02 rad" in aborted(rig)[0]
    rig.loop.hold(rig.states(0))
    rig.loop.receive(rig.trajectory(0.1))
    rig.run(0, RATIO * 700)
    assert "accepted up to 0.05 rad" in aborted(rig)[1]
    rig.loop.hold(rig.states(0))
    rig.loop.receive(rig.trajectory(0.1))
    rig.loop.offer(rig.goal(rig.trajectory(0.1), Sender()))
    rig.run(0, RATIO * 1500)
    assert len(aborted(rig)) == 2


@pytest.mark.parametrize(("block", "field"), [("servo", "kp"), ("servo", "ki"), ("feed_forward", "viscous_friction")])
def test_a_torque_that_is_no_number_stops_the_arm(shipped: Setup, rig: Rig, block: str, field: str) -> None:
    """One line names the joint, no torque that is not finite goes out, and enable after mending goes on."""
    huge = np.array(getattr(getattr(shipped.controller, block), field))
    huge[3] = 1e308 if field == "kp" else np.inf
    absurd = unchecked(shipped.controller, **{block: {field: huge}})
    good = rig.cs7b.law.copy()
    rig.loop.hold(rig.states(0))
    assert all(rig.run(0, 8))
    with np.errstate(all="ignore"):
        rig.loop.change_law(absurd.record(shipped.robot, shipped.drives, shipped.rates), lambda _: None)
    assert not any(rig.run(8, 40)[4:])
    assert rig.around.published == [0, 4 * rig.period]  # torques that are no numbers are not published
    (line,) = (line for line in rig.around.lines if "torque nan Nm" in line)
    assert line.startswith("joint_4: torque nan Nm at 0.002 s; accepted: finite torques; torque off")
    assert np.isfinite(rig.loop.command).all()
    rig.loop.change_law(good, lambda _: None)
    rig.loop.enable(True)
    assert all(rig.run(48, 40))
    assert np.isfinite(rig.loop.command).all()
    assert np.isfinite(rig.cs7b.saturated).all()
