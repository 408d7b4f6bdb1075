"""What is no goal, what the arm cannot do, and when the controller takes none: rejected or aborted, with the reason."""

from __future__ import annotations

import pytest
from action_bench import ABORTED, STEP, SUCCEEDED, Bench
from diagnostic_msgs.msg import DiagnosticArray
from ros_client import JOINTS

pytestmark = pytest.mark.ros


def test_what_is_no_goal_is_rejected_and_logged_and_the_one_before_goes_on(bench: Bench) -> None:
    """Bad goals, of which test_goals.py has every kind, get a line each; the goal before is not touched."""
    from action_client import goal, move, point

    bench.home()
    bench.time.run(0.2)
    first = bench.goals.send(move(0.05, 0.4))
    result = bench.goals.result_of(first)
    bench.time.run(0.05)
    diagnostics = bench.client.listen("/diagnostics", DiagnosticArray, depth=10)

    def last_rejection() -> str:
        """Return what the controller's newest diagnostics say of it."""
        values = [value for message in diagnostics for status in message.status for value in status.values]
        return str(next((value.value for value in reversed(values) if value.key == "last rejection"), ""))

    end = point(1.0, [0.0] * 6)
    for message, words in (
        (goal(end, names=["a", *JOINTS[1:]]), "unknown joint 'a'"),
        (move(0.0, 0.1, start=bench.now - 0.11), "the last point is at"),
    ):
        before = bench.cell.output.count("goal rejected")
        assert not bench.others.send(message).accepted
        bench.client.spin_until(lambda: bench.cell.output.count("goal rejected") > before, words)  # noqa: B023 - called at once
        (line,) = [line for line in bench.cell.output.splitlines() if "goal rejected" in line][before:]
        assert words in line
    at = f"goal at {bench.now:.3f} s: {line.partition('rejected: ')[2]}"
    bench.client.spin_until(lambda: last_rejection() == at, "the last of them in the diagnostics")
    assert bench.time.until(result).status == SUCCEEDED
    bench.home()
    handle = bench.goals.send(goal(point(0.0, [0.1] * 6), point(1.0, [0.1] * 6)))
    ended = bench.goals.wait(bench.goals.result_of(handle))
    assert (ended.status, ended.result.error_code) == (ABORTED, -1)
    assert "joint_1 starts at 0.1 rad" in ended.result.error_string
    bench.time.run(0.05)
    assert not bench.velocities().any()


def test_brakes_end_a_goal_and_refuse_the_next(bench: Bench) -> None:
    """With the torque off the goal is aborted with INVALID_GOAL, at once; goals are rejected until it is on again."""
    from action_client import move

    def deactivate() -> None:
        assert bench.client.transition("rx90_controller", "deactivate")

    def activate() -> None:
        assert bench.client.transition("rx90_controller", "activate")

    for off, on, end, reason in (
        (
            lambda: bench.client.enable(False),
            lambda: bench.client.enable(True),
            "the torque is off, at ",
            "disabled; accepted: after a call of ~/enable with true",
        ),
        (
            deactivate,
            activate,
            "the controller is deactivated, the torque is off, at ",
            "inactive; accepted: in state active",
        ),
    ):
        bench.home()
        result = bench.goals.result_of(bench.goals.send(move(0.05, 0.4)))
        bench.time.run(0.1)
        off()
        ended = bench.goals.wait(result)
        assert (ended.status, ended.result.error_code) == (ABORTED, -1)
        assert ended.result.error_string.startswith(end)
        bench.time.run(STEP)
        assert not bench.goals.send(move(0.0)).accepted
        bench.said(f"goal rejected: the controller is {reason}")
        on()
        bench.time.run(STEP)
    bench.home()
    for on in (False, True):
        bench.client.enable(on)
    # It waits for the tick with which the torque comes back.
    assert bench.time.until(bench.goals.result_of(bench.goals.send(move(0.02, 0.3)))).status == SUCCEEDED
