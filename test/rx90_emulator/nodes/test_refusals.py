"""Bad parameters and a diverging state: one line, a non-zero exit, no traceback; mostly in the tests' own process."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from processes import Processes
from ros_client import Client
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from rx90_common.base.rates import Rates
from rx90_common.exchange.channel import lock_publisher
from rx90_common.exchange.endpoints import LATCHED_QOS, TICK_QOS
from rx90_common.exchange.topics import FREE_RUNNING, TimeMode
from rx90_emulator.cli.frame import run

pytestmark = pytest.mark.ros
Refused = Callable[..., str]
LIMIT = 300  # s; the kernels may have to be compiled first


def the_line(stderr: str, *others: str) -> str:
    """Return the only line, but for those with these words.

    On a machine without compiled kernels another one says that they are compiled.
    """
    others += ("compiling the numerical kernels",)
    (line,) = (line for line in stderr.splitlines() if not any(words in line for words in others))
    return line


@pytest.fixture
def refused(ros_domain: int, capfd: pytest.CaptureFixture[str]) -> Iterator[Refused]:  # noqa: ARG001 - its environment
    """Return a function that runs a command in this process and returns its only line; one that runs on is ended.

    The line is the only one of all that the process writes, the middleware below Python included.
    """
    before = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))

    def line(code: int, name: str, *words: str) -> str:
        signal.alarm(LIMIT)
        try:
            ended = run(name, words)
        finally:
            signal.alarm(0)
        assert ended == code
        line = the_line(capfd.readouterr().err)
        assert line.startswith(f"{name}: ")
        return line

    try:
        yield line
    finally:
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize(
    ("name", "argument", "accepted"),
    [
        ("rx90_sim", "initial_position:=[0, 9, 0, 0, 0, 0]", ["joint_2", "9"]),
        ("rx90_sim", "real_time_facto:=1.0", ["real_time_facto is unknown", "real_time_factor", "step_ticks"]),
        ("rx90_sim", "qos_overrides./joint_states.publisher.depth:=0", ["joint_states.publisher.depth is 0", "[1,"]),
        (
            "rx90_sim",
            "qos_overrides./motor_states.publisher.depth:=5",
            ["motor_states.publisher.depth is unknown", "depth, reliability, durability of /clock.publisher"],
        ),
        ("rx90_cell", "paused:=true", ["paused is unknown to rx90_controller", "-p rx90_sim:paused:="]),
    ],
)
def test_a_bad_parameter_is_one_line(refused: Refused, name: str, argument: str, accepted: list[str]) -> None:
    """The line names the program, the offending value and what is accepted; the exit code is 2."""
    line = refused(2, name, "--ros-args", "-p", argument)
    assert all(word in line for word in accepted), line


@pytest.mark.parametrize(("name", "topic"), [("rx90_sim", "/motor_states"), ("rx90_controller", "/motor_commands")])
def test_a_second_node_of_a_kind_is_refused(refused: Refused, ros_domain: int, name: str, topic: str) -> None:
    """Its topic has a publisher already: exit code 3 and one line that names topic and process."""
    with lock_publisher(ros_domain, topic):
        line = refused(3, name)
    held = f"{topic} in ROS_DOMAIN_ID {ros_domain} is already published by process {os.getpid()}; accepted: one"
    assert line.startswith(f"{name}: {held}")


def test_another_robot_or_rate_than_the_simulations_ends_a_controller(processes: Processes, client: Client) -> None:
    """In one process or from another one: exit code 3 and one line with both values.

    They are processes of their own: in one process the middleware would warn of the second node of a name.
    """
    done = processes.run("rx90_cell", "--ros-args", "-p", "rx90_controller:robot:=tx40")
    assert done.returncode == 3, done.stderr
    assert the_line(done.stderr).startswith("rx90_cell: the robot is 'tx40' here and 'rx90b' in the simulation")
    states = client.node.create_publisher(JointState, "motor_states", TICK_QOS)
    mode = client.node.create_publisher(String, "time_mode", LATCHED_QOS)
    mode.publish(String(data=TimeMode(FREE_RUNNING, Rates()).text))
    controller = processes.start("rx90_controller", "--ros-args", "-p", "position_rate:=500")

    def ended() -> bool:
        states.publish(JointState())  # so that it is taken for a simulation
        return controller.returncode is not None

    client.spin_until(ended, "the end of the controller")
    assert controller.returncode == 3, controller.output
    assert "position_rate is 500 Hz here and 1000 Hz in the simulation" in controller.output


def test_the_time_mode_counts_from_the_sender_of_the_motor_states_alone(processes: Processes, client: Client) -> None:
    """Another process's, before and while the nodes run, ends no control, also with a publisher that sends nothing."""
    mode = client.node.create_publisher(String, "time_mode", LATCHED_QOS)
    strange = TimeMode(FREE_RUNNING, Rates(2000, 500), "other")
    mode.publish(String(data=strange.text))
    controller = processes.start("rx90_controller")
    controller.wait_for("'free_running base_rate=2000 position_rate=500 robot=other' of a process whose")
    states = client.node.create_publisher(JointState, "motor_states", TICK_QOS)
    processes.start("rx90_sim", "--ros-args", "-p", "real_time_factor:=0.0")
    controller.wait_for("the simulation is there|ready: ")
    client.spin_until(lambda: states.get_subscription_count() > 0, "the controller's ear")
    for text in ("sometimes", strange.text, TimeMode(FREE_RUNNING, Rates()).text):
        mode.publish(String(data=text))
    client.send([(1.0, [0.01] * 6), (2.0, [0.0] * 6)])
    controller.wait_for("trajectory accepted: 2 points")
    controller.wait_for("trajectory ended")
    assert controller.returncode is None
    assert controller.output.count("of a process whose /motor_states are not followed") == 1


