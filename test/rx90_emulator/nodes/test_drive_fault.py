"""What a user meets when the supervision of the running nodes cuts the power."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from processes import Processes
from rclpy.time import Time
from ros_client import Client

from rx90_common.description.robot_files import RobotFiles


@pytest.mark.ros
def test_a_fault_is_told_and_enable_brings_the_arm_back(
    processes: Processes, client: Client, shipped_files: RobotFiles, edited_yaml: Callable[..., Path]
) -> None:
    """Beyond the limit: one line, an ERROR that names joint, value, limit and time, no trajectories; then `enable`."""
    strict = edited_yaml(shipped_files.controller, ("supervision", "following_error"), [5e-4] * 6)
    processes.start("rx90_sim", "--ros-args", "-p", "real_time_factor:=0.0")
    controller = processes.start("rx90_controller", "--ros-args", "-p", f"controller:={strict}")
    reference = client.listen("rx90_controller/reference", depth=1)
    heard = client.listen("/diagnostics", DiagnosticArray, depth=10)
    client.spin_until(lambda: bool(reference), "the controller to hold")
    client.send([(0.4, [0.1] * 6)])
    controller.wait_for(r"joint_\d: following error .* rad at .* s; accepted: up to 0.0005 rad; torque off")

    def errors() -> list[str]:
        """Return what the controller's diagnostics have as ERROR."""
        status = [array.status[0] for array in heard]
        return [one.message for one in status if one.level == DiagnosticStatus.ERROR and "controller" in one.name]

    client.spin_until(lambda: bool(errors()), "the diagnostics")
    assert "accepted: up to 0.0005 rad" in errors()[0]
    assert sum("following error" in line for line in controller.lines) == 1
    client.enable(True)
    enabled = client.node.get_clock().now()
    client.send([(5.0, list(reference[-1].position))])

    def later() -> list[DiagnosticStatus]:
        """Return the controller's diagnostics since it was enabled: those from before may come after the answer."""
        since = [array.status[0] for array in heard if Time.from_msg(array.header.stamp) > enabled]
        return [one for one in since if "controller" in one.name]

    client.spin_until(lambda: bool(later()), "diagnostics")
    assert DiagnosticStatus.ERROR not in [one.level for one in later()]
