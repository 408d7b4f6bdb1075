"""A program of V+ on running nodes: the controller's arm moves, and signals are topics."""

import socket
from pathlib import Path

import pytest
from processes import Processes
from ros_client import Client
from std_msgs.msg import Int32MultiArray

from rx90_common.exchange.endpoints import LATCHED_QOS

pytestmark = pytest.mark.ros

PROGRAM = """
.PROGRAM p()
  SIGNAL 3
  DRIVE 1, 10, 50
  BREAK
  HERE #a
  DECOMPOSE j[1] = #a
  TYPE (j[1] > 9.95) AND (j[1] < 10.05), SIG(3)
  SIGNAL -3, 7
  DELAY 3
.END
"""


def test_a_program_moves_the_arm_of_running_nodes(processes: Processes, client: Client, tmp_path: Path) -> None:
    """The measured joint is where the program drove it; the outputs that are on are heard, by who comes late, too."""
    (tmp_path / "p.v2").write_text(PROGRAM)
    heard = client.listen("rx90_program/outputs", Int32MultiArray, LATCHED_QOS)
    processes.start("rx90_cell")
    program = processes.start("rx90 program nodes", tmp_path / "p.v2")
    client.spin_until(lambda: [7] in [list(message.data) for message in heard], "the last output")
    program.wait_for("2 motions, cycle time")
    assert "s   -1 -1" in program.output
    assert "signal 3 on" in program.output  # who comes later hears the latest outputs alone


def test_the_monitor_hears_of_torque_that_is_off_and_switches_it_on(processes: Processes, client: Client) -> None:
    """Motions are refused until ENABLE POWER, also where the torque was off for a moment; then the arm moves."""
    processes.start("rx90_cell").wait_for("rx90_controller.: ready")
    client.enable(False)
    monitor = processes.start("rx90 monitor nodes", "--port", 0)
    port = int(monitor.wait_for(r"127.0.0.1:(\d+)")[1])
    with socket.create_connection(("127.0.0.1", port), timeout=60) as line:
        stream = line.makefile("rwb", buffering=0)

        def read(end: bytes) -> str:
            shown = b""
            while not shown.endswith(end):
                shown += stream.read(1)
            return shown.decode()

        def command(text: str) -> str:
            stream.write(text.encode() + b"\r")
            return read(b"\r\n.")

        read(b".")
        assert "*Robot power off*" in command("do drive 1, 10, 50")
        assert "*" not in command("enable power")
        command("do drive 1, 10, 50")
        command("do break")
        assert float(command("where").split("\r\n")[4].split()[0]) == pytest.approx(10.0, abs=0.1)
        client.enable(False)
        client.enable(True)
        assert "*Robot power off* rx90_controller: " in read(b"\r\n.")
        assert "*Robot power off*" in command("do drive 1, 10, 50")
        assert "*" not in command("enable power")
        assert "*" not in command("disable power")
        assert "*Robot power off*" in command("do drive 1, 10, 50")
