"""The command-line tool: its table, its files, its exit status, and its delivery over DDS."""

import re
import signal
from contextlib import closing
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from pinocchio_chain import tip_pose
from processes import Processes
from ros_client import Client, seconds
from schema_faults import schema_faults
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.share import config_path
from rx90_common.exchange.endpoints import ros_time
from rx90_controller.lines.plan import approach_duration, plan_line
from rx90_controller.lines.task import load_task
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.setup import Setup

REFERENCE = "robots/rx90b/task.yaml"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("", ["5.600 s, moving from 1.000 s to 5.100 s", "front/positive/positive"]),
        # 0.4 m at 0.2 m/s and 1 m/s^2: 2 s + 0.2 s; what is given beside a task file replaces what that has.
        (f"{REFERENCE} --speed 0.2", ["3.700 s, moving from 1.000 s to 3.200 s"]),
        # Start and end are enough; negative coordinates are no options.
        ("--start 0.6 -0.2 0.2 --end 0.6 0.2 0.2", ["0.4000 m at 0.1 m/s", "front/positive/positive"]),
    ],
)
def test_dry_run_prints_the_plan(capsys: pytest.CaptureFixture[str], arguments: str, words: list[str]) -> None:
    """The table names duration, posture, knots, each margin and each joint, and nothing is sent."""
    assert run("rx90 line", [*arguments.split(), "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert [word for word in words if word not in out] == []
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines()}
    assert {*(f"joint_{i}" for i in range(1, 7)), "knots", "margin"} <= rows.keys()
    assert re.search(r"distance from the shoulder singularity 0\.\d+ \(1 is farthest\), at ", out)
    if REFERENCE in arguments:
        assert [float(x) for x in rows["joint_1"][:3]] == pytest.approx([-26.57, -26.57, 7.18])


def test_output_is_the_message_in_yaml(shipped: Setup, tmp_path: Path) -> None:
    """The written file holds names, points and times as in the plan, to the last bit."""
    file = tmp_path / "line.yaml"
    assert run("rx90 line", [REFERENCE, "--dry-run", "--output", str(file)]) == 0
    assert schema_faults("trajectory", file) == []
    message = yaml.safe_load(file.read_text(encoding="utf-8"))
    plan = plan_line(shipped.robot, load_task(config_path(REFERENCE)))
    assert message["joint_names"] == list(shipped.robot.joint_names)
    points = message["points"]
    assert np.array_equal([p["positions"] for p in points], plan.position)
    assert np.array_equal([p["velocities"] for p in points], plan.velocity)
    assert np.array_equal([p["accelerations"] for p in points], plan.acceleration)
    times = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    np.testing.assert_allclose(times, plan.times, atol=1e-12)


def test_set_points_as_a_table_are_those_of_the_plan(shipped: Setup, tmp_path: Path) -> None:
    """Each row is a set-point: time, joints in degrees, and Pinocchio's pose of the tool in mm and degrees."""
    file = tmp_path / "line.csv"
    words = [REFERENCE, "--dry-run", "--rate", "250", "--output", str(file)]
    assert run("rx90 line", words) == 0
    head, *lines = file.read_text(encoding="utf-8").splitlines()
    assert head.split(",")[:2] == ["time [s]", "joint_1 [deg]"]
    assert head.endswith("tool x [mm],tool y [mm],tool z [mm],tool roll [deg],tool pitch [deg],tool yaw [deg]")
    rows = np.array([line.split(",") for line in lines], dtype=np.float64)
    plan = plan_line(shipped.robot, load_task(config_path(REFERENCE)), 1 / 250)
    assert len(rows) == np.floor(plan.duration * 250) + 1
    np.testing.assert_allclose(np.diff(rows[:, 0]), 1 / 250, atol=1e-9)
    angles = plan.setpoints(rows[:, 0])[:, 0]
    np.testing.assert_allclose(rows[:, 1:7], np.degrees(angles), atol=1e-6)
    for row, q in zip(rows[::50], angles[::50], strict=True):
        pose = tip_pose(shipped.robot, q)
        np.testing.assert_allclose(row[7:10], 1e3 * pose[:3, 3], atol=1e-5)
        turn = pin.rpy.rpyToMatrix(*np.radians(row[10:]))
        np.testing.assert_allclose(turn, pose[:3, :3], atol=1e-7)


@pytest.mark.parametrize(("policy", "code"), [("hold", 0), ("lower", 2)])
def test_a_line_holds_its_speed(tmp_path: Path, capsys: pytest.CaptureFixture[str], policy: str, code: int) -> None:
    """The key of paths is one of lines, too, which are never slowed."""
    file = tmp_path / "task.yaml"
    task = config_path(REFERENCE).read_text(encoding="utf-8")
    file.write_text(task.replace("line:\n", f"line:\n  speed_policy: {policy}\n"), encoding="utf-8")
    assert run("rx90 line", [str(file), "--dry-run"]) == code
    said = "line.speed_policy is 'lower'; accepted: hold" if code else ""
    assert said in capsys.readouterr().err


@pytest.mark.ros
def test_a_controller_that_comes_later_gets_the_whole_trajectory(shipped: Setup, processes: Processes) -> None:
    """The tool announces its wait, sends when the controller is there, and ends after it has it."""
    with closing(Client()) as client:
        name = client.node.get_name()
        sender = processes.start("rx90 line", REFERENCE, "--node", name, "--start-time", "12.5")
        sender.wait_for(f"waiting for a controller on /{name}/joint_trajectory")
        taken = client.listen(f"{name}/joint_trajectory", JointTrajectory)
        client.spin_until(lambda: bool(taken), "the trajectory")
    assert sender.wait() == 0, sender.output
    assert f"sent 72 points to /{name}/joint_trajectory: start at 12.5 s, 5.600 s" in sender.output
    (message,) = taken
    plan = plan_line(shipped.robot, load_task(config_path(REFERENCE)))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 500_000_000)
    assert tuple(message.joint_names) == plan.joint_names
    assert np.array_equal([p.positions for p in message.points], plan.position)
    assert np.array_equal([p.velocities for p in message.points], plan.velocity)
    assert np.array_equal([p.accelerations for p in message.points], plan.acceleration)
    last = message.points[-1].time_from_start
    assert (last.sec, last.nanosec) == (5, 600_000_000)


