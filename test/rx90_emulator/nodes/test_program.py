"""A program of V+ on running nodes: the controller's arm moves, and signals are topics."""

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
