"""A short line through the nodes in lock-step, beside the same line through the closed loop without ROS."""

import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml
from processes import Processes
from ros_client import Client, seconds

from rx90_common.bags.comparison import BagComparison, compare_bags
from rx90_common.process.children import executable
from rx90_controller.lines.plan import plan_line
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.correction.file import write_correction
from rx90_emulator.correction.learning import learn_correction
from rx90_emulator.loop.line import run_line
from rx90_emulator.loop.result import write_bag
from rx90_emulator.loop.setup import Setup

START = 0.1
TOPICS = {
    "/friction_states",
    "/joint_states",
    "/motor_commands",
    "/motor_states",
    "/rx90_controller/reference",
    "/rx90_controller/tracking_error",
    "/rx90_controller/reference_acceleration",
    "/rx90_controller/commanded_current",
    "/rx90_controller/motor_current",
}
REACH = {"rx90b": 0.6, "tx40": 0.33}  # how far in front of each robot the line is, m
TASK = """
line:
  provenance: assumed
  source: a short line for the tests
  start: [0.6, -0.02, 0.2]
  end: [0.6, 0.02, 0.2]
  speed: 0.2
  acceleration: 2.0
  tool_rpy_degrees: [0.0, 180.0, 0.0]
  rest_before: 0.05
  rest_after: 0.05
"""


def run_both_ways(
    processes: Processes,
    client: Client,
    setup: Setup,
    folder: Path,
    *,
    around: Sequence[str] = (),
    burners: int = 0,
    rests: int = 0,
    switches: Sequence[str] = (),
) -> BagComparison:
    """Run the line of a shipped robot's setup both ways and compare all that was recorded, bit by bit.

    `around` is the command line before those of the nodes, which then start cold; `burners` take a processor each;
    `rests`: so often the simulation is deactivated, and its slow pace changed. `switches` of the feed-forward are on.
    """
    files = setup.files
    file = folder / "task.yaml"
    file.write_text(TASK.replace("0.6,", f"{REACH[files.urdf.parent.name]},"), encoding="utf-8")
    task = load_task(file)
    _write_run(setup, task, folder)
    plan = plan_line(setup.robot, task)
    parameters = folder / "parameters.yaml"
    pose = [float(angle) for angle in plan.start_pose]
    of_simulation = {
        "initial_position": pose, "duration": START + plan.duration, "paused": True,
        "real_time_factor": 0.1 if rests else 0.0, "robot": str(files.urdf.parent),
        "friction": files.text("friction"), "seed": setup.seed,
    }  # fmt: skip
    of_controller = {"robot": files.urdf.parent.name, "controller": files.text("controller")}
    of_controller |= {f"feed_forward.{name}": True for name in switches}
    sections = {"rx90_sim": of_simulation, "rx90_controller": of_controller}
    parameters.write_text(
        yaml.safe_dump({node: {"ros__parameters": values} for node, values in sections.items()}), encoding="utf-8"
    )
    simulation, controller = (
        processes.start(*around, *executable(name), "--ros-args", "--params-file", parameters) for name in sections
    )
    simulation.wait_for("]: ready: ")  # kernels that are compiled first take longer than rx90 line waits
    options = ("--start-time", START, "--correction", folder / "correction.yaml")
    line = processes.start("rx90 line", "--robot", files.urdf.parent.name, file, *options)
    assert line.wait() == 0
    # Only now: whoever sent the trajectory is gone before anybody records.
    recorder = processes.start("rx90 bag", "record", "--output", folder / "recorded")
    recorder.wait_for("ready: all")
    burning = [processes.start(sys.executable, "-c", "print('up')\nwhile True: pass") for _ in range(burners)]
    for burner in burning:
        burner.wait_for("up")
    client.simulation.pause(False)
    for rest in range(rests):
        client.spin_until(lambda at=START + 0.1 * rest: client.simulation.time > at, "the motion")  # type: ignore[misc]
        assert client.transition("rx90_sim", "deactivate")
        joints = client.listen("joint_states")
        client.spin_until(lambda heard=joints: len(heard) > 2, "the newest sample again")  # type: ignore[misc]
        assert len({seconds(message) for message in joints}) == 1
        pace = 0.12 + 0.02 * rest if rest < rests - 1 else 1.0
        assert client.set_parameters("rx90_sim", real_time_factor=pace) == [""]
        assert client.transition("rx90_sim", "activate")
    assert simulation.wait() == 0
    stops = re.findall("inactive: time stands still at (.*) s", simulation.output)
    assert len(stops) == rests
    assert all(START < float(stop) < START + plan.duration for stop in stops)
    for burner in burning:
        burner.signal(signal.SIGKILL)
    # What the controller's last tick has brought about is sent after the command that the simulation waits for.
    for other in (controller, recorder):
        other.signal(signal.SIGINT)
        assert other.wait() == 0
    assert not re.findall("^(?:lost|not recorded|nothing recorded): .*", recorder.output, re.MULTILINE)
    return compare_bags(folder / "recorded", folder / "closed_loop")


def _write_run(setup: Setup, task: LineTask, folder: Path) -> None:
    learned = learn_correction(setup, task, 1)
    run = run_line(setup, task, start_time=START, record_fast=True, correction=learned.correction)
    write_bag(run, folder / "closed_loop")
    write_correction(learned, folder / "correction.yaml")
