"""A pair of nodes in a namespace while time stands still: what they say, publish and take."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from processes import Processes
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from ros_client import Client
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from rx90_common.base.stamps import cdr_stamp_ns

ROS_ARGS = ("--ros-args", "-r", "__ns:=/cell_1")
QOS = ("reliability:=best_effort", "durability:=transient_local", "depth:=5")


@pytest.mark.ros
def test_a_paused_pair_is_heard_and_takes_a_trajectory(processes: Processes, client: Client) -> None:
    """Samples come again to the bit; a line is approached and begins when time runs; each node says ready once.

    Diagnostics carry the namespace, and the quality of service of a topic is the one given as parameters.
    """
    overrides = [f"qos_overrides./cell_1/friction_states.publisher.{policy}" for policy in QOS]
    simulation = processes.start(
        "rx90_sim", *ROS_ARGS, *("-p", "paused:=true"), *(w for override in overrides for w in ("-p", override))
    )
    simulation.wait_for(
        "ready: rx90b, lock_step at 4000 Hz, real_time_factor 1, states on /cell_1/motor_states; paused"
    )
    controller = processes.start("rx90_controller", *ROS_ARGS)
    raw: list[bytes] = []
    sampled: list[bytes] = []
    client.node.create_subscription(JointState, "/cell_1/joint_states", raw.append, 10, raw=True)
    client.node.create_subscription(JointState, "/cell_1/sampled/joint_states", sampled.append, 10, raw=True)
    clock = client.listen("/clock", Clock)
    diagnostics = client.listen("/diagnostics", DiagnosticArray)
    client.spin_until(lambda: min(map(len, (raw, sampled, clock))) > 3, "a heartbeat")
    assert len({*raw, *sampled}) == 1
    assert {(message.clock.sec, message.clock.nanosec) for message in clock} == {(0, 0)}
    (offered,) = client.node.get_publishers_info_by_topic("/cell_1/friction_states")
    assert offered.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT
    assert offered.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    line = ("--from-file", "robots/rx90b/task.yaml", "--approach", "--node", "/cell_1/rx90_controller")
    done = processes.run("rx90_line", *line)
    assert done.returncode == 0, done.stderr
    assert "time stands still at 0 s: the arm moves when it runs on" in done.stdout
    controller.wait_for("a trajectory waits for the simulation's first tick")
    client.asking.call(SetBool, "/cell_1/rx90_sim/pause", SetBool.Request(data=False))
    controller.wait_for("ready: rx90b, .* trajectories on /cell_1/rx90_controller/joint_trajectory")
    controller.wait_for("trajectory accepted")
    client.spin_until(lambda: len(set(raw)) > 100, "the arm to move")
    client.asking.call(SetBool, "/cell_1/rx90_sim/pause", SetBool.Request(data=True))
    client.spin_until(lambda: len(raw) > 5 and len(set(raw[-4:])) == 1, "the last sample again and again")
    assert len(set(sampled)) > 1
    assert {cdr_stamp_ns(sample) % 10_000_000 for sample in sampled} == {0}  # a hundred times a second

    def names() -> set[tuple[str, str]]:
        return {(status.name, status.hardware_id) for message in diagnostics for status in message.status}

    client.spin_until(lambda: len(names()) >= 2, "diagnostics of both nodes")
    assert names() == {(f"cell_1/{node}", "cell_1/rx90_emulator") for node in ("rx90_sim", "rx90_controller")}
    assert simulation.output.count("ready: ") == controller.output.count("ready: ") == 1
