"""The lock-step between real processes on real DDS: order, repetition, loss and return of either side."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from exchange_peer import expected
from processes import Processes, open_files

from rx90_common.process.children import ChildProcess

pytestmark = pytest.mark.ros
PEER = Path(__file__).parents[2] / "support" / "exchange_peer.py"
Start = Callable[..., ChildProcess]


@pytest.fixture
def start(processes: Processes, monkeypatch: pytest.MonkeyPatch) -> Start:
    """Start a stand-in of exchange_peer.py by its role."""
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(PEER.parents[2]))
    return lambda role, *arguments: processes.start(sys.executable, PEER, role, *arguments)


def waits_since(process: ChildProcess, line: str) -> list[str]:
    """Return what a simulation has said of waiting behind a line: at the start its controller may take long."""
    lines = process.lines
    return [each for each in lines[lines.index(line) :] if "waiting" in each or "stands still" in each]


def assert_quiet(*running: ChildProcess) -> None:
    """Nothing of the middleware, no warning and no traceback on the terminal."""
    for process in running:
        assert not re.search(r"ERROR|Error|RTPS|WARN|Traceback|Exception", process.output), process.output


def test_numbers_are_those_of_one_process_with_a_slow_recorder_on_a_busy_machine(start: Start) -> None:
    """Lock-step between processes gives the numbers of a plain loop, and a recorder that lags gets every tick."""
    ticks = 1500
    recorder = start("record", ticks, 0.3)
    recorder.wait_for("recorder up")
    controller = start("control", 2)
    controller.wait_for("controller up")
    burner = start("burn")
    simulation = start("simulate", ticks, 0, 2)
    assert int(simulation.wait_for(r"final (\d+)")[0].split()[1]) == expected(ticks)
    assert simulation.wait() == 0
    recorder.wait_for("recorded motor_states complete")
    recorder.wait_for("recorded motor_commands complete")
    assert_quiet(simulation, controller, recorder, burner)


def test_either_side_is_killed_and_comes_back(start: Start) -> None:
    """Time stands still while the controller is away, a line at each end of that; a restarted simulation begins at 0.

    Its numbers are then those of a first run.
    """
    ticks = 1000
    controller = start("control")
    first = start("simulate", 100_000, 0.0005)
    first.wait_for("tick 500")
    controller.signal(signal.SIGKILL)
    first.wait_for("time stands still")
    again = start("control")
    again.wait_for(r"begin [1-9]")
    first.wait_for("the controller answers")
    first.wait_for("tick")
    assert len(waits_since(first, "tick 500")) == 1, first.output
    first.signal(signal.SIGKILL)
    first.wait()
    second = start("simulate", ticks, 0)
    again.wait_for("begin 0")
    assert int(second.wait_for(r"final (\d+)")[0].split()[1]) == expected(ticks)
    assert second.wait() == 0
    assert_quiet(first, second, again)


def test_a_killed_recorder_does_not_stop_the_ticks(start: Start) -> None:
    """A subscriber that was killed, and whose lease still runs, holds nothing up and loses no tick."""
    ticks = 1000
    recorder = start("record", ticks, 0)
    recorder.wait_for("recorder up")
    controller = start("control")
    simulation = start("simulate", ticks, 0)
    simulation.wait_for("tick 250")
    recorder.signal(signal.SIGKILL)
    assert int(simulation.wait_for(r"final (\d+)")[0].split()[1]) == expected(ticks)
    assert not waits_since(simulation, "tick 250"), simulation.output
    assert_quiet(controller)


def test_a_second_node_of_a_kind_is_refused(start: Start) -> None:
    """A second simulation or controller ends with one line that names topic and process; the first runs on."""
    controller = start("control")
    # Longer than any machine takes to start the second ones; the fixture ends it.
    simulation = start("simulate", 1_000_000, 0.0005)
    simulation.wait_for("tick 250")
    for role, topic, first in (("simulate", "/motor_states", simulation), ("control", "/motor_commands", controller)):
        second = start(role, 10, 0)
        assert second.wait() == 1
        assert second.lines == [
            f"{topic} in ROS_DOMAIN_ID {os.environ['ROS_DOMAIN_ID']} is already published by process {first.pid}; "
            "accepted: one publisher; end that process, or choose another ROS_DOMAIN_ID or namespace"
        ]
    reached = max(int(line.split()[1]) for line in simulation.lines if line.startswith("tick"))
    simulation.wait_for(f"tick {reached + 500}")


def test_dds_stays_on_loopback_and_leaves_no_shared_memory(start: Start) -> None:
    """With the range LOCALHOST a node's UDP sockets are bound to 127.0.0.1 alone, and /dev/shm is not used."""
    controller = start("control")
    controller.wait_for("controller up")
    inodes = {link[8:-1] for link in open_files(controller.pid) if link.startswith("socket:[")}
    bound = {
        fields[1].split(":")[0]
        for table in ("udp", "udp6")
        for fields in map(str.split, Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:])
        if fields[9] in inodes
    }
    assert bound == {"0100007F"}
    assert not re.search(r"/dev/shm/\S*fastrtps", Path(f"/proc/{controller.pid}/maps").read_text(encoding="utf-8"))
