"""The run over DDS and the closed loop without ROS are the same numbers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from line_run import TOPICS, run_both_ways
from processes import Processes
from ros_client import Client

from rx90_common.bags.comparison import Verdict
from rx90_common.bags.tables import comparison_text
from rx90_emulator.loop.setup import Setup


@pytest.mark.ros
def test_lockstep_gives_the_closed_loops_bits_on_a_loaded_machine(
    processes: Processes, client: Client, shipped: Setup, tmp_path: Path
) -> None:
    """With both cores busy, every recorded number equals the closed loop without ROS, to the last bit."""
    for _ in range(2):
        processes.start(sys.executable, "-c", "while True: pass")
    comparison = run_both_ways(processes, client, shipped, tmp_path)
    assert comparison.verdict is Verdict.SAME, comparison_text(comparison)
    assert {topic.topic for topic in comparison.topics} == TOPICS
