"""Either node may die at any moment and come back."""

from __future__ import annotations

import re
import signal
from itertools import groupby, pairwise

import pytest
from processes import Processes
from ros_client import Client, seconds

UNPACED = ("--ros-args", "-p", "real_time_factor:=0.0")


@pytest.mark.ros
def test_either_node_is_killed_and_comes_back(processes: Processes, client: Client) -> None:
    """Without its controller time stands still, announced once, until the next one; a new simulation begins anew."""
    simulation = processes.start("rx90_sim", *UNPACED)
    first = processes.start("rx90_controller")
    # As deep as the simulation can get until the signal arrives: nobody takes messages while the line is waited for.
    heard = client.listen("joint_states", depth=20_000)
    client.spin_until(lambda: bool(heard) and seconds(heard[-1]) > 0.2, "time to run")
    first.signal(signal.SIGKILL)
    simulation.wait_for("time stands still")
    client.spin_until(lambda: _drained(client, heard), "the last messages")
    stopped = seconds(heard[-1])
    second = processes.start("rx90_controller")
    simulation.wait_for("time runs on")
    client.spin_until(lambda: seconds(heard[-1]) > stopped + 0.2, "time to run on")
    # While time stands still, the newest sample comes again.
    stamps = [stamp for stamp, _ in groupby(seconds(message) for message in heard)]
    assert all(b - a == pytest.approx(1e-3) for a, b in pairwise(stamps))
    # Once for each wait; there is another one where the controller takes long to begin.
    told = re.findall("the brakes hold the arm|time stands still|time runs on", simulation.output)
    assert all((before == "time runs on") != (after == "time runs on") for before, after in pairwise(told)), told

    # After SIGKILL of the simulation the controller says once that it waits, and serves the next one from tick 0.
    heard.clear()
    client.spin_until(lambda: bool(heard) and seconds(heard[-1]) > stopped + 0.6, "time to run far")
    simulation.signal(signal.SIGKILL)
    second.wait_for("waiting for a simulation")
    before = second.output.count("waiting for a simulation")
    client.spin_until(lambda: _drained(client, heard), "the last messages")
    # Paused, so that its first sample is heard however long the client takes to find it.
    processes.start("rx90_sim", *UNPACED, "-p", "paused:=true")
    client.spin_until(lambda: seconds(heard[-1]) == 0.0, "time to begin again")
    client.simulation.pause(False)
    client.spin_until(lambda: seconds(heard[-1]) > 0.6, "time to run again")
    assert second.output.count("waiting for a simulation") - before <= 1


def _drained(client: Client, heard: list[object]) -> bool:
    """Return whether nothing more arrives within a look."""
    before = len(heard)
    client._executor.spin_once(timeout_sec=0.3)
    return len(heard) == before
