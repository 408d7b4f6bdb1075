"""The frame of the nodes' executables, run as a process with a stand-in for the node's module."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from processes import Start

ROOT = Path(__file__).parents[3]
NODE = """
import sys, time
import rclpy
from rclpy.node import Node
from rx90_common.base.errors import ConfigError
from rx90_common.exchange import lifecycle
from rx90_common.exchange.parameters import declare

class Stub:
    def __init__(self):
        self.node = Node("stub")
        self.value = declare(self.node, "value", 1.0, "a number", low=0.0, high=2.0)
        if self.value == 2.0:
            raise ConfigError("value is 2; accepted: less")
        self.running = True
    def tick_loop(self):
        print("up", flush=True)
        while self.running:
            time.sleep(0.01)
            if self.value == 0.5:
                raise ConfigError("the ticks have ended")
    def stop(self):
        self.running = False

def spin(args):
    print("importing done", flush=True)
    lifecycle.spin(lambda: [Stub()], args)
"""
RUN = """
import sys
from rx90_emulator.cli import frame, node
node.NODES["stub"] = "stub_node"
frame.EXECUTABLES["stub"] = "rx90_emulator.cli.node"
sys.exit(frame.stub())
"""


@pytest.fixture
def start(tmp_path: Path, ros_domain: int, start_apart: Start) -> Start:  # noqa: ARG001 - a domain of its own
    """Return a function that starts the stub with arguments."""
    (tmp_path / "stub_node.py").write_text(NODE, encoding="utf-8")
    environment = dict(os.environ, PYTHONPATH=f"{ROOT}:{tmp_path}")
    return lambda *arguments: start_apart(sys.executable, "-c", RUN, *arguments, env=environment)


def read_until(process: subprocess.Popen[str], line: str) -> None:
    """Read lines up to this one."""
    assert process.stdout is not None
    assert any(read == f"{line}\n" for read in process.stdout)


pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("moment", "number"),
    [
        ("importing done", signal.SIGINT),
        ("importing done", signal.SIGTERM),
        ("up", signal.SIGINT),
        ("up", signal.SIGHUP),
    ],
)
def test_a_signal_ends_in_order_and_silently(
    start: Start, moment: str, number: signal.Signals, request: pytest.FixtureRequest
) -> None:
    """Ctrl-C, SIGTERM and SIGHUP, also twice, while starting and while running: exit code 0, nothing on stderr."""
    if moment == "up":
        request.getfixturevalue("warm")
    process = start()
    read_until(process, moment)
    process.send_signal(number)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--ros-args", "-p", "value:=2.0"), "value is 2; accepted: less"),
        (("--ros-args", "-p", "value:=0.5"), "the ticks have ended"),
        (("--ros-args", "-p", "value:=5.0"), "parameter value is 5.0; accepted: float in [0, 2]"),
        (("--ros-args", "-p", "value:=high"), "parameter value is 'high'; accepted: float in [0, 2]"),
        (("--ros-args", "-p", "value"), "ROS arguments --ros-args -p value: refused ("),
    ],
)
@pytest.mark.usefixtures("warm")
def test_a_user_mistake_is_one_line(start: Start, arguments: tuple[str, ...], complaint: str) -> None:
    """A refused value, from ROS, the constructor or the ticks, is one line on stderr and exit code 2."""
    process = start(*arguments)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors.startswith("stub: ")
    assert complaint in errors
    assert errors.count("\n") == 1
