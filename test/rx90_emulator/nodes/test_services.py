"""What a user asks of a running pair: trajectories, power, limits that cut it, diagnostics."""

from __future__ import annotations

import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from processes import Processes
from rclpy.time import Time
from ros_client import JOINTS, Client, seconds
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rx90_common.base.rates import NANOSECONDS


def to_rest(duration: float, position: list[float], names: list[str] = JOINTS) -> JointTrajectory:
    """Return a trajectory of one point, at rest, after a duration, s."""
    nanoseconds = round(duration * NANOSECONDS)
    after = Duration(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)
    point = JointTrajectoryPoint(positions=position, velocities=[0.0] * 6, time_from_start=after)
    return JointTrajectory(joint_names=names, points=[point])


@pytest.mark.ros
def test_an_unpaced_pair_answers_whatever_is_asked_of_it(processes: Processes, client: Client) -> None:
    """Refused trajectories leave the motion that runs alone; without power the brakes hold; diagnostics tell the rate.

    Beyond a supervised limit: one line and an ERROR that name joint, value, limit and time; `enable` brings the arm
    back. The nodes run with integers where reals are asked for.
    """
    given = ("-p", "real_time_factor:=0", "-p", "initial_position:=[0.0, 0.8, 0.8, 0.0, 0.5, 0.0]")
    processes.start("rx90_sim", "--ros-args", *given)
    controller = processes.start("rx90_controller")
    joints, commands = client.listen("joint_states", depth=1), client.listen("motor_commands", depth=1)
    reference = client.listen("rx90_controller/reference", depth=1)
    publisher = client.node.create_publisher(JointTrajectory, "rx90_controller/joint_trajectory", 1000)
    client.spin_until(lambda: bool(reference) and publisher.get_subscription_count() > 0, "the controller to hold")

    # A burst is answered one by one; what is refused leaves the running motion alone.
    for _ in range(40):
        publisher.publish(JointTrajectory(joint_names=["elbow"]))
    client.spin_until(lambda: controller.output.count("trajectory rejected") == 40, "40 answers")
    target = [0.1, 0.7, 0.7, 0.1, 0.6, 0.1]
    publisher.publish(to_rest(1.0, target[::-1], JOINTS[::-1]))
    controller.wait_for("trajectory accepted")
    publisher.publish(to_rest(1.0, [0.0, 9.0, 0.0, 0.0, 0.0, 0.0]))
    assert "joint_2" in controller.wait_for(r"trajectory rejected: .*joint_2.*").group()
    begun = seconds(reference[-1])
    client.spin_until(lambda: seconds(reference[-1]) > begun + 1.2, "the end of the motion")
    assert list(reference[-1].position) == pytest.approx(target, abs=1e-12)
    assert list(reference[-1].velocity) == [0.0] * 6

    # Disabled: commands without torque, drives without torque, and the arm does not fall.
    client.spin_until(lambda: max(map(abs, joints[-1].effort)) > 10.0, "the drives to hold the arm")
    client.enable(False)
    client.spin_until(lambda: bool(commands) and len(commands[-1].effort) == 0, "commands without torque")
    closed, held = seconds(commands[-1]), joints[-1].position[1]
    client.spin_until(lambda: seconds(joints[-1]) > closed + 0.5, "half a second with closed brakes")
    assert list(joints[-1].effort) == [0.0] * 6
    # The brakes' stiffness lets the arm give by far less than a tenth of a milliradian.
    assert joints[-1].position[1] == pytest.approx(held, abs=2e-4)
    client.enable(True)
    client.spin_until(lambda: len(commands[-1].effort) == 6, "commands with torque again")

    # A limit of the supervision that the next motion exceeds.
    heard = client.listen("/diagnostics", DiagnosticArray)

    def of_controller(since: Time) -> list[DiagnosticStatus]:
        newer = [message.status[0] for message in heard if Time.from_msg(message.header.stamp) > since]
        return [status for status in newer if status.name == "rx90_controller"]

    assert client.set_parameters("rx90_controller", supervision__following_error=[5e-4] * 6) == [""]
    begun_at = client.node.get_clock().now()
    publisher.publish(to_rest(0.4, [angle + 0.1 for angle in target]))
    controller.wait_for(r"joint_\d: following error .* rad at .* s; accepted: up to 0.0005 rad; torque off")

    def errors() -> list[str]:
        return [one.message for one in of_controller(begun_at) if one.level == DiagnosticStatus.ERROR]

    client.spin_until(lambda: bool(errors()), "the diagnostics")
    assert "accepted: up to 0.0005 rad" in errors()[0]
    assert sum("following error" in line for line in controller.lines) == 1
    client.enable(True)
    enabled = client.node.get_clock().now()  # diagnostics from before may come after the answer
    publisher.publish(to_rest(5.0, list(reference[-1].position)))
    controller.wait_for("trajectory accepted")
    client.spin_until(lambda: bool(of_controller(enabled)), "diagnostics")
    assert DiagnosticStatus.ERROR not in [one.level for one in of_controller(enabled)]

    # The controller's rate is that of the ticks it answers.
    assert client.set_parameters("rx90_sim", real_time_factor=0.1) == [""]

    def rates() -> list[float]:
        return [float(pair.value) for one in of_controller(enabled) for pair in one.values if pair.key == "rate, Hz"]

    client.spin_until(lambda: any(300.0 < rate < 500.0 for rate in rates()), "a rate near 400 Hz")
