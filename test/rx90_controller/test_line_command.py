"""The command-line tool: its table, its files, its exit status, and its delivery over DDS."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import rclpy
import yaml
from pinocchio_chain import tip_pose
from processes import Start
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from schema_faults import schema_faults
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from rx90_common.base.share import config_path
from rx90_common.process.children import executable
from rx90_controller.lines.plan import Approach, plan_line
from rx90_controller.lines.task import load_task
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.setup import Setup

REFERENCE = "robots/rx90b/task.yaml"
PATIENCE = 60.0


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


class Listener:
    """A controller's ears and a simulation's mouth: takes trajectories, tells joint states."""

    def __init__(self, domain: int, namespace: str) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("rx90_controller", context=self.context, namespace=namespace)
        self.taken: list[JointTrajectory] = []
        self.states = self.node.create_publisher(JointState, "joint_states", 10)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def listen(self) -> None:
        """Start taking trajectories."""
        self.node.create_subscription(JointTrajectory, "rx90_controller/joint_trajectory", self.taken.append, 1)

    def tell(self, names: tuple[str, ...], positions: np.ndarray) -> None:
        """Publish the joint positions over and over, in reversed order of names."""
        state = JointState(name=list(names)[::-1], position=positions[::-1].tolist())
        self.node.create_timer(0.02, lambda: self.states.publish(state))

    def wait(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition, not for a time."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline
            time.sleep(0.01)

    def _spin(self) -> None:
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Stop the thread and leave the domain."""
        self._stop.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def listener(ros_domain: int, request: pytest.FixtureRequest) -> Iterator[Listener]:
    """Return a listener in the test's domain, and in the namespace that is its parameter."""
    listener = Listener(ros_domain, getattr(request, "param", "/"))
    yield listener
    listener.close()


LINE = executable("rx90 line", REFERENCE)


@pytest.mark.ros
def test_a_controller_that_comes_later_gets_the_whole_trajectory(
    shipped: Setup, listener: Listener, start_apart: Start
) -> None:
    """The tool announces its wait once, sends when the controller is there, and ends after it has it."""
    process = start_apart(*LINE, "--start-time", "12.5", "--timeout", str(PATIENCE))
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("waiting for a controller on /rx90_controller/joint_trajectory"):
            break
    listener.listen()
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert "waiting" not in out
    assert "sent 72 points to /rx90_controller/joint_trajectory: start at 12.5 s, 5.600 s" in out
    listener.wait(lambda: bool(listener.taken))
    (message,) = listener.taken
    plan = plan_line(shipped.robot, load_task(config_path(REFERENCE)))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 500_000_000)
    assert tuple(message.joint_names) == plan.joint_names
    assert np.array_equal([p.positions for p in message.points], plan.position)
    assert np.array_equal([p.velocities for p in message.points], plan.velocity)
    assert np.array_equal([p.accelerations for p in message.points], plan.acceleration)
    last = message.points[-1].time_from_start
    assert (last.sec, last.nanosec) == (5, 600_000_000)


@pytest.mark.ros
@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize("listener", ["/cell"], indirect=True)
def test_approach_comes_first_where_the_arm_stands_elsewhere(
    shipped: Setup, listener: Listener, start_apart: Start
) -> None:
    """From another pose the first point, the start of the line, comes after the time a joint move takes."""
    plan = plan_line(shipped.robot, load_task(config_path(REFERENCE)))
    here = plan.start_pose + np.array([0.1, -0.2, 0.3, 0.0, 0.1, -0.4])
    listener.tell(shipped.robot.joint_names, here)
    listener.listen()
    process = start_apart(*LINE, "--approach", "--node", "/cell/rx90_controller", "--timeout", str(PATIENCE))
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert "approach: " in out
    assert "points to /cell/rx90_controller/joint_trajectory" in out
    listener.wait(lambda: bool(listener.taken))
    first = listener.taken[0].points[0]
    assert np.array_equal(first.positions, plan.start_pose)
    assert not np.any(first.velocities)
    expected = Approach().duration(shipped.robot, here, plan.start_pose)
    delay = first.time_from_start.sec + 1e-9 * first.time_from_start.nanosec
    assert expected <= delay < expected + 1e-3