@pytest.mark.ros
@pytest.mark.parametrize(
    ("end", "code", "said"),
    [
        ("arrives", 0, "arrived: the motion ended at "),
        ("stays", 3, "rad from the trajectory's end (accepted: 0.001)"),
        ("interrupted", 130, "interrupted; the controller goes on with the motion"),
    ],
)
def test_the_command_ends_with_the_motion(shipped: Setup, processes: Processes, end: str, code: int, said: str) -> None:
    """Not before the end of approach and line in the arm's time; 5 s after it rests elsewhere; at once by Ctrl-C."""
    plan = plan_line(shipped.robot, load_task(config_path(REFERENCE)))
    here = plan.start_pose + np.array([0.1, -0.2, 0.3, 0.0, 0.1, -0.4])
    approach = approach_duration(shipped.robot, here, plan.start_pose)
    whole = approach + plan.duration
    after = {"arrives": whole, "stays": whole + 5.0, "interrupted": 2.5}[end]
    state = JointState(name=shipped.robot.joint_names[::-1], position=here[::-1].tolist())
    with closing(Client()) as client:
        name = client.node.get_name()
        taken = client.listen(f"{name}/joint_trajectory", JointTrajectory)
        states = client.node.create_publisher(JointState, "joint_states", 10)
        begun: list[float] = []  # time when the trajectory came

        def publish() -> None:
            now = seconds(state) + 0.02
            state.header.stamp = ros_time(round(now * 1e9))
            begun.extend([now] * (len(taken) - len(begun)))
            if end == "arrives" and begun and now > begun[0] + after:
                state.position = plan.position[-1, ::-1].tolist()
            states.publish(state)

        client.node.create_timer(0.02, publish)
        sender = processes.start("rx90 line", REFERENCE, "--approach", "--node", name)
        client.spin_until(lambda: bool(begun), "the trajectory")
        if end == "interrupted":
            client.spin_until(lambda: seconds(state) > begun[0] + after, "the wait for the end")
            sender.signal(signal.SIGINT)
        client.spin_until(lambda: sender.returncode is not None, "the end of the command")
    assert sender.returncode == code
    assert said in sender.output
    assert -0.2 < seconds(state) - begun[0] - after < 1.5
    first = taken[0].points[0]
    assert np.array_equal(first.positions, plan.start_pose)
    assert not np.any(first.velocities)
    assert 0.0 <= first.time_from_start.sec + 1e-9 * first.time_from_start.nanosec - approach < 1e-3