def test_a_diverging_arm_ends_the_run_with_joint_and_tick(
    processes: Processes, edited_yaml: Any, shipped_files: Any
) -> None:
    """A gain far too large for an amplifier without limits ends the run with one line, not with NaN.

    In a process of its own: threads of the executor may write of the run after its end, into the next test's output.
    """
    drives: Path = edited_yaml(shipped_files.drives, ("motor", "peak_current"), [1e7] * 6)
    law: Path = edited_yaml(shipped_files.controller, ("servo", "kv"), [400.0] * 3 + [1.2e4] + [400.0] * 2)
    law = edited_yaml(law, ("supervision", "following_error"), [1.0] * 6)
    law = edited_yaml(law, ("supervision", "over_speed"), 10.0)
    parameters = (f"drives:={drives}", f"rx90_controller:controller:={law}", "rx90_sim:real_time_factor:=0.0")
    words = [word for given in parameters for word in ("-p", given)]
    done = processes.run("rx90_cell", "--ros-args", *words)
    assert done.returncode == 3, done.stderr
    line = the_line(done.stderr, "[INFO] ")  # the run had begun
    assert re.match(r"rx90_cell: the state of joint_\d diverged in tick \d+", line)


def test_the_simulation_takes_the_steps_that_the_arm_needs_or_says_so(
    refused: Refused, processes: Processes, edited_yaml: Any, shipped_files: Any
) -> None:
    """Stiff bristles: the log tells how many plant steps the node takes by itself; fewer asked for are one line."""
    file: Path = edited_yaml(shipped_files.friction, ("elements", "joint_6", "c0"), 5.0e5)
    told = ["--ros-args", "-p", f"friction:={file}"]
    processes.start("rx90_sim", *told).wait_for(r"ready: .*, [2-9] plant steps in a tick")
    line = refused(2, "rx90_sim", *told, "-p", "substeps:=2")
    assert re.search(r"friction\.joint_6\.c0 is 500000 Nm/rad, .*2 plant steps.*substeps [3-9]", line), line
