"""Free-running: the wall clock drives, commands are held, stale ones close the brakes."""

from __future__ import annotations

import signal

import pytest
from processes import Processes
from ros_client import Client, seconds


@pytest.mark.ros
def test_a_silent_controller_closes_the_brakes_and_a_late_one_opens_them(processes: Processes, client: Client) -> None:
    """Time runs on without the controller; the brakes close when it is stopped and open when it goes on."""
    simulation = processes.start(
        "rx90_sim", "--ros-args", "-p", "time_mode:=free_running", "-p", "command_timeout:=0.05"
    )
    controller = processes.start("rx90_controller")
    joints = client.listen("joint_states")
    simulation.wait_for("the brakes open")
    controller.signal(signal.SIGSTOP)
    simulation.wait_for("torque off, brakes closed")
    stopped = seconds(joints[-1]) if joints else 0.0
    client.spin_until(lambda: bool(joints) and seconds(joints[-1]) > stopped + 0.5, "time to run on")
    controller.signal(signal.SIGCONT)
    simulation.wait_for("the brakes open")


@pytest.mark.ros
def test_a_trajectory_goes_on_after_a_pause(processes: Processes, client: Client) -> None:
    """While time stands still the motion rests; then the set-points go on where they were, on to the last point."""
    processes.start("rx90_sim", "--ros-args", "-p", "time_mode:=free_running")
    controller = processes.start("rx90_controller")
    reference = client.listen("rx90_controller/reference", depth=1)
    client.spin_until(lambda: bool(reference), "the controller to hold")
    client.send([(4.0, [0.1] * 6)])  # long enough to be paused in time on a loaded machine
    controller.wait_for("trajectory accepted")
    client.spin_until(lambda: reference[-1].position[0] > 0.03, "the motion")
    client.simulation.pause(True)
    controller.wait_for("the loops rest")
    resting = seconds(reference[-1])
    assert 0.03 < reference[-1].position[0] < 0.099
    client.simulation.pause(False)
    client.spin_until(lambda: seconds(reference[-1]) > resting + 4.2, "the end of the motion")
    assert list(reference[-1].position) == pytest.approx([0.1] * 6, abs=1e-12)
